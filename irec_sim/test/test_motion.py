# SPDX-License-Identifier: Apache-2.0
"""Commanded moves: smooth, on their path, ending where they should, and stopping on the way when told to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from irec_sim.cellfile import read_cell
from irec_sim.course import plan_course
from irec_sim.errors import SimError
from irec_sim.kinematics import forward, rotation_of_vector, rotation_vector
from irec_sim.motion import Way, joint_move, linear_move

CELLS = Path(__file__).parents[2] / "config" / "cells"
AFP = read_cell(CELLS / "afp.yaml")
lengths, speeds = st.floats(1e-4, 5.0), st.floats(1e-3, 2.0)


@given(lengths, speeds)
def test_a_way_ends_at_its_length(length: float, speed: float) -> None:
    way = Way(length, speed)
    assert way.distance(0.0) == 0.0
    assert way.distance(way.duration) == pytest.approx(length)
    assert way.done(way.duration)


@given(lengths, speeds)
def test_a_way_is_never_faster_than_its_speed_and_never_goes_back(length: float, speed: float) -> None:
    way = Way(length, speed)
    t = np.linspace(0.0, way.duration, 400)
    step = np.diff([way.distance(float(x)) for x in t]) / (t[1] - t[0])
    assert step.min() >= -1e-9
    assert step.max() <= speed * (1 + 1e-6)


@given(lengths, speeds, st.floats(0.0, 1.0))
def test_a_stopped_way_comes_to_rest_without_a_jump(length: float, speed: float, share: float) -> None:
    way = Way(length, speed)
    at = share * way.duration
    before = way.distance(at)
    way.stop(at)
    end = at + way.ramp
    assert way.distance(at) == pytest.approx(before)
    assert before - 1e-12 <= way.distance(end) <= min(length, before + speed * way.ramp)
    assert way.distance(end) == way.distance(end + 1.0)
    assert way.done(end)


def test_a_joint_move_ends_at_its_goal_with_all_axes_at_once() -> None:
    goal = AFP.home + np.array([0.3, 0.1, -0.2, 0.0, 0.1, 0.5])
    move = joint_move(AFP.chain, (AFP.home, 0.0), (goal, 0.4), 0.5, 1.0)
    q, rail = move.at(move.way.distance(move.way.duration))
    half, half_rail = move.at(move.way.length / 2)
    assert q == pytest.approx(goal)
    assert rail == pytest.approx(0.4)
    assert half == pytest.approx((AFP.home + goal) / 2)
    assert half_rail == pytest.approx(0.2)


def test_a_joint_move_keeps_the_velocity_limits() -> None:
    goal = AFP.home + 0.4
    move = joint_move(AFP.chain, (AFP.home, 0.0), (goal, 0.0), 0.5, 1.0)
    t = np.arange(0.0, move.way.duration, 0.004)
    q = np.array([move.at(move.way.distance(float(x)))[0] for x in t])
    assert (np.abs(np.diff(q, axis=0)) / 0.004 <= 0.5 * AFP.chain.velocity * (1 + 1e-6)).all()


def test_a_joint_move_beyond_a_limit_is_refused_with_its_name() -> None:
    goal = AFP.home.copy()
    goal[3] = 100.0
    with pytest.raises(SimError, match="joint_4"):
        joint_move(AFP.chain, (AFP.home, 0.0), (goal, 0.0), 0.5, 1.0)


@settings(max_examples=15, deadline=None)
@given(st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.tuples(*[st.floats(-0.2, 0.2)] * 3))
@example((0.0, 0.0, -0.125), (0.125, -0.1875, 0.0))  # was 1.4 um beside it, just before its end
def test_a_straight_move_stays_within_a_micrometre_of_its_line(shift: tuple[float, ...], turn: tuple[float, ...]) -> None:
    pose = forward(AFP.chain, AFP.home[None])
    p, R = pose.p_tcp[0], pose.R_tool[0]
    goal_R = rotation_of_vector(np.array(turn)) @ R
    move = linear_move(AFP.chain, AFP.home, 0.0, p + np.array(shift), goal_R, 0.1)
    for t in np.linspace(0.0, move.way.duration, 40):
        share = move.fraction(float(t))
        at = forward(AFP.chain, move.at(move.way.distance(float(t)))[0][None])
        assert at.p_tcp[0] == pytest.approx(p + share * np.array(shift), abs=1e-6)
    assert rotation_vector(goal_R @ at.R_tool[0].T) == pytest.approx(np.zeros(3), abs=1e-8)


def test_a_straight_move_out_of_reach_is_refused() -> None:
    pose = forward(AFP.chain, AFP.home[None])
    with pytest.raises(SimError, match="reach"):
        linear_move(AFP.chain, AFP.home, 0.0, pose.p_tcp[0] + np.array([2.0, 0.0, 0.0]), pose.R_tool[0], 0.1)


@pytest.mark.parametrize("name", ["afp", "milling"])
def test_the_course_lies_on_the_tooling_with_the_tool_against_it(name: str) -> None:
    cell = read_cell(CELLS / f"{name}.yaml")
    plan = plan_course(cell)
    pose = forward(cell.chain, plan.q)
    in_cell = pose.p_tcp + (plan.rail * cell.rail[0] if cell.rail else 0.0)
    for p, R, normal in zip(in_cell, pose.R_tool, plan.normal, strict=True):
        gap, n = cell.surface.gap(p)
        assert abs(gap) < 2e-5
        assert n == pytest.approx(normal, abs=1e-3)
        assert R[:, 2] == pytest.approx(-normal, abs=1e-8)


def test_the_course_has_equal_steps(name: str = "afp") -> None:
    plan = plan_course(AFP)
    steps = np.linalg.norm(np.diff(forward(AFP.chain, plan.q).p_tcp, axis=0), axis=1)
    assert steps.sum() == pytest.approx(plan.length, rel=1e-4)
    assert np.ptp(steps) < 1e-3 * steps.mean()
