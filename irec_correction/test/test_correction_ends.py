# SPDX-License-Identifier: Apache-2.0
"""However the correction is ended, the stream of its offset comes to zero before it stops; who waits sends none."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest
from cell_side import CELL, START, CellSide, afp_model

pytestmark = [pytest.mark.ros, pytest.mark.paced]
INACTIVE, ACTIVE, FADE, FAULT = 0, 2, 4, 5
STEP = 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two
ARGUMENTS = [
    sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}", "-p", "autostart:=true",
    "-p", "start_load:=10.0", "-p", "watch.wrench_timeout:=2.0", "-p", "watch.joints_timeout:=2.0",
    "-p", "watch.frozen_after:=2.0", "-p", "watch.clock_tolerance:=5.0", "-p", "watch.age_limit:=5.0",
    "-p", "filter.cutoff:=0.0", "-p", "time.fade:=3.0",
]  # fmt: skip


@pytest.fixture
def node(ros_domain, start_process) -> subprocess.Popen[bytes]:
    return start_process(ARGUMENTS, name="correction")


@pytest.fixture
def active(node, tmp_path) -> CellSide:
    side = CellSide()
    answer = side.activate(afp_model(tmp_path))
    assert answer.success, answer.message
    side.until(lambda: side.states and side.states[-1].state == ACTIVE, what="ACTIVE")
    side.until(lambda: side.offsets and size(side) > 5e-4, what="offset of the model")
    yield side
    side.close()


def size(side: CellSide) -> float:
    return float(np.linalg.norm(side.offsets[-1]))


def largest_step(side: CellSide) -> float:
    return float(np.linalg.norm(np.diff(np.array([np.zeros(3), *side.offsets]), axis=0), axis=1).max())


def change(side: CellSide, transition: int, node: str = "correction_node") -> bool:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    client = side.node.create_client(ChangeState, f"{node}/change_state")
    return bool(side.call(client, ChangeState.Request(transition=Transition(id=transition))).success)


def ended_at_zero(side: CellSide) -> None:
    side.until(lambda: side.node.count_publishers("irec/offset") == 0, what="end of the stream")
    side.until(lambda: size(side) < 1e-8, what="the last offset")
    assert largest_step(side) <= STEP


def test_while_the_offset_fades_out_a_cleanup_is_refused_and_afterwards_it_is_done(active):
    from lifecycle_msgs.msg import Transition

    assert change(active, Transition.TRANSITION_DEACTIVATE)
    assert not change(active, Transition.TRANSITION_CLEANUP), "the offset is not at zero yet"
    active.until(lambda: active.states[-1].state == INACTIVE, what="INACTIVE")
    assert change(active, Transition.TRANSITION_CLEANUP)
    ended_at_zero(active)


@pytest.mark.parametrize("how", ["shutdown", "SIGINT", "SIGHUP"])
def test_a_node_that_is_shut_down_fades_the_offset_out_first(active, node, how):
    from lifecycle_msgs.msg import Transition

    if how == "shutdown":
        assert change(active, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    else:
        node.send_signal(getattr(signal, how))
        active.until(lambda: node.poll() is not None, what="end of the process")
        assert node.returncode == 0
    ended_at_zero(active)


def test_a_second_node_that_waits_sends_nothing_and_is_not_activated_beside_the_first(active, start_process, tmp_path):
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import GetState

    start_process([*ARGUMENTS, "-r", "__node:=second", "-p", f"model_path:={afp_model(tmp_path)}"], name="second")
    of_second = active.node.create_client(GetState, "second/get_state")
    inactive = State.PRIMARY_STATE_INACTIVE
    active.until(
        lambda: active.call(of_second, GetState.Request()).current_state.id == inactive, START, "the second is configured"
    )
    assert not change(active, Transition.TRANSITION_ACTIVATE, "second")
    active.until(lambda: any("sent by others already" in str(d) for d in active.diagnostics), what="the reason")
    sent = len(active.offsets)
    active.until(lambda: len(active.offsets) > sent + 100, what="offsets of the first")
    assert min(float(np.linalg.norm(o)) for o in active.offsets[sent:]) > 5e-4 and largest_step(active) <= STEP


def test_another_sender_that_appears_while_the_offset_is_sent_fades_it_out_with_a_plain_reason(active):
    from geometry_msgs.msg import TransformStamped

    rival = active.node.create_publisher(TransformStamped, "irec/offset", 10)
    active.until(lambda: active.states[-1].state == FAULT, what="FAULT")
    assert "2 publishers of /irec/offset" in active.states[-1].reason and "cell_side" in active.states[-1].reason
    assert size(active) < 1e-8 and largest_step(active) <= STEP
    active.node.destroy_publisher(rival)
