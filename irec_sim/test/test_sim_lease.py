# SPDX-License-Identifier: Apache-2.0
"""A force set point that is not renewed, and a contact that nobody leaves, lead out of the contact."""

from __future__ import annotations

import numpy as np
import pytest
from irec_sim.cell import FORCE, POSITION, Cell
from irec_sim.cellfile import read_cell
from irec_sim.errors import SimError
from irec_sim.kinematics import Array, inverse
from irec_sim.lease import ForceLease, LeaseSettings
from irec_sim.motion import Move
from irec_sim.poses import spread_poses
from irec_sim.truth import make_truth

AFP = read_cell("afp")
POSES = spread_poses(AFP, 1, np.random.default_rng(0))
PRESSING = np.array([0.0, 0.0, -1100.0])


def above(distance: float) -> Array:
    """Joint angles with the tool drawn back from contact, rad."""
    p = POSES.p[:1] - distance * POSES.R[:1, :, 2]
    return inverse(AFP.chain, p, POSES.R[:1], POSES.q[:1])[0][0]


def pressing_cell(settings: LeaseSettings) -> tuple[Cell, ForceLease]:
    """A cell that has pressed for two seconds with a set point that was renewed all the time."""
    cell = Cell(AFP, make_truth("afp", [], 0))
    q, _ = cell.commanded
    for share in np.linspace(0.0, 1.0, 300):  # a path, so that the arm doesn't cut through the mould
        cell.command(q + share * (above(0.15) - q), share * POSES.rail[0])
        cell.step()
    for distance in np.linspace(0.15, 0.003, 200):
        cell.command(above(distance), POSES.rail[0])
        cell.step()
    cell.control_force(PRESSING)
    lease = ForceLease(cell, settings)
    for _ in range(500):
        lease.renew()
        assert lease.step(False) is None
        cell.step()
    assert cell.true_force()[2] == pytest.approx(-1100.0, abs=10.0)
    return cell, lease


def let_run_out(cell: Cell, lease: ForceLease, seconds: float = 3.0) -> tuple[list[float], Move | None]:
    """Normal force at each step after the last set point, and the way back."""
    forces, way_back, begun = [], None, 0.0
    for _ in range(int(seconds / cell.period)):
        move = lease.step(way_back is not None)
        if move is not None:
            way_back, begun = move, cell.time
        if way_back is not None:
            cell.command(*way_back.at(way_back.way.distance(cell.time - begun)))
        cell.step()
        forces.append(float(cell.true_force()[2]))
    return forces, way_back


def test_a_set_point_that_is_not_renewed_leads_to_a_ramp_and_a_way_back_along_the_tool() -> None:
    cell, lease = pressing_cell(LeaseSettings())
    p_pressing, R = cell.tcp()
    forces, way_back = let_run_out(cell, lease)
    held, ramp = int(0.5 / cell.period), int(0.3 / cell.period)
    assert max(forces[: held - 1]) < -1080.0
    assert np.abs(np.diff(forces[held : held + ramp])).max() < 60.0  # N in 4 ms: no step
    assert forces[-1] == 0.0
    assert way_back is not None and cell.mode == POSITION and lease.expired == 1
    np.testing.assert_allclose((p_pressing - cell.tcp()[0]) @ R[:, 2], 0.02, atol=2e-3)
    assert "0.5 s" in lease.reason and "20 mm" in lease.reason


def test_a_set_point_in_the_ramp_takes_the_force_up_again() -> None:
    cell, lease = pressing_cell(LeaseSettings())
    let_run_out(cell, lease, 0.6)
    assert lease.ramping
    lease.renew()
    cell.set_force(PRESSING)
    assert not lease.ramping and lease.step(False) is None and cell.mode == FORCE


def test_a_driver_without_the_switch_presses_on() -> None:
    cell, lease = pressing_cell(LeaseSettings(hold=0.0))
    forces, way_back = let_run_out(cell, lease, 2.0)
    assert way_back is None and max(forces) < -1080.0


def test_a_robot_left_in_contact_after_force_control_draws_the_tool_back() -> None:
    cell, lease = pressing_cell(LeaseSettings())
    p_pressing, R = cell.tcp()
    cell.control_position()
    lease.left_force_control()
    forces, way_back = let_run_out(cell, lease, 3.5)
    assert max(forces[: int(1.9 / cell.period)]) < -1080.0
    assert forces[int(2.4 / cell.period)] == 0.0
    assert way_back is not None and cell.mode == POSITION and lease.expired == 1
    np.testing.assert_allclose((p_pressing - cell.tcp()[0]) @ R[:, 2], 0.02, atol=2e-3)
    assert "no move came for 2 s" in lease.reason


def test_a_move_within_the_time_is_not_disturbed_and_one_that_ends_in_contact_begins_it_anew() -> None:
    cell, lease = pressing_cell(LeaseSettings())
    cell.control_position()
    lease.left_force_control()
    for k in range(int(5.0 / cell.period)):
        assert lease.step(moving=375 < k) is None  # begun 1.5 s after the switch, standing nearly
        cell.step()
    moves = []
    for _ in range(int(2.1 / cell.period)):
        moves.append(lease.step(moving=False))
        cell.step()
    assert [m is not None for m in moves].index(True) == pytest.approx(500, abs=2)


def test_without_contact_a_switch_to_position_control_asks_for_no_move() -> None:
    cell = Cell(AFP, make_truth("afp", [], 0))
    lease = ForceLease(cell, LeaseSettings())
    cell.control_force(np.zeros(3))
    lease.renew()
    cell.control_position()
    lease.left_force_control()
    _, way_back = let_run_out(cell, lease, 3.0)
    assert way_back is None and lease.expired == 0


@pytest.mark.parametrize("hold", [30.0, -1.0, float("nan"), float("inf")])
def test_a_time_for_which_no_set_point_may_hold_is_refused(hold: float) -> None:
    with pytest.raises(SimError, match="to 2 s are possible by the contract"):
        LeaseSettings(hold=hold)
