# SPDX-License-Identifier: Apache-2.0
"""The node as a process: activated by its service, it streams the offset and fades out when the sensor dies."""

from __future__ import annotations

import shutil
import sys

import numpy as np
import pytest
from cell_side import CELL, START, CellSide, afp_model
from chain import WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.recertification.store import Store
from irec_correction.deflection import Deflection

pytestmark = [pytest.mark.ros, pytest.mark.paced]


@pytest.fixture
def cell_side(ros_domain, start_process, tmp_path):
    start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={with_tool(tmp_path)}",
        "-p", "autostart:=true", "-p", "start_load:=10.0", "-p", "watch.wrench_timeout:=2.0", "-p", "watch.joints_timeout:=2.0",
        "-p", "watch.age_limit:=2.0", "-p", "filter.cutoff:=20.0", "-p", "output:=both",
    ], name="correction")  # fmt: skip
    side = CellSide()
    yield side
    side.close()


def with_tool(folder):
    """The cell file, with a name for the tool."""
    path = folder / "cell.yaml"
    text = CELL.read_text().replace("../robots/", f"{CELL.parent.parent / 'robots'}/")
    path.write_text(text.replace("\ntool:\n", "\ntool:\n  name: roller\n"))
    return path


def test_activated_node_streams_minus_the_deflection_and_fades_out_when_the_sensor_dies(cell_side, tmp_path):
    refused = cell_side.activate(afp_model(tmp_path, serial="SOMEONE-ELSE"))
    assert not refused.success and "SOMEONE-ELSE" in refused.message
    refused = cell_side.activate(str(tmp_path / "missing.yaml"))
    assert not refused.success and "missing.yaml" in refused.message
    for tool in ("", "spindle"):  # the cell file names another
        refused = cell_side.activate(afp_model(tmp_path, tool=tool))
        assert not refused.success and "'roller' is mounted" in refused.message
    answer = cell_side.activate(afp_model(tmp_path, tool="roller"))
    assert answer.success, answer.message
    cell_side.until(lambda: cell_side.states and cell_side.states[-1].state == 2, what="ACTIVE")
    assert cell_side.states[-1].model_sha256 == answer.sha256
    expected, _ = Deflection(model(), read_cell(CELL).robot)(Q, WRENCH[:3], WRENCH[3:], 0.004)
    # a busy machine skips ticks, and each one moves by one step of the rate limit at most
    cell_side.until(lambda: np.linalg.norm(cell_side.offsets[-1] + expected) < 5e-6, what="offset of the model")
    check_joint_offset(cell_side.joint_offset(), expected)
    cell_side.publishing = False
    cell_side.until(lambda: cell_side.states[-1].state == 5, what="FAULT")
    assert "no wrench" in cell_side.states[-1].reason
    cell_side.until(lambda: any("fault.wrench_stale" in str(d) for d in cell_side.diagnostics), what="diagnostics")
    cell_side.until(lambda: np.linalg.norm(cell_side.offsets[-1]) < 1e-8, what="no offset")
    steps = np.linalg.norm(np.diff(np.array([np.zeros(3), *cell_side.offsets]), axis=0), axis=1)
    assert steps.max() <= 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two
    activate_again(cell_side)


def activate_again(side):
    """Out of FAULT by the lifecycle's own `activate`, with no `deactivate` before it."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    side.publishing = True
    change = side.node.create_client(ChangeState, "correction_node/change_state")
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
    assert side.call(change, request).success
    side.until(lambda: side.states[-1].state == 2, what="ACTIVE again")


def test_a_node_that_comes_back_takes_the_calibration_in_force_and_waits_to_be_activated(
    ros_domain, start_process, tmp_path
):
    store = Store(tmp_path, read_cell(CELL).serial)
    (tmp_path / "new").mkdir()
    path = afp_model(tmp_path / "new")
    shutil.move(path, tmp_path / "new" / "model.yaml")
    entry = store.put_in_force(store.add(tmp_path / "new", "recalibrated", "M").calibration, "M")
    start = [sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
             "-p", "autostart:=true", "-p", "start_load:=10.0", "-p", f"calibrations:={tmp_path}"]  # fmt: skip
    first = start_process(start, name="correction")
    side = CellSide()
    try:
        side.until(lambda: side.states and side.states[-1].model_sha256 == entry.model_sha256, START, "the model in force")
        assert side.states[-1].state == 0, "INACTIVE until somebody asks"
        first.kill()
        first.wait()
        side.states.clear()
        stored = store.model_path(entry.calibration)
        stored.write_text(stored.read_text() + "# changed by hand")
        start_process(start, name="changed")
        side.until(lambda: side.states and any("was changed since" in str(d) for d in side.diagnostics), START, "the reason")
        assert side.states[-1].model_sha256 == "" and side.states[-1].state == 0
        answer = side.activate(afp_model(tmp_path))
        assert answer.success, answer.message
        side.until(lambda: side.states[-1].state == 2, what="ACTIVE")
    finally:
        side.close()


def check_joint_offset(message, deflection):
    """The joints, named as the driver names them, move the TCP against the deflection."""
    robot = read_cell(CELL).robot
    assert tuple(message.joint_names) == robot.joint_names
    at = robot.kinematics(np.array([Q, Q + np.array(message.points[0].positions)]))
    np.testing.assert_allclose(at.p_tcp[1] - at.p_tcp[0], -deflection, atol=2e-5)
