# SPDX-License-Identifier: Apache-2.0
"""What somebody could do with a simulated session who knows its causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_sim.cellfile import read_cell
from irec_sim.hidden import draw_session
from irec_sim.matrix import Case
from irec_sim.oracle import consult
from irec_sim.replay import Replay
from irec_sim.session import Conduct, generate
from irec_sim.truth import make_truth

AFP, MILLING = read_cell("afp"), read_cell("milling")
CELLS = {"afp": AFP, "milling": MILLING}


def test_the_oracle_sees_a_strong_effect_and_gains_by_knowing_it():
    drawn = draw_session(Case("single", ("joint_coupling",), 0.15), 3, 20, 12, CELLS)
    (seen,) = drawn.oracle.seen
    assert seen.visible and seen.nats > 50.0
    assert drawn.oracle.oracle_m < 0.5 * drawn.oracle.base_m


@pytest.mark.parametrize("effect", ["encoder_harmonics", "joint_backlash"])
def test_the_oracle_does_not_see_what_does_not_show(effect):
    truth = make_truth("milling", [effect], 5)
    truth = truth.scaled(effect, 1e-3)
    made, check = (generate(MILLING, truth, n, seed=n) for n in (15, 10))
    assert not consult(made, check, truth).seen[0].visible


def test_a_mishap_does_not_blind_the_oracle():
    case = Case("single", ("sensor_alignment",), 0.1, mishap="jump")
    spoiled, plain = (draw_session(c, 3, 20, 12, CELLS) for c in (case, replace(case, mishap="")))
    assert spoiled.oracle.oracle_m == pytest.approx(plain.oracle.oracle_m, rel=0.3)


def test_the_oracles_replay_of_the_truth_is_what_the_plant_did():
    effects = ["tool_compliance", "joint_hysteresis", "creep", "sensor_gain", "rail_compliance", "external_force", "sensor_lag"]
    truth = make_truth("afp", effects, 5, off_centre=0.05)
    made = generate(AFP, truth, 6, seed=2, conduct=Conduct(random_order=True))
    _, tcp = Replay(made, 0, truth.physics(), made.rows[0].force_reading)(truth.physics())
    assert np.abs(tcp - made.rows[0].deflection).max() < 2e-7


def test_a_replay_with_springs_at_other_places_is_what_such_a_plant_does():
    truth = make_truth("afp", [], 5, off_centre=0.03)
    other = replace(truth, centre=truth.centre + 0.01)
    made, moved = (generate(AFP, t, 6, seed=2) for t in (truth, other))
    replay = Replay(made, 0, truth.physics(), made.rows[0].force_reading)
    change = replay(other.physics())[1] - replay(truth.physics())[1]
    truly = moved.rows[0].deflection - made.rows[0].deflection
    assert np.abs(truly).max() > 2e-6
    assert np.abs(change - truly).max() < 0.05 * np.abs(truly).max()


def test_the_oracle_has_to_find_where_springs_sit():
    at_origins = make_truth("milling", [], 5)
    anywhere = replace(at_origins, centre=at_origins.centre + 1e-9)  # the same plant, but nobody says so
    known, sought = (
        consult(generate(MILLING, t, 15, seed=1), generate(MILLING, t, 10, seed=2), t).oracle_m for t in (at_origins, anywhere)
    )
    assert sought > 1.02 * known
