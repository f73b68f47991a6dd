# SPDX-License-Identifier: Apache-2.0
"""The command that stands in for ros2 where ROS 2 comes from wheels does what the documents do with ros2."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMMAND = ROOT / "tools" / "local_ros" / "ros2" / "ros2.py"
CELL = ROOT / "config" / "cells" / "afp.yaml"
START = 90.0  # s for a process to come up on a busy machine
pytestmark = pytest.mark.ros


def ros2(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(COMMAND), *arguments], capture_output=True, text=True, timeout=START)


def said(*arguments: str, code: int = 0) -> str:
    done = ros2(*arguments)
    assert done.returncode == code, f"{arguments}: {done.returncode}\n{done.stdout}{done.stderr}"
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def start(start_process, package: str, executable: str, *parameters: str) -> subprocess.Popen[bytes]:
    given = [x for p in parameters for x in ("-p", p)]
    command = [sys.executable, str(COMMAND), "run", package, executable, "--ros-args", *given]
    return start_process(command, name=executable)


def until(condition, what: str) -> None:
    end = time.monotonic() + START
    while not condition():
        assert time.monotonic() < end, f"{what} not within {START:g} s"
        time.sleep(0.1)


def test_a_node_is_run_configured_set_and_watched_and_ended_by_a_signal(ros_domain, start_process, tmp_path):
    node = start(start_process, "irec_correction", "correction_node", f"cell:={CELL}")
    until(lambda: "unconfigured" in ros2("lifecycle", "get", "/correction_node").stdout, "correction_node")
    assert "can't activate now; it can configure" in said("lifecycle", "set", "/correction_node", "activate", code=1)
    assert "Transitioning successful" in said("lifecycle", "set", "/correction_node", "configure")
    assert "inactive [2]" in said("lifecycle", "get", "/correction_node")
    assert "Set parameter successful" in said("param", "set", "/correction_node", "limit.translation", "0.0003")
    assert "value: 0.0003" in said("param", "get", "/correction_node", "limit.translation")
    assert "out of range" in said("param", "set", "/correction_node", "limit.translation", "-1.0", code=1)
    assert "no parameter 'limit'" in said("param", "get", "/correction_node", "limit", code=1)
    state = said("topic", "echo", "--once", "/irec/correction/state")
    assert "state: 0\n" in state and "frame_id: base_link" in state and state.endswith("---\n")
    service, kind = "/irec/correction/activate_model", "irec_msgs/srv/ActivateModel"
    assert "read the model" in said("service", "call", service, kind, f"{{model_path: {tmp_path}/no.yaml}}", code=1)
    assert "has no field 'path'" in said("service", "call", service, kind, "{path: a}", code=2)
    node.send_signal(signal.SIGINT)
    assert node.wait(START) == 0


def test_a_goal_is_sent_with_its_feedback_and_cancelled_by_ctrl_c(ros_domain, start_process):
    start(start_process, "irec_sim", "cell_node", f"cell:={CELL}", "speed_factor:=4.0")
    said("topic", "echo", "--once", "robot/state")
    goal = "{kind: 0, joint_names: [joint_1], joint_position: [0.1], speed: 0.5}"
    told = said("action", "send_goal", "--feedback", "robot/move", "irec_msgs/action/Move", goal)
    assert "Feedback:\n    fraction: " in told and "    success: true" in told and "with status: SUCCEEDED" in told
    home = "[0.0, -1.9, 1.9, 0.0, 0.8, 0.0]"
    goal = f"{{kind: 0, joint_names: [{', '.join(f'joint_{k}' for k in range(1, 7))}], joint_position: {home}, speed: 0.1}}"
    sent = subprocess.Popen(
        [sys.executable, str(COMMAND), "action", "send_goal", "--feedback", "robot/move", "irec_msgs/action/Move", goal],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert sent.stdout is not None
    lines = []
    for line in sent.stdout:
        lines.append(line)
        if line.startswith("Feedback"):
            sent.send_signal(signal.SIGINT)
            break
    rest, _ = sent.communicate(timeout=START)
    assert "Goal accepted\n" in lines and "Goal finished with status: CANCELED" in rest and sent.returncode == 1
    assert "takes a double, not 'fast'" in said(
        "action", "send_goal", "robot/move", "irec_msgs/action/Move", "{speed: fast}", code=2
    )


def test_what_it_does_not_know_is_said_with_the_place_where_to_look(ros_domain):
    assert "Without the command ros2" in said("launch", "irec_sim", "cell.launch.py", code=2)
    assert "## Without the command ros2\n" in (ROOT / "docs" / "commissioning.md").read_text(encoding="utf-8")
    assert "it has cell_node" in said("run", "irec_sim", "cell", code=2)
    assert "irec_sim" in said("pkg", "prefix", "--share", "irec_sim")
    assert "is no srv" in said("service", "call", "/a", "irec_msgs/srv/Nothing", code=2)


def test_every_ros2_command_of_the_documents_is_one_that_it_knows_or_has_a_line_for():
    text = "\n".join(p.read_text(encoding="utf-8") for p in [ROOT / "README.md", ROOT / "docs" / "commissioning.md"])
    used = set(re.findall(r"^\s*ros2 (\w+)(?: (\w+))?", text, re.M)) | set(re.findall(r"`ros2 (\w+)(?: (\w+))? ", text))
    known = COMMAND.read_text(encoding="utf-8").split('"""')[1]
    table = text[text.index("| in place of | write |") :].split("\n\n")[0]
    missing = [
        " ".join(words)
        for words in sorted(used)
        if f"ros2 {words[0]} " not in table
        and f"ros2 {' '.join(words)} " not in known
        and not (words[0] == "run" and "ros2 run PACKAGE" in known)
    ]
    assert used and not missing
