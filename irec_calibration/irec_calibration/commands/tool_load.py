# SPDX-License-Identifier: Apache-2.0
"""`irec tool-load BAG`: mass, centre of mass and bias from a recording in which the tool was turned without touching anything."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from ..errors import RecordingError, RobotError
from ..files import check_replaceable, write_file
from ..files.outputs import beginning
from ..joint_states import contradiction, named_twice
from ..recording import BagReader
from ..robot import Robot, parent_joint
from ..sensors.tool_load import Standing, ToolLoad, ToolLoadFit, identify_tool_load, standing
from ..typing import Array


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, help="an .mcap file or a rosbag2 folder with raw wrenches and joint states")
    parser.add_argument("--urdf", type=Path, help="robot description (default: robot_description or robot.urdf of the recording)")
    parser.add_argument("--wrench", default="wrench_raw", metavar="TOPIC", help="raw readings (default: wrench_raw)")
    parser.add_argument("--joints", default="joint_states", metavar="TOPIC", help="joint states (default: joint_states)")
    parser.add_argument("--frame", default="ft_sensor", help="link in which the sensor measures (default: ft_sensor)")
    parser.add_argument("--alignment", action="store_true", help="also identify how the sensor is turned against that link")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument(
        "-o", "--output", type=Path, help="write parameters of correction_node, rsi_bridge, ros2_control_driver to this YAML file"
    )


def run(args: argparse.Namespace) -> int:
    """0: identified."""
    recorded = _read(args)
    robot = Robot.from_urdf(args.urdf) if args.urdf else recorded.robot
    found = standing(recorded.q_stamp, recorded.q_of(robot), recorded.wrench_stamp, recorded.wrench)
    R = _R_sensor(robot, args.frame, found)
    fit = identify_tool_load(found.readings, R, alignment=args.alignment)
    if args.output:
        check_replaceable(args.output, "a parameter file of a tool load", (beginning("# Identified by irec tool-load"),))
        write_file(args.output, parameter_file(fit.load, fit.se))
    print(json.dumps(_as_dict(fit), indent=2) if args.json else describe(fit))
    if args.output and not args.json:
        print(f"wrote {args.output}")
    return 0


class _Recorded:
    """Joint states, raw wrenches and the robot description of a recording."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.names: list[str] = []
        self._q: list[tuple[float, list[float]]] = []
        self._w: list[tuple[float, list[float]]] = []
        self.description = ""

    def add_joints(self, message: Any) -> None:
        if not self.names:
            self.names = list(message.name)
        if why := contradiction(named_twice(message.name, set(message.name)), message.position):
            raise RecordingError(f"{self.path}: joint states: {why}")
        if list(message.name) == self.names:
            self._q.append((_seconds(message.header.stamp), list(message.position)))

    def add_wrench(self, message: Any) -> None:
        f, t = message.wrench.force, message.wrench.torque
        self._w.append((_seconds(message.header.stamp), [f.x, f.y, f.z, t.x, t.y, t.z]))

    def check(self, joints: str, wrench: str) -> None:
        for rows, topic in ((self._q, joints), (self._w, wrench)):
            if not rows:
                raise RecordingError(f"{self.path}: no message on '{topic}'; irec inspect shows what is in it")

    @property
    def robot(self) -> Robot:
        if not self.description:
            raise RobotError(
                f"{self.path}: no robot_description in the recording and no robot.urdf attached; name one with --urdf"
            )
        return Robot(self.description, f"{self.path}: robot_description")

    @property
    def q_stamp(self) -> Array:
        return np.array([t for t, _ in self._q])

    @property
    def wrench_stamp(self) -> Array:
        return np.array([t for t, _ in self._w])

    @property
    def wrench(self) -> Array:
        return np.array([w for _, w in self._w])

    def q_of(self, robot: Robot) -> Array:
        missing = [n for n in robot.joint_names if n not in self.names]
        if missing:
            raise RecordingError(f"{self.path}: joint states without {', '.join(missing)}; the recording is of another robot")
        columns = [self.names.index(n) for n in robot.joint_names]
        return np.array([q for _, q in self._q])[:, columns]


def _read(args: argparse.Namespace) -> _Recorded:
    bag, out = BagReader(args.bag), _Recorded(args.bag)
    for message in bag.messages():
        name = message.topic.name.lstrip("/")
        if name == args.joints.lstrip("/"):
            out.add_joints(bag.decode(message))
        elif name == args.wrench.lstrip("/"):
            out.add_wrench(bag.decode(message))
        elif name == "robot_description":
            out.description = bag.decode(message).data
    if not out.description and "robot.urdf" in bag.attachments:
        out.description = bag.attachments["robot.urdf"].decode("utf-8", errors="replace")
    out.check(args.joints, args.wrench)
    return out


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _R_sensor(robot: Robot, frame: str, found: Standing) -> Array:
    model = pin.buildModelFromXML(robot.completed_urdf)
    if not model.existFrame(frame):
        raise RobotError(f"{robot.source}: no link '{frame}' for the force sensor; name it with --frame")
    sensor, tool = model.frames[model.getFrameId(frame)], model.frames[model.getFrameId("tool0")]
    if parent_joint(sensor) != parent_joint(tool):
        raise RobotError(f"{robot.source}: link '{frame}' is not fixed to tool0")
    in_tool = np.array(tool.placement.actInv(sensor.placement).rotation)
    return robot.kinematics(found.q).R_tool @ in_tool if len(found.q) else np.zeros((0, 3, 3))


def describe(fit: ToolLoadFit) -> str:
    """The result as text."""
    units = {"mass": "kg", "com": "m", "bias_force": "N", "bias_torque": "N m", "alignment": "rad"}
    lines = [f"{fit.orientations} orientations, spread {fit.spread:.2f} (0.15 is the least, 0.58 the best)"]
    for name, se in fit.se.items():
        value = getattr(fit.load, name)
        values, errors = (value, se) if isinstance(value, tuple) and isinstance(se, tuple) else ((value,), (se,))
        text = "  ".join(f"{v:10.5g} (se {e:.2g})" for v, e in zip(values, errors, strict=True))
        lines.append(f"{name:12} {text}  {units[name]}")
    worst, off = fit.worst
    lines.append(
        f"residual {fit.residual_force:.3g} N, {fit.residual_torque:.3g} N m; orientation {worst + 1} fits worst, {off:.3g} N"
    )
    return "\n".join(lines)


def _as_dict(fit: ToolLoadFit) -> dict[str, Any]:
    load = {name: getattr(fit.load, name) for name in fit.se}
    rest = {k: v for k, v in asdict(fit).items() if k not in ("load", "se")}
    return {**load, "se": fit.se, **rest}


def parameter_file(load: ToolLoad, names: Iterable[str]) -> str:
    """Text of a parameter file with these fields of a tool load, for whoever takes raw readings: the correction or a driver."""
    values = {k: list(v) if isinstance(v, tuple) else v for k, v in ((n, getattr(load, n)) for n in names)}
    tree: dict[str, Any] = {"/**": {"ros__parameters": {"tool_load": values}}}
    for node in ("correction_node", "rsi_bridge"):  # a driver removes the weight from readings that are raw anyway
        tree[f"/**/{node}"] = {"ros__parameters": {"raw_wrench": True}}  # each its own: rcl refuses aliases of YAML
    return "# Identified by irec tool-load: kg, m, N, N m, rad\n" + yaml.safe_dump(tree, sort_keys=False)
