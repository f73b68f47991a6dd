# SPDX-License-Identifier: Apache-2.0
"""An effect that takes up whatever each pose does by itself is left out, and the session weighed again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import again, guessed, start_terms
from irec_calibration.diagnose.build import build
from irec_calibration.diagnose.part_sets import Parts
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term
from numpy.typing import NDArray

POSES = 10


def built(count: int, kind: str = "loaded", named: float = 300.0) -> Any:
    """A built model with so many parameters of a force on the arm, which explains so many nats."""
    study = SimpleNamespace(
        ready=SimpleNamespace(kind=kind),
        observation=SimpleNamespace(pose=np.repeat(np.arange(POSES), 5)),
        owners=("joint_torsion",) * 6 + ("external_force",) * count,
    )
    final = SimpleNamespace(study=study, ids=("external_force",), named=named)
    return SimpleNamespace(final=final, start=SimpleNamespace(named=0.0), family=None, seen=None)


@pytest.fixture(autouse=True)
def explains_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guessed, "without", lambda *_: SimpleNamespace(named=280.0))


@pytest.mark.parametrize(
    ("parts", "before", "after", "kind", "guess"),
    [
        (Parts(perhaps=("constant",)), 40, 31, "loaded", True),
        (Parts(one_of=(("constant",), ("with the tool",))), 40, 31, "loaded", True),
        (Parts(perhaps=("constant",)), 40, 30, "loaded", False),
        (Parts(proven=("constant",), perhaps=("with the tool",)), 40, 31, "loaded", False),
        (Parts(perhaps=("constant",)), 40, 31, "absolute", False),
    ],
)
def test_more_parameters_than_three_for_each_pose_are_a_guess_where_no_part_is_proven(
    monkeypatch: pytest.MonkeyPatch, parts: Parts, before: int, after: int, kind: str, guess: bool
) -> None:
    pruned = SimpleNamespace(study=built(after).final.study, parts={"external_force": parts})
    monkeypatch.setattr(guessed, "prune", lambda *_, **__: pruned)
    monkeypatch.setattr(guessed, "_forms", lambda *_: 2)
    assert list(guessed.guessed(built(before, kind))) == (["external_force"] if guess else [])


@pytest.mark.parametrize(
    ("parts", "forms", "guess"),
    [
        (Parts(perhaps=("constant", "with the tool")), 15, True),
        (Parts(perhaps=("constant", "with the tool")), 6, False),
        (Parts(proven=("constant",), perhaps=("with the tool",)), 15, False),
        (Parts(one_of=(("constant",), ("with the tool",))), 15, False),
    ],
)
def test_a_cause_with_each_of_its_forms_at_once_is_a_guess_where_none_is_proven(
    monkeypatch: pytest.MonkeyPatch, parts: Parts, forms: int, guess: bool
) -> None:
    pruned = SimpleNamespace(study=built(20).final.study, parts={"external_force": parts})
    monkeypatch.setattr(guessed, "prune", lambda *_, **__: pruned)
    monkeypatch.setattr(guessed, "_forms", lambda *_: forms)
    assert list(guessed.guessed(built(20))) == (["external_force"] if guess else [])


@pytest.mark.parametrize(
    ("all_names", "bare", "guess"),
    [
        (1000.0, 500.0, False),
        (1000.0, 700.0, True),  # less than a third of it
        (120.0, 30.0, True),  # most of it, but little
    ],
)
def test_what_explains_much_of_all_that_has_a_name_is_no_guess(
    monkeypatch: pytest.MonkeyPatch, all_names: float, bare: float, guess: bool
) -> None:
    pruned = SimpleNamespace(study=built(20).final.study, parts={"external_force": Parts(perhaps=("constant",))})
    monkeypatch.setattr(guessed, "prune", lambda *_, **__: pruned)
    monkeypatch.setattr(guessed, "_forms", lambda *_: 15)
    monkeypatch.setattr(guessed, "without", lambda *_: SimpleNamespace(named=bare))
    assert list(guessed.guessed(built(20, named=all_names))) == (["external_force"] if guess else [])


@pytest.mark.parametrize(
    ("effect_id", "names", "forms"),
    [
        ("external_force", ("f_x", "f_y", "f_x_tool", "k"), 3),
        ("joint_backlash", ("b_1", "b_4"), 0),  # axes
        ("sensor_gain", ("e_xy", "e_xz", "e_yx"), 0),  # one matrix
    ],
)
def test_parts_that_are_axes_or_of_a_sensor_are_no_forms(effect_id: str, names: tuple[str, ...], forms: int) -> None:
    term = Term(find_effect(effect_id), {n: Estimate(1.0) for n in names})
    study: Any = SimpleNamespace(terms=(term,), ready=scene_of(synthetic.session(poses=3)))
    assert guessed._forms(study, effect_id) == forms


def test_a_session_is_weighed_again_without_a_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, str]] = []

    def build_(*_: object, without: dict[str, str]) -> Any:
        asked.append(dict(without))
        return built(3)

    monkeypatch.setattr(again, "build", build_)
    monkeypatch.setattr(again, "guessed", lambda _: {} if len(asked) > 1 else {"external_force": "why"})
    study: Any = None
    again.built_again(study, study, lambda: None, lambda _: None)
    assert asked == [{}, {"external_force": "why"}]


def soft_tool(scene: Scene) -> NDArray[np.float64]:
    return 6e-8 * np.einsum("nij,nj->ni", scene.kin.R_tool, scene.force_in_tool)


def test_an_effect_that_is_left_out_is_not_built_with_and_says_why() -> None:
    session = synthetic.session(poses=POSES, seed=5, extra=soft_tool)
    study = prepare(session, start_terms(session)).to_weigh
    found = build(study, without={"tool_compliance": "left out"})
    assert "tool_compliance" in build(study).final.ids
    assert "tool_compliance" not in found.final.ids
    assert found.skipped["tool_compliance"] == "left out"
