# SPDX-License-Identifier: Apache-2.0
"""Whatever comes in, the node lives, the caller gets an answer, and the offset makes no step."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from cell_side import CELL, CellSide, afp_model

pytestmark = [pytest.mark.ros, pytest.mark.paced]
ACTIVE, FAULT = 2, 5
SELDOM = 0.05  # s between two wrong messages
STEP = 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two


@pytest.fixture
def node(ros_domain, start_process) -> subprocess.Popen[bytes]:
    return start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
        "-p", "autostart:=true", "-p", "start_load:=10.0", "-p", "watch.wrench_timeout:=2.0", "-p", "watch.joints_timeout:=2.0",
        "-p", "watch.frozen_after:=2.0", "-p", "watch.clock_tolerance:=5.0", "-p", "watch.age_limit:=5.0",
        "-p", "filter.cutoff:=0.0",
    ], name="correction")  # fmt: skip


@pytest.fixture
def active(node, tmp_path) -> CellSide:
    side = CellSide()
    side.node_process = node
    answer = side.activate(afp_model(tmp_path))
    assert answer.success, answer.message
    side.until(lambda: side.states and side.states[-1].state == ACTIVE, what="ACTIVE")
    yield side
    side.close()


def largest_step(side: CellSide) -> float:
    return float(np.linalg.norm(np.diff(np.array([np.zeros(3), *side.offsets]), axis=0), axis=1).max())


def state_of(side: CellSide, state: int) -> None:
    side.until(lambda: side.states[-1].state == state, what=f"state {state}")


def test_no_model_file_whatever_ends_the_node_that_sends_an_offset(active, tmp_path):
    sound = yaml.safe_load(Path(afp_model(tmp_path)).read_text())
    broken = [
        sound | {"robot": [1]}, sound | {"history": 5}, sound | {"effects": [{"effect": "joint_torsion", "parameters": [1]}]},
        sound | {"envelope": sound["envelope"] | {"q_lower": [0.0] * 5}},
        sound | {"effects": [{"effect": "mine", "formula": "sqrt(tau)", "parameters": {}}]},
    ]  # fmt: skip
    texts = [yaml.safe_dump(b) for b in broken] + ["[" * 3000, "format: irec-model/1\nmade: {date: 2024-13-45}"]
    path = tmp_path / "broken.yaml"
    for text in texts:
        path.write_text(text)
        answer = active.activate(str(path))
        assert not answer.success and "broken.yaml" in answer.message
    sent = len(active.offsets)
    active.until(lambda: len(active.offsets) > sent + 20, what="offsets after the refusals")
    state_of(active, ACTIVE)  # where the machine has held the node up, after a ramp
    assert active.node_process.poll() is None
    assert largest_step(active) <= STEP


def test_a_description_of_another_robot_fades_out_and_stays_a_fault_until_it_is_activated_again(active):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    description = active.node.create_publisher(String, "robot_description", latched)
    description.publish(String(data="not a URDF"))
    state_of(active, FAULT)
    assert "robot_description" in active.states[-1].reason
    assert np.linalg.norm(active.offsets[-1]) < 1e-8
    from irec_calibration.cell import read_cell

    description.publish(String(data=read_cell(CELL).robot.urdf_text))
    change = active.node.create_client(ChangeState, "correction_node/change_state")
    activate = active.call(change, ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE)))
    assert activate.success, "after a FAULT, 'activate' is all that is needed"
    state_of(active, ACTIVE)
    assert largest_step(active) <= STEP


def test_a_joint_state_with_too_few_positions_and_wrenches_in_another_frame_are_held_and_named(active):
    joint_state, wrench = active.types

    sent = [0.0]

    def counted(fault: str) -> bool:
        return any(v.key == f"fault.{fault}" for m in active.diagnostics[-1:] for s in m.status for v in s.values)

    def told(fault: str) -> bool:
        if time.monotonic() < sent[0] + SELDOM:
            return counted(fault)
        sent[0] = time.monotonic()
        message = joint_state(name=[f"joint_{k}" for k in range(1, 7)], position=[0.0, 0.1, 0.2])
        message.header.stamp = active.node.get_clock().now().to_msg()
        foreign = wrench()
        foreign.header.frame_id, foreign.header.stamp = "base_link", message.header.stamp
        # in place of a right one: of two messages at once the node may see the second only
        active.instead = {"joints": message} if fault == "joints_names" else {"wrench": foreign}
        return counted(fault)

    for fault in ("joints_names", "wrench_frame"):
        active.until(lambda fault=fault: told(fault), what=f"counter of {fault}")
    assert active.node_process.poll() is None
    active.until(lambda: active.states[-1].state in (ACTIVE, FAULT), what="a state that lasts")
    assert largest_step(active) <= STEP


def test_a_joint_at_two_places_at_once_is_named_with_both_and_fades_the_offset_out(active):
    joint_state, _ = active.types

    def both() -> None:
        now = active.joints_now()
        second = joint_state(name=[*now.name, *now.name], position=[*now.position, *(q + 0.2 for q in now.position)])
        second.header.stamp = now.header.stamp
        active.instead = {"joints": second}

    def faded() -> bool:
        both()
        return active.states[-1].state == FAULT

    active.until(faded, what="FAULT")
    reason = active.states[-1].reason
    q = active.joints_now().position
    assert f"'joint_1' is named 2 times, at {q[0]:.6g} and at {q[0] + 0.2:.6g}" in reason
    assert largest_step(active) <= STEP


def test_a_rail_that_is_where_the_cell_has_none_fades_the_offset_out(active):
    active.rail = 3.0
    state_of(active, FAULT)
    assert "the rail is at 3 m, its range is -1.5 .. 1.5 m" in active.states[-1].reason
    assert largest_step(active) <= STEP


def test_a_limit_that_is_set_at_run_time_acts_and_what_does_not_act_is_refused(active):
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = active.node.create_client(SetParameters, "correction_node/set_parameters")

    def put(name: str, value: object) -> bool:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return active.call(client, request).results[0].successful

    active.until(lambda: np.linalg.norm(active.offsets[-1]) > 5e-4, what="offset of the model")
    assert put("limit.translation", 2e-4)
    active.until(lambda: np.linalg.norm(active.offsets[-1]) < 2.001e-4, what="lower limit")
    assert not put("limit.translation", 5.0)
    assert not put("watch.wrench_timeout", 1.0)
    assert not put("cell", "other.yaml")
    assert largest_step(active) <= STEP
