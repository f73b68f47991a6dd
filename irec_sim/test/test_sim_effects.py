# SPDX-License-Identifier: Apache-2.0
"""What hidden effects do in a simulated session, and to the deflection that is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import forward
from irec_sim.observe import simulate
from irec_sim.outside import GRAMMAR, OUTSIDE
from irec_sim.plant import Plant
from irec_sim.poses import spread_poses
from irec_sim.sensing import force_reading, true_force
from irec_sim.session import effect_share, generate, make_schedule, scale_to_share
from irec_sim.truth import EFFECTS, make_truth
from irec_sim.truth_catalogue import CATALOGUE

AFP, MILLING = read_cell("afp"), read_cell("milling")


def test_the_stiffness_of_the_truth_is_what_the_deflection_shows():
    truth = make_truth("afp", [], 1, friction=0.0)
    made = generate(AFP, truth, 4, seed=1)
    rows = made.rows[0]
    plant = Plant(AFP.chain, truth.physics().plant)
    R = forward(AFP.chain, rows.q[:, 1]).R_tool
    expected = plant.deflection(rows.q[:, 1], (R @ rows.wrench_force[:, 1, :, None])[..., 0])
    assert np.abs(rows.deflection[:, 0] - expected).max() < 5e-6


@pytest.mark.parametrize("effect", sorted(set(EFFECTS) - {"encoder_harmonics"}))
def test_every_effect_reaches_the_share_asked_for(effect):
    for seed in range(8):  # some draws don't show: play on an axis whose torque never changes sign, torque of an idle axis
        truth, shown = scale_to_share(AFP, make_truth("afp", [effect], 5 + seed), 0.08, poses=8)
        if shown:
            break
    assert shown == {effect}
    rng = np.random.default_rng([0, 2])
    schedule = make_schedule(AFP, spread_poses(AFP, 8, rng), 0.0, rng)
    before = simulate(AFP, truth.without(effect).physics(), schedule)
    assert effect_share(AFP, truth, effect, schedule, before) == pytest.approx(0.08, rel=0.03)


def test_encoder_harmonics_move_the_marker_but_cancel_under_load():
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 5, rng), 0.0, rng)
    plain, truth = (make_truth("afp", e, 1) for e in ([], ["encoder_harmonics"]))
    a, b = (simulate(AFP, t.physics(), schedule) for t in (plain, truth))
    assert np.abs(a.p_marker - b.p_marker).max() > 2e-5
    assert np.abs(a.apparent_deflection(AFP) - b.apparent_deflection(AFP)).max() < 2e-6


def test_the_catalogue_of_the_contract_is_complete():
    names = {
        "tool_compliance", "base_compliance", "rail_compliance", "joint_stiffening", "joint_backlash", "joint_hysteresis",
        "counterbalance", "joint_coupling", "sensor_gain", "sensor_alignment", "tool_weight", "station_registration",
        "tracker_scale", "station_shift", "thermal_drift", "creep", "marker_offset", "geometry_error", "joint_settling",
        "encoder_harmonics", "external_force",
    }  # fmt: skip
    assert set(CATALOGUE) == names
    assert len(GRAMMAR) >= 10 and len(set(EFFECTS) - names) >= 20


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_a_cause_without_a_name_says_which_columns_show_it(name):
    columns = {"load_case", "stamp", "ext_rail", *(f"force_{a}" for a in "xyz"), "temp_ambient"}
    columns |= {f"{v}_{k}" for v in ("joint", "tau", "temp_gear") for k in range(1, 7)}
    for seed in range(5):
        said = OUTSIDE[name].variables(OUTSIDE[name].draw(np.random.default_rng(seed)))
        assert said and set(said) <= columns


def test_the_same_kind_of_sentence_says_something_else_each_time():
    kinds = [OUTSIDE["stiffness_of_two_angles"].draw(np.random.default_rng(seed)) for seed in range(8)]
    assert len({(p["place"], p["joint"], *p["variables"]) for p in kinds}) > 4
    assert len({p["phase"][0] for p in kinds}) == 8


def test_what_only_the_instruments_see_does_not_deflect_the_tcp():
    rng = np.random.default_rng(0)
    schedule = make_schedule(MILLING, spread_poses(MILLING, 5, rng), 0.0, rng)
    plain = simulate(MILLING, make_truth("milling", [], 1).physics(), schedule)
    for effect in (
        "station_registration",
        "tracker_scale",
        "station_shift",
        "sensor_gain",
        "sensor_alignment",
        "tool_weight",
        "marker_offset",
    ):
        rows = simulate(MILLING, make_truth("milling", [effect], 1).physics(), schedule)
        assert np.abs(rows.deflection - plain.deflection).max() < 1e-9, effect


def test_a_station_that_was_bumped_stays_there_in_later_passes():
    made = generate(MILLING, make_truth("milling", ["station_shift"], 1), 6, 3, repeats=3)
    parted = [(rows.shifted != rows.shifted[:, :1]).any(axis=1).sum() for rows in made.rows]
    assert parted == [1, 0, 0]
    assert all(rows.shifted.all() for rows in made.rows[1:])


def test_the_true_force_is_read_back_from_the_reading():
    physics = make_truth("afp", ["sensor_gain", "sensor_alignment", "tool_weight"], 5).physics()
    rng = np.random.default_rng(0)
    force, R = rng.normal(0, 500, (4, 3)), forward(AFP.chain, rng.uniform(-1, 1, (4, 6))).R_tool
    read = force_reading(physics.sensing, AFP.sensor_axis, force, R)
    assert np.abs(read - force).max() > 5.0
    assert np.allclose(true_force(physics.sensing, AFP.sensor_axis, read, R), force, atol=1e-9)


@pytest.mark.parametrize("effect", ["geometry_error", "encoder_harmonics", "joint_settling"])
def test_what_wrong_joint_angles_and_lengths_make_of_the_commanded_displacement_is_no_part_of_the_true_deflection(effect):
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 4, rng), 0.0, rng)
    wrong = make_truth("afp", [effect], 1).scaled(effect, 3.0)
    rows = simulate(AFP, wrong.physics(), replace(schedule, force=np.zeros_like(schedule.force)))
    assert np.abs(rows.apparent_deflection(AFP)).max() > 2e-6
    assert np.abs(rows.deflection).max() < 1e-12


def test_what_passes_with_time_is_no_part_of_the_true_deflection():
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 4, rng), 0.0, rng)
    plain, drifting = (simulate(AFP, make_truth("afp", e, 1).physics(), schedule) for e in ([], ["thermal_drift"]))
    assert np.abs(plain.deflection - drifting.deflection).max() < 1e-9
    assert np.abs(plain.apparent_deflection(AFP) - drifting.apparent_deflection(AFP)).max() > 1e-6
