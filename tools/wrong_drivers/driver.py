# SPDX-License-Identifier: Apache-2.0
"""A driver that is wrong on purpose: the simulated cell with one fault of the contract, to be named in parameter `fault`.

    python tools/wrong_drivers/driver.py --ros-args -p cell:=afp -p fault:="wrench in base_link"

Parameter `fault` can be set at any time; empty: the driver keeps the contract.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from irec_ros.parameters import P, Parameters
from irec_ros.startup import run_process
from irec_sim.errors import SimError
from irec_sim.nodes.cell_node import CellNode, run
from rclpy.exceptions import ParameterException
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from irec_msgs.msg import RobotState

Change = Callable[[Any], Any]  # of a message; None: it is not sent


def _framed(frame: str) -> Change:
    def change(m: Any) -> Any:
        m.header.frame_id = frame
        return m

    return change


def _in_degrees(m: JointState) -> JointState:
    m.position = [math.degrees(v) if name != "ext_rail" else v for name, v in zip(m.name, m.position, strict=True)]
    return m


def _named_otherwise(m: JointState) -> JointState:
    m.name = [f"a{k}" for k, _ in enumerate(m.name, 1)]
    return m


def _unstamped(m: Any) -> Any:
    m.header.stamp.sec = m.header.stamp.nanosec = 0
    return m


def _in_mm(m: PointStamped) -> PointStamped:
    m.point.x, m.point.y, m.point.z = 1e3 * m.point.x, 1e3 * m.point.y, 1e3 * m.point.z
    return m


def _at_the_flange(m: PoseStamped) -> PoseStamped:
    m.pose.position.z += 0.2
    return m


def _sign_turned(m: WrenchStamped) -> WrenchStamped:
    f = m.wrench.force
    f.x, f.y, f.z = -f.x, -f.y, -f.z
    return m


def _silent(_: Any) -> None:
    return None


FAULTS: dict[str, tuple[str, type, Change]] = {  # topic, its type, what is done to each message
    "wrench in base_link": ("wrench", WrenchStamped, _framed("base_link")),
    "tcp_pose in world": ("tcp_pose", PoseStamped, _framed("world")),
    "joint angles in degrees": ("joint_states", JointState, _in_degrees),
    "joints of other names": ("joint_states", JointState, _named_otherwise),
    "stamps of 0": ("joint_states", JointState, _unstamped),
    "tcp_pose of the flange": ("tcp_pose", PoseStamped, _at_the_flange),
    "marker in mm": ("tracker/point", PointStamped, _in_mm),
    "another station": ("tracker/point", PointStamped, _framed("leica")),
    "sign of the force turned": ("wrench", WrenchStamped, _sign_turned),
    "robot/state silent": ("robot/state", RobotState, _silent),
    "tcp_pose silent": ("tcp_pose", PoseStamped, _silent),
    "tracker silent": ("tracker/point", PointStamped, _silent),
}
IGNORED = "set point ignored"  # the one fault that is no message of the driver
PARAMETERS = (P("fault", "", f"empty, or one of: {', '.join((*FAULTS, IGNORED))}", settable=True),)


class WrongDriver(CellNode):
    """The simulated cell; what it sends passes through the fault."""

    _fault = ""

    def __init__(self) -> None:
        super().__init__()
        self._own = Parameters(self, PARAMETERS)
        self._own.when_set("fault", self._set)
        self._set(self._own["fault"])
        take = self.cell.set_force
        self.cell.set_force = lambda force: None if self._fault == IGNORED else take(force)  # type: ignore[method-assign]

    def _set(self, fault: str) -> None:
        if fault and fault != IGNORED and fault not in FAULTS:
            known = ", ".join((*FAULTS, IGNORED))
            raise ParameterException(f"parameter 'fault' is '{fault}'; one of {known} is needed", ["fault"])
        self._fault = fault

    def _sender(self, message_class: type, topic: str, fill: Callable[[], Any]) -> Callable[[], None]:
        def filled() -> Any:
            message = fill()
            of, kind, change = FAULTS.get(self._fault, ("", None, None))
            if of != topic or message is None or change is None:
                return message
            return change(deserialize_message(message, kind) if isinstance(message, bytes) else message)

        return super()._sender(message_class, topic, filled)


def main() -> int:
    """Until SIGINT or SIGTERM."""
    return run_process("wrong driver", lambda asked_to_stop: run(WrongDriver(), asked_to_stop), SimError)


if __name__ == "__main__":
    sys.exit(main())
