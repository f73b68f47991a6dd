# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from irec_sim.cell import FAULT, FORCE, POSITION, Cell
from irec_sim.cellfile import read_cell
from irec_sim.errors import SimError
from irec_sim.instruments import InstrumentSettings
from irec_sim.kinematics import forward, inverse
from irec_sim.observe import simulate
from irec_sim.plant import Conditions, Plant
from irec_sim.poses import Poses, spread_poses
from irec_sim.session import make_schedule
from irec_sim.truth import Hidden, make_truth

AFP = read_cell("afp")
ELASTIC = make_truth("afp", [], 0, spread=0.0, friction=0.0)
POSES = spread_poses(AFP, 3, np.random.default_rng(0))
QUIET = InstrumentSettings(force_noise=0.0, force_drift=0.0, torque_noise=0.0, tracker_white=0.0, tracker_slow=0.0, dropout=0.0)


def _above(i, distance):
    return inverse(AFP.chain, (POSES.p[i] - distance * POSES.R[i][:, 2])[None], POSES.R[i][None], POSES.q[i][None])[0][0]


def _run(cell, seconds):
    for _ in range(round(seconds / cell.period)):
        cell.step()


def _near(i=0, truth=ELASTIC, seed=0, settings=QUIET):
    """A cell that stands before contact at pose i."""
    cell = Cell(AFP, truth, seed, settings)
    q, rail = cell.commanded
    for share in np.linspace(0, 1, 200):  # a path, so that the arm doesn't cut through the mould
        cell.command(q + share * (_above(i, 0.15) - q), share * POSES.rail[i])
        cell.step()
    _run(cell, 0.5)
    cell.command(_above(i, 0.006), POSES.rail[i])
    _run(cell, 0.5)
    return cell


def _marker_in_base(cell):
    name, p = cell.tracker()
    _, p_station, R = next(s for s in AFP.stations if s[0] == name)
    return p_station + R @ p - cell.joints()[1] * AFP.rail[0]


PULL = {"attach": [0.1, 0.0, -0.2], "anchor": [0.5, -0.5, 2.5], "link": 0, "tension": 200.0, "reach": 1.5, "stretch": 1.0}
HOSE = replace(ELASTIC, hidden=(Hidden("external_force", {**PULL, "wrist": [0.0, 0.0]}),))


@pytest.mark.parametrize("truth", [ELASTIC, HOSE], ids=["elastic", "hose to the floor beside the rail"])
def test_each_load_case_is_established_and_its_deflection_is_that_of_the_plant(truth):
    cell = _near(truth=truth)
    marker, controller = _marker_in_base(cell), cell.tcp()[0]
    lever = cell.tcp()[1] @ AFP.marker_in_tool0
    cell.control_force(AFP.load_cases[0])
    _run(cell, 2.0)
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, Poses(*(x[:1] for x in (POSES.q, POSES.rail, POSES.p, POSES.R))), 0.0, rng)
    schedule.force[0, 1:] = AFP.load_cases
    direct = simulate(AFP, truth.physics(), schedule).apparent_deflection(AFP)[0]
    for j, force in enumerate(AFP.load_cases):
        cell.set_force(force)
        _run(cell, 1.5)
        assert np.abs(cell.wrench()[:3] - force).max() < 2.0
        assert np.abs(cell.true_force() - force).max() < 2.0
        change = cell.tcp()[1] @ AFP.marker_in_tool0 - lever
        seen = (_marker_in_base(cell) - marker) - (cell.tcp()[0] - controller + change)
        assert np.abs(seen - direct[j]).max() < 1e-5


def test_no_force_control_pushes_through_the_surface():
    cell = _near()
    cell.control_force(AFP.load_cases[0])
    _run(cell, 2.0)
    gap, _ = AFP.surface.gap(cell.true_tcp() + cell.joints()[1] * AFP.rail[0])
    assert -1e-3 < gap < 0.0


def test_position_control_freezes_where_the_robot_is():
    cell = _near()
    cell.control_force(AFP.load_cases[0])
    _run(cell, 2.0)
    before = cell.tcp()[0]
    cell.control_position()
    _run(cell, 0.5)
    assert cell.mode == POSITION
    assert np.abs(cell.tcp()[0] - before).max() < 2e-6
    assert cell.true_force()[2] == pytest.approx(-1100.0, abs=5.0)


def test_two_cells_of_one_seed_read_the_same_and_other_seeds_differ():
    def record(seed):
        cell = Cell(AFP, ELASTIC, seed)
        _run(cell, 0.05)
        return np.concatenate([cell.wrench_raw(), cell.joints()[0], cell.tracker()[1]])

    assert np.array_equal(record(5), record(5))
    assert not np.array_equal(record(5), record(6))


def test_the_raw_reading_holds_weight_and_bias_of_the_tool():
    cell = Cell(AFP, ELASTIC, 0, QUIET)
    _run(cell, 0.02)
    bias = np.array(QUIET.force_bias)
    assert np.linalg.norm(cell.wrench_raw()[:3] - bias[:3]) == pytest.approx(120.0 * 9.81, rel=1e-3)
    assert np.abs(cell.wrench()[:3]).max() < 1e-6


def test_a_process_force_deflects_the_arm_as_the_plant_says():
    cell, force = _near(), np.array([150.0, 180.0, -900.0])
    cell.set_process(force)
    _run(cell, 0.2)
    plant, q = Plant(AFP.chain, ELASTIC.physics().plant), _above(0, 0.006)[None]
    R = plant.equilibrium(q, Conditions.idle(1), plant.relaxed(q))[1].R_tool  # the process turns with the sagging tool
    expected = plant.deflection(q, R @ force)[0]
    assert np.abs(cell.true_deviation() - expected).max() < 1e-6


def test_an_offset_of_minus_the_deviation_brings_the_tcp_back():
    cell = _near()
    cell.set_process(np.array([-280.0, 180.0, -1100.0]))
    _run(cell, 0.2)
    without = cell.true_deviation()
    for _ in range(250):
        cell.set_offset(-without, np.zeros(3), cell.time)
        cell.step()
    assert np.linalg.norm(without) > 3e-4
    assert np.linalg.norm(cell.true_deviation()) < 0.02 * np.linalg.norm(without)
    assert np.allclose(cell.offset, -without)


def test_a_stale_offset_is_not_taken():
    cell = _near()
    _run(cell, 0.5)
    cell.set_offset(np.array([1e-3, 0, 0]), np.zeros(3), cell.time - 0.2)
    _run(cell, 0.1)
    assert not cell.offset.any()


def test_set_points_are_refused_in_position_control():
    cell = Cell(AFP, ELASTIC)
    assert cell.mode == POSITION
    with pytest.raises(SimError, match="position control"):
        cell.set_force(np.zeros(3))
    cell.control_force(np.zeros(3))
    assert cell.mode == FORCE


def test_a_collision_switches_the_drives_off_until_the_operator_clears_it():
    cell = _near()
    cell.command(_above(0, -0.05), POSES.rail[0])
    _run(cell, 1.0)
    assert cell.mode == FAULT
    stopped = cell.tcp()[0]
    cell.command(_above(0, 0.1), POSES.rail[0])
    _run(cell, 0.2)
    assert np.abs(cell.tcp()[0] - stopped).max() < 1e-6
    with pytest.raises(SimError, match="fault"):
        cell.control_force(np.zeros(3))
    cell.clear_fault()
    cell.command(_above(0, 0.1), POSES.rail[0])
    _run(cell, 1.0)
    assert cell.mode == POSITION and not cell.true_force().any()


def test_the_tracker_is_silent_when_the_arm_stands_between():
    cell = Cell(AFP, ELASTIC, 0, QUIET)
    assert cell.tracker() is not None
    q = cell.commanded[0].copy()
    station = AFP.stations[0][1]
    blocked = []
    for turn in np.linspace(-3.0, 3.0, 25):
        q[0] = turn
        cell = Cell(AFP, ELASTIC, 0, QUIET)
        cell.command(q, 0.0)
        _run(cell, 2.5)
        tcp = forward(AFP.chain, q[None]).p_tcp[0]
        away = float(tcp[:2] @ station[:2]) / np.linalg.norm(tcp[:2]) / np.linalg.norm(station[:2])
        blocked.append((away, cell.tracker() is None))
        if cell.tracker() is None:
            break
    assert any(b for _, b in blocked)


def test_delay_and_drop_outs_are_parameters():
    late = Cell(AFP, ELASTIC, 0, InstrumentSettings(tracker_delay=0.04, dropout=0.0))
    now = Cell(AFP, ELASTIC, 0, InstrumentSettings(tracker_delay=0.0, dropout=0.0))
    early = []
    for _ in range(30):
        late.step()
        now.step()
        early.append(now.tracker()[1])
        delayed = late.tracker()[1]
    assert np.array_equal(delayed, early[-11])
    gone = Cell(AFP, ELASTIC, 0, InstrumentSettings(dropout=1.0))
    assert gone.tracker() is None
