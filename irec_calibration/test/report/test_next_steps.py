# SPDX-License-Identifier: Apache-2.0
"""What to do where nothing is missing: use the model, or look at the instruments first."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from irec_calibration.identification.noise import InferredNoise
from irec_calibration.model import EIGHTEEN_DOF
from irec_calibration.report.next_steps import after_diagnosis


def steps(times: float, wanders: float = 0.0, model: str = "", usual: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    level = times * 30e-6
    noise = InferredNoise(30e-6, level, 0.9 * level, 1.1 * level, "residual", 300.0, wanders, 75.0)
    found = SimpleNamespace(
        verdict=SimpleNamespace(status="adequate", usual=usual, one_of=(), too_few=False), proposals=(), next_measurements=(),
        noise=noise,
        model=SimpleNamespace(effects=EIGHTEEN_DOF),
    )  # fmt: skip
    return after_diagnosis(found, "SESSION", model)  # type: ignore[arg-type]


@pytest.mark.parametrize("times", [0.4, 1.0, 1.5])
def test_noise_like_that_which_is_stated_gives_no_doubt(times):
    ((text, command),) = steps(times, wanders=0.3)
    assert text == "Nothing is to be added. Identify the model and use it:" and command.startswith("irec solve SESSION")


@pytest.mark.parametrize("model", ["", "model.yaml"])
def test_noise_far_beyond_what_is_stated_asks_for_a_look_at_the_instruments_first(model):
    (first, none), (then, command) = steps(5.9, wanders=0.95, model=model)
    assert "5.9 times what the session states and wanders for 95 %: a cause may hide in it" in first and none == ""
    assert then.startswith("Until then nothing is to be added.") and "use it" not in then and command


def test_noise_that_wanders_for_the_most_part_does_so_too():
    (first, _), _ = steps(1.0, wanders=0.6)
    assert first.startswith("What passes for noise wanders for 60 %:")


@pytest.mark.parametrize(("times", "command"), [(1.0, "irec improve SESSION -o improved"), (5.9, "irec solve SESSION")])
def test_what_every_robot_has_is_taken_in_where_the_instruments_are_not_in_doubt(times, command):
    assert steps(times, usual=("tool_compliance",))[-1][1].startswith(command)
