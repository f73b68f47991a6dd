# SPDX-License-Identifier: Apache-2.0
"""The bridge as processes: model through the service, wrench over shared memory, offset to the controller; the node may die."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain import PERIOD, ROBOT, WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.model.file import save_model
from irec_correction.deflection import Deflection
from irec_correction.shared import WRENCH_SIZE, SharedValues
from irec_sim.devices.rsi_controller import RobotState, RsiController
from ros_side import START, RosSide

pytestmark = [pytest.mark.ros, pytest.mark.alone]
CELL = Path(__file__).parents[2] / "config/cells/afp.yaml"
STATE = RobotState(Q, np.array([1.5, 0.0, 1.2]), np.zeros(3))
STEP = 0.02 * PERIOD + 2e-7
WATCH = 1.5  # s without input until a fault: longer than a busy machine stops the process of the test
OFFSET = np.array([4e-4, -3e-4, 2e-4])  # m


def listening(port: int) -> bool:
    """Whether a process of this machine has this UDP port of 127.0.0.1 open."""
    entry = f"0100007F:{port:04X}"
    return any(line.split()[1] == entry for line in Path("/proc/net/udp").read_text().splitlines()[1:])


class Drive:
    """The controller, and the sensor's shared memory."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.bind(("127.0.0.1", 0))
            self.port = int(s.getsockname()[1])
        self.controller = RsiController(("127.0.0.1", self.port), timeout=10**6)
        self.block, self.rng = SharedValues.create(WRENCH_SIZE), np.random.default_rng(0)
        self.sensor_works = True
        self.load = 1.0  # share of WRENCH

    def wait_for_bridge(self) -> None:
        """A controller that was running before the bridge would get no answer: it might hold a correction."""
        end = time.monotonic() + START
        while not listening(self.port):
            assert time.monotonic() < end, f"nobody listens on port {self.port} within {START} s"
            time.sleep(0.05)

    def state(self) -> RobotState:
        if self.sensor_works:
            noisy = self.load * WRENCH + self.rng.normal(0, 0.2, 6)
            self.block.write(np.array([time.monotonic(), self.controller.counts.cycles, 0.0, *noisy]))
        return STATE

    def cycles(self) -> None:
        """A few, in real time."""
        self.controller.run(5, self.state)

    def until(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (
                f"{what} not within {seconds} s; offset {self.sent[-1]}, {self.controller.counts.late} late"
            )
            self.cycles()

    @property
    def sent(self) -> list[np.ndarray]:
        """Offset that acts in the controller, one per cycle."""
        return self.controller.acted

    @property
    def largest_step(self) -> float:
        """Between two cycles of the controller."""
        return float(np.linalg.norm(np.diff(np.array(self.sent), axis=0), axis=1).max())

    def close(self) -> None:
        self.controller.close()
        self.block.close()


@pytest.fixture
def drive() -> Iterator[Drive]:
    made = Drive()
    yield made
    made.close()


@pytest.fixture
def watcher(ros_domain) -> Iterator[RosSide]:
    made = RosSide("watcher")
    yield made
    made.close()


def start_bridge(start_process, drive: Drive, **parameters: object) -> subprocess.Popen[bytes]:
    given = {
        "cell": CELL, "port": drive.port, "filter.cutoff": 0.0, "watch.wrench_timeout": WATCH, "watch.joints_timeout": WATCH,
        "watch.frozen_after": WATCH, "watch.age_limit": WATCH, "start_load": 10.0, **parameters,
    }  # fmt: skip
    arguments = [item for k, v in given.items() for item in ("-p", f"{k}:={v}")]
    return start_process([sys.executable, "-m", "irec_correction.nodes.rsi_bridge", "--ros-args", *arguments], name="rsi_bridge")


def model_of_cell(folder: Path, name: str = "model", **changes: object) -> Path:
    made = replace(model(), serial="KR120-0001", urdf_sha256=read_cell(CELL).robot.sha256, **changes)  # type: ignore[arg-type]
    return save_model(made, folder / f"{name}.yaml")


def children_of(pid: int) -> list[int]:
    """Processes that a process has started, without Python's own helpers."""
    children = [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [c for c in children if b"resource_tracker" not in Path(f"/proc/{c}/cmdline").read_bytes()]


def test_offset_reaches_the_controller_and_the_loop_outlives_the_node(drive, ros_domain, start_process, tmp_path):
    path = model_of_cell(tmp_path)
    bridge = start_bridge(start_process, drive, wrench_block=drive.block.name, model_path=path)
    drive.wait_for_bridge()
    expected, _ = Deflection(model(), ROBOT)(Q, WRENCH[:3], WRENCH[3:], PERIOD)
    drive.until(lambda: np.linalg.norm(drive.sent[-1] + expected) < 3e-6, START, "offset of the model")
    node = children_of(bridge.pid)
    assert len(node) == 1
    os.kill(node[0], signal.SIGKILL)
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) < 1e-7, START, "offset faded out")
    answered = drive.controller.counts.answered
    drive.until(lambda: drive.controller.counts.answered > answered + 50, START, "answers without the node")
    assert bridge.poll() is None
    assert drive.largest_step <= STEP
    bridge.send_signal(signal.SIGINT)
    assert bridge.wait(START) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "alone", [True, pytest.param(False, marks=pytest.mark.long)], ids=["main process alone", "whole group"]
)
def test_a_signal_to_the_process_alone_or_with_the_node_fades_the_offset_out_and_ends_both_without_an_error(
    drive, ros_domain, start_process, tmp_path, number, alone
):
    bridge = start_bridge(start_process, drive, wrench_block=drive.block.name, model_path=model_of_cell(tmp_path))
    drive.wait_for_bridge()
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) > 5e-4, START, "offset of the model")
    node = children_of(bridge.pid)[0]
    # alone: systemd with KillMode=process, or a launch; the group: a terminal
    (os.kill if alone else os.killpg)(bridge.pid, number)
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) < 1e-7, START, "offset faded out")
    assert bridge.wait(START) == 0
    assert drive.largest_step <= STEP
    assert not Path(f"/proc/{node}").exists()
    told = (tmp_path / "rsi_bridge.log").read_text()
    assert "INACTIVE" in told and not any(wrong in told for wrong in ("unexpected", "Traceback", "has ended", "has gone"))


def test_the_end_of_a_loop_that_was_not_asked_to_end_is_an_error_in_one_line_and_ends_the_node(
    drive, ros_domain, start_process, tmp_path
):
    bridge = start_bridge(start_process, drive, wrench_block=drive.block.name, model_path=model_of_cell(tmp_path))
    drive.wait_for_bridge()
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) > 5e-4, START, "offset of the model")
    node = children_of(bridge.pid)[0]
    bridge.kill()
    bridge.wait(START)
    end = time.monotonic() + START
    while Path(f"/proc/{node}/cmdline").exists() and Path(f"/proc/{node}/cmdline").read_bytes():  # a zombie has none
        assert time.monotonic() < end, "the node lives on without its loop"
        time.sleep(0.05)
    told = (tmp_path / "rsi_bridge.log").read_text()
    assert "the RSI loop has ended without being asked to" in told and "Traceback" not in told


def test_the_service_checks_robot_and_tool_and_the_node_tells_wrench_deflection_and_counters(
    drive, watcher, start_process, tmp_path
):
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped

    from irec_msgs.msg import CorrectionState
    from irec_msgs.srv import ActivateModel

    states = watcher.collect(CorrectionState, "irec/correction/state")
    processed = watcher.collect(WrenchStamped, "irec/wrench_process")
    told = watcher.collect(DiagnosticArray, "/diagnostics")
    start_bridge(start_process, drive, wrench_block=drive.block.name, tool="spindle")
    drive.wait_for_bridge()

    def activate(path: Path):
        request = ActivateModel.Request(model_path=str(path))
        return watcher.call(ActivateModel, "irec/correction/activate_model", request, drive.cycles)

    refused = activate(model_of_cell(tmp_path, "other_tool", tool="roller"))
    assert not refused.success and "'roller'" in refused.message and "'spindle'" in refused.message
    refused = activate(model_of_cell(tmp_path, "no_tool"))
    assert not refused.success and "'spindle' is mounted" in refused.message
    answer = activate(model_of_cell(tmp_path, tool="spindle"))
    assert answer.success, answer.message
    expected, _ = Deflection(model(), ROBOT)(Q, WRENCH[:3], WRENCH[3:], PERIOD)

    def follows() -> bool:
        d = states[-1].deflection if states else None
        return d is not None and states[-1].state == CorrectionState.ACTIVE and abs(d.z - expected[2]) < 3e-6

    watcher.until(follows, "deflection in the state", each=drive.cycles)
    state, w = states[-1], states[-1].wrench_process
    np.testing.assert_allclose([w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z], WRENCH, atol=2.0)
    np.testing.assert_allclose([state.deflection.x, state.deflection.y, state.deflection.z], expected, atol=3e-6)
    assert state.model_sha256 == answer.sha256
    f = processed[-1].wrench.force
    np.testing.assert_allclose([f.x, f.y, f.z], WRENCH[:3], atol=2.0)
    assert processed[-1].header.frame_id == "tool0"

    def values() -> dict[str, str]:
        ours = [s for m in told for s in m.status if s.name == "rsi_bridge: link"]
        return {v.key: v.value for v in ours[-1].values} if ours else {}

    watcher.until(lambda: int(values().get("sessions", 0)) == 1, "diagnostics", each=drive.cycles)
    assert int(values()["answered"]) > 0 and int(values()["ticks"]) > 0
    drive.sensor_works = False
    watcher.until(lambda: int(values().get("fault.wrench_stale", 0)) > 0, "counter of the fault", each=drive.cycles)
    assert drive.largest_step <= STEP


def test_offsets_of_a_topic_are_followed_then_held_and_faded_when_they_stop(drive, watcher, start_process):
    from geometry_msgs.msg import TransformStamped

    from irec_msgs.msg import CorrectionState

    out = watcher.node.create_publisher(TransformStamped, "irec/offset", 50)
    states = watcher.collect(CorrectionState, "rsi_bridge/state")
    start_bridge(start_process, drive, source="offset_topic", offset_timeout=WATCH)
    drive.wait_for_bridge()
    watcher.until(lambda: len(states) > 5, "states before the first offset", each=drive.cycles)
    assert states[-1].state == CorrectionState.INACTIVE and "first offset" in states[-1].reason
    message, frame = TransformStamped(), ["base_link"]
    message.transform.rotation.w = 1.0
    t = message.transform.translation
    t.x, t.y, t.z = OFFSET.tolist()

    def cell() -> None:
        message.header.frame_id = frame[0]
        message.header.stamp = watcher.node.get_clock().now().to_msg()
        out.publish(message)
        drive.cycles()

    def arrived() -> bool:
        return bool(np.linalg.norm(drive.sent[-1] - OFFSET) < 2e-7)

    watcher.until(arrived, "offset of the topic", each=cell)
    at_work = (CorrectionState.RAMP_IN, CorrectionState.ACTIVE)
    watcher.until(lambda: states[-1].state in at_work, "state of an offset at work", each=cell)
    frame[0] = "tool0"
    watcher.until(lambda: states[-1].state == CorrectionState.FAULT, "fault", each=cell)
    assert "'tool0'" in states[-1].reason
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) < 2e-7, START, "offset faded out")
    frame[0] = "base_link"
    t.x = t.y = t.z = 0.0  # as a correction node does that is activated again
    watcher.until(lambda: states[-1].state == CorrectionState.ACTIVE, "start after the fault", each=cell)
    t.x, t.y, t.z = OFFSET.tolist()
    watcher.until(arrived, "offset again", each=cell)
    rival = watcher.node.create_publisher(TransformStamped, "irec/offset", 50)
    watcher.until(lambda: states[-1].state == CorrectionState.FAULT, "fault beside another sender", each=cell)
    assert "2 publishers of /irec/offset" in states[-1].reason
    watcher.node.destroy_publisher(rival)
    assert drive.largest_step <= STEP


@pytest.mark.parametrize(
    ("wrong", "text"), [("frame", "'base_link'"), ("stamp", "from now"), ("sender", "2 publishers of /wrench")]
)  # fmt: skip
def test_a_wrench_by_topic_in_another_frame_of_another_time_or_of_two_senders_is_not_used(
    drive, watcher, start_process, tmp_path, wrong, text
):
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped

    from irec_msgs.msg import CorrectionState

    out = watcher.node.create_publisher(WrenchStamped, "wrench", 50)
    states = watcher.collect(CorrectionState, "irec/correction/state")
    told = watcher.collect(DiagnosticArray, "/diagnostics")
    start_bridge(start_process, drive, model_path=model_of_cell(tmp_path), **{"watch.clock_tolerance": 5.0})
    drive.wait_for_bridge()
    message, sound = WrenchStamped(), [True]

    def cell() -> None:
        w = (WRENCH + drive.rng.normal(0, 0.2, 6)).tolist()
        f, m = message.wrench.force, message.wrench.torque
        f.x, f.y, f.z, m.x, m.y, m.z = w
        message.header.frame_id = "tool0" if sound[0] or wrong != "frame" else "base_link"
        message.header.stamp = watcher.node.get_clock().now().to_msg()
        if wrong == "stamp" and not sound[0]:
            message.header.stamp.sec = 0
        out.publish(message)
        drive.cycles()

    watcher.until(lambda: states and states[-1].state == CorrectionState.ACTIVE, "ACTIVE", each=cell)
    sound[0] = False
    if wrong == "sender":
        watcher.node.create_publisher(WrenchStamped, "wrench", 50)
    watcher.until(lambda: states[-1].state == CorrectionState.FAULT, "fault", each=cell)
    assert text in states[-1].reason
    assert any(text in s.message for m in told for s in m.status)
    assert drive.largest_step <= STEP


def test_the_lifecycle_opens_the_port_sends_offsets_fades_them_and_frees_the_port_twice_over(
    drive, watcher, start_process, tmp_path
):
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    def change(transition: int, each: Callable[[], None] | None = drive.cycles) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(watcher.call(ChangeState, "rsi_bridge/change_state", request, each).success)

    def state() -> int:
        return int(watcher.call(GetState, "rsi_bridge/get_state", GetState.Request()).current_state.id)

    path = model_of_cell(tmp_path)
    bridge = start_bridge(
        start_process, drive, autostart="false", wrench_block=drive.block.name, model_path=path, **{"time.fade": 3.0}
    )
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    expected, _ = Deflection(model(), ROBOT)(Q, WRENCH[:3], WRENCH[3:], PERIOD)
    for _ in range(2):
        assert not listening(drive.port)
        assert change(Transition.TRANSITION_CONFIGURE, each=None)  # RSI is started when there is somebody to answer
        drive.wait_for_bridge()
        drive.controller.start_again()
        answered = drive.controller.counts.answered
        drive.until(lambda a=answered: drive.controller.counts.answered > a + 50, START, "answers while inactive")
        assert np.linalg.norm(drive.sent[-1]) < 1e-7
        assert change(Transition.TRANSITION_ACTIVATE)
        drive.until(lambda: np.linalg.norm(drive.sent[-1] + expected) < 3e-6, START, "offset of the model")
        assert change(Transition.TRANSITION_DEACTIVATE)
        assert not change(Transition.TRANSITION_CLEANUP), "the robot still acts on an offset"
        drive.until(lambda: np.linalg.norm(drive.sent[-1]) < 1e-7, START, "offset faded out")
        watcher.until(lambda: change(Transition.TRANSITION_CLEANUP), "cleanup at zero", each=drive.cycles)
        assert state() == State.PRIMARY_STATE_UNCONFIGURED
        drive.until(lambda: not listening(drive.port), START, "free port")
    assert drive.largest_step <= STEP
    bridge.send_signal(signal.SIGINT)
    assert bridge.wait(START) == 0


def test_it_is_activated_out_of_contact_at_its_start_and_after_a_fault(drive, watcher, start_process, tmp_path):
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    from irec_msgs.msg import CorrectionState

    states = watcher.collect(CorrectionState, "irec/correction/state")

    def state() -> int:
        return int(watcher.call(GetState, "rsi_bridge/get_state", GetState.Request(), drive.cycles).current_state.id)

    def begins() -> None:
        watcher.until(lambda: states and states[-1].state == CorrectionState.ACTIVE, "ACTIVE", each=drive.cycles)

    def load(share: float) -> None:
        for step in np.linspace(drive.load, share, 20):
            drive.load = float(step)
            drive.cycles()

    def activate() -> bool:
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
        return bool(watcher.call(ChangeState, "rsi_bridge/change_state", request, drive.cycles).success)

    start_bridge(start_process, drive, wrench_block=drive.block.name, model_path=model_of_cell(tmp_path), start_load=0.15)
    drive.wait_for_bridge()
    watcher.until(lambda: state() == State.PRIMARY_STATE_INACTIVE, "no start in contact", each=drive.cycles)
    answered = drive.controller.counts.answered
    drive.until(lambda: drive.controller.counts.answered > answered + 50, START, "answers all the same")
    load(0.0)
    assert np.linalg.norm(drive.sent, axis=1).max() < 1e-7 and activate()
    begins()
    load(1.0)
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) > 5e-4, START, "offset")
    assert state() == State.PRIMARY_STATE_ACTIVE
    drive.sensor_works = False
    watcher.until(lambda: state() == State.PRIMARY_STATE_INACTIVE, "the node deactivates itself", each=drive.cycles)
    drive.sensor_works = True
    load(1.0)
    assert not activate() and np.linalg.norm(drive.sent[-1]) < 1e-7, "the robot presses on something"
    load(0.0)
    assert activate()
    begins()
    load(1.0)
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) > 5e-4, START, "offset after the fault")
    assert state() == State.PRIMARY_STATE_ACTIVE
    assert drive.largest_step <= STEP
