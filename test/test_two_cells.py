# SPDX-License-Identifier: Apache-2.0
"""Two cells on one graph, and the end of all nodes by one interrupt: real processes over DDS, started as the launch files do."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from irec_calibration.cell import read_cell
from irec_calibration.effects import find_effect
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.session import read_session
from irec_ros.seen import SeenBy
from quick_cell import quick_cell
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from irec_msgs.action import RunProcedure
from irec_msgs.msg import CorrectionState

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]
CELL = Path(__file__).parents[1] / "config" / "cells" / "afp.yaml"
PATIENCE = 600.0  # s of the machine's clock
TRACES = ("Traceback", "context is invalid", "terminate called")


def node(module: str, namespace: str, **parameters: object) -> list[str]:
    """Arguments as the launch files give them."""
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    rules = ["-r", f"__ns:=/{namespace}", "-r", f"/clock:=/{namespace}/clock"] if namespace else []
    return [sys.executable, "-m", module, "--ros-args", *rules, *settings]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


# a busy machine's gap is held over, or faded out
AT_WORK = (
    CorrectionState.RAMP_IN, CorrectionState.ACTIVE, CorrectionState.HOLD, CorrectionState.FADE, CorrectionState.FAULT,
)  # fmt: skip


def until(listener: Any, condition: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + PATIENCE
    executor = SingleThreadedExecutor()  # rclpy's own may belong to the context of a test before
    executor.add_node(listener)
    try:
        while not condition():
            assert time.monotonic() < end, f"no {what} within {PATIENCE:g} s"
            executor.spin_once(timeout_sec=0.05)
    finally:
        executor.remove_node(listener)
        executor.shutdown()


def a_model(folder: Path) -> Path:
    """Valid about the poses of these tests."""
    cell = read_cell(CELL)
    low, high = np.maximum(cell.home - 1.2, cell.robot.lower), np.minimum(cell.home + 1.2, cell.robot.upper)
    envelope = Envelope(tuple(low.tolist()), tuple(high.tolist()), 1200.0)
    springs = {f"c_{k}": Estimate(1e-7, lower=0.0) for k in range(1, 7)}
    folder.mkdir(exist_ok=True)
    model = Model((Term(find_effect("joint_torsion"), springs),), cell.serial, urdf_sha256=cell.robot.sha256, envelope=envelope)
    save_model(model, folder / "model.yaml")
    return folder / "model.yaml"


def test_two_cells_measure_and_correct_side_by_side_on_one_graph(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    cell = read_cell(CELL)
    poses = write_poses(pose_list(cell, make_plan(cell, 2, pool_size=40)), tmp_path / "poses.yaml")
    model, sessions, sides = a_model(tmp_path / "m"), tmp_path / "sessions", ("left", "right")
    quick = quick_cell(tmp_path)
    for side, speed in zip(sides, (2.0, 1.5), strict=True):
        common = {"cell": quick, "use_sim_time": "true"}
        start_process(node("irec_sim.nodes.cell_node", side, cell=quick, speed_factor=speed), name=f"{side}_cell")
        procedure = node("irec_calibration.nodes.procedure_node", side, **common, session_folder=sessions)
        start_process(procedure, name=f"{side}_procedure")
        correction = node("irec_correction.nodes.correction_node", side, **common, model_path=model)
        start_process(correction, name=f"{side}_correction")
    rclpy.init()
    try:
        listener = rclpy.create_node("operator")
        told: set[str] = set()
        clocks: dict[str, float] = {}
        states: dict[str, int] = {}
        listener.create_subscription(DiagnosticArray, "/diagnostics", lambda m: told.update(s.name for s in m.status), 100)
        for side in sides:
            listener.create_subscription(Clock, f"/{side}/clock", lambda m, s=side: clocks.update({s: m.clock.sec}), 1)
            topic = f"/{side}/irec/correction/state"
            listener.create_subscription(CorrectionState, topic, lambda m, s=side: states.update({s: m.state}), 10)
        runs = {}
        for side in sides:
            client = ActionClient(listener, RunProcedure, f"/{side}/irec/run_procedure")
            until(listener, client.server_is_ready, f"procedure of {side}")
            until(listener, SeenBy.of_action(listener, f"/{side}/irec/run_procedure"), f"procedure of {side} that knows us")
            runs[side] = client.send_goal_async(RunProcedure.Goal(poses_path=str(poses)))
        until(listener, lambda: all(r.done() for r in runs.values()), "answers")
        ends = {side: r.result().get_result_async() for side, r in runs.items()}
        until(listener, lambda: all(e.done() for e in ends.values()), "ends of both runs")
        results = {side: e.result().result for side, e in ends.items()}
        assert all(r.success and r.poses_recorded == 2 for r in results.values()), {s: r.message for s, r in results.items()}
        paths = {r.session_path for r in results.values()}
        assert len(paths) == 2 and all(Path(r.session_path).name.startswith(side) for side, r in results.items())
        assert all(len(read_session(path)) == 12 for path in paths)
        until(listener, lambda: len(clocks) == 2, "two clocks")
        assert listener.count_publishers("/clock") == 0
        tasks = {f"{side}/{task}" for side in sides for task in ("cell: robot", "procedure_node: procedure")}
        until(listener, lambda: tasks <= told, "diagnostics of both cells, each under its name")
        for side in sides:  # the correction of one cell begins, that of the other stays as it is
            before = dict(states)
            lifecycle(listener, f"/{side}/correction_node", ("configure", "activate"))
            activated(listener, side, states)
            other = sides[1 - sides.index(side)]
            assert (states.get(other) in AT_WORK) == (before.get(other) in AT_WORK), (other, before, states)
        listener.destroy_node()
    finally:
        rclpy.try_shutdown()


def activated(listener: Any, side: str, states: dict[str, int]) -> None:
    """Wait until a correction works; where a busy machine's gap was a fault to it, begin anew as an operator does: it is inactive
    then."""
    ended = (CorrectionState.ACTIVE, CorrectionState.FAULT)
    for _ in range(20):
        until(listener, lambda: states.get(side) in ended, f"active correction of {side}")
        if states[side] == CorrectionState.ACTIVE:
            return
        states.pop(side, None)
        lifecycle(listener, f"/{side}/correction_node", ("activate",), patient=True)
    raise AssertionError(f"the correction of {side} ends in a fault each time")


def lifecycle(listener: Any, name: str, transitions: tuple[str, ...], possible: bool = True, patient: bool = False) -> None:
    """Ask for transitions; patient: again until it can be, as a node tells its fault before it is inactive."""
    from lifecycle_msgs.srv import ChangeState

    ids = {"configure": 1, "activate": 3, "deactivate": 4}
    client = listener.create_client(ChangeState, f"{name}/change_state")
    until(listener, client.service_is_ready, f"{name}/change_state")
    until(listener, SeenBy(listener, f"{name}/change_state"), f"{name} that knows the client")
    for transition in transitions:
        request = ChangeState.Request()
        request.transition.id = ids[transition]
        deadline = time.monotonic() + (10.0 if patient else 0.0)
        while True:
            future = client.call_async(request)
            until(listener, future.done, f"answer to {transition}")
            if future.result().success == possible or time.monotonic() > deadline:
                break
            pause = time.monotonic() + 0.1
            until(listener, lambda end=pause: time.monotonic() > end, "the next try")
        assert future.result().success == possible, f"{name}: {transition}; see its log"


def test_all_nodes_run_together_are_managed_refuse_what_is_fixed_and_end_quietly_on_an_interrupt(
    ros_domain: int, start_process: Start, tmp_path: Path
) -> None:
    common, model = {"cell": CELL, "use_sim_time": "true"}, a_model(tmp_path / "m")
    started = {
        "cell": node("irec_sim.nodes.cell_node", "", cell=CELL),
        "procedure": node("irec_calibration.nodes.procedure_node", "", **common, session_folder=tmp_path),
        "calibration": node("irec_calibration.nodes.calibration_node", "", cell=CELL, calibration_folder=tmp_path / "c"),
        "recorder": node("irec_calibration.nodes.recorder_node", "", output=tmp_path / "r", topics="[joint_states, wrench]"),
        "correction": node("irec_correction.nodes.correction_node", "", **common, autostart="true", model_path=model),
        "tracker": node("irec_calibration.nodes.tracker_driver", "", source=f"udp://127.0.0.1:{free_port()}", station="A"),
    }
    processes = {name: start_process(arguments, name=name) for name, arguments in started.items()}
    rclpy.init()
    try:
        listener = rclpy.create_node("operator")
        wanted = {"cell", "procedure_node", "calibration_node", "recorder", "correction_node", "tracker"}
        until(listener, lambda: wanted <= set(listener.get_node_names()), "nodes")
        client = listener.create_client(SetParameters, "/procedure_node/set_parameters")
        until(listener, client.service_is_ready, "parameters")
        until(listener, SeenBy(listener, "/procedure_node/set_parameters"), "procedure_node that knows the client")
        future = client.call_async(SetParameters.Request(parameters=[Parameter("cell", value="x.yaml").to_parameter_msg()]))
        until(listener, future.done, "answer")
        (answer,) = future.result().results
        assert not answer.successful and "read-only" in answer.reason
        runs = ActionClient(listener, RunProcedure, "/irec/run_procedure")
        until(listener, runs.server_is_ready, "procedure")
        until(listener, SeenBy.of_action(listener, "/irec/run_procedure"), "procedure that knows the client")
        lifecycle(listener, "/procedure_node", ("deactivate",))
        for name in ("/procedure_node", "/correction_node"):
            lifecycle(listener, name, ("configure",), possible=False)  # they are configured: refused, and answered
        sent = runs.send_goal_async(RunProcedure.Goal())
        until(listener, sent.done, "answer")
        assert not sent.result().accepted, "it is not active"
        lifecycle(listener, "/procedure_node", ("activate",))
        until(listener, lambda: listener.count_publishers("/irec/correction/state"), "correction")
        listener.destroy_node()
    finally:
        rclpy.try_shutdown()
    for process in processes.values():
        os.killpg(process.pid, signal.SIGINT)  # as launch does
    for name, process in processes.items():
        code = process.wait(60.0)
        said = (tmp_path / f"{name}.log").read_text(errors="replace")
        assert code == 0, f"{name} ended with {code}: {said[-2000:]}"
        assert not [trace for trace in TRACES if trace in said], f"{name}: {said[-2000:]}"
