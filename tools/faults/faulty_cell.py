# SPDX-License-Identifier: Apache-2.0
"""The simulated cell whose driver, instruments, surface and network can be made to fail on demand.

`faults/arm` takes JSON {"id", "fault", "states", "from_pose", "speed"}: the fault begins when `irec/procedure/status` says one of
the states (none: at once), and from then on the simulation runs in real time. {"clear": true, "speed": 8.0} ends it.
`faults/report` says what the robot truly does: number of the fault, time since it began, force, whether it presses or moves.
"""

from __future__ import annotations

import copy
import json
import math
import sys
from collections import deque
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped, WrenchStamped
from irec_ros.startup import run_process
from irec_sim.cell import FAULT, FORCE
from irec_sim.contact import Disc
from irec_sim.errors import SimError
from irec_sim.nodes import cell_node
from irec_sim.nodes.cell_node import CellNode
from irec_sim.nodes.robot_side import RobotSide
from irec_sim.nodes.streams import LATCHED_QOS, ros_time
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from irec_msgs.msg import ProcedureStatus

TOUCH = 30.0  # N of true force: there is contact
HELD = 1.1  # of the largest load case: more is not what the force controller was asked for
REPORTS, REPORTS_IN_FAULT = 50, 10  # steps between two reports
LATE = 1.2  # s by which late wrenches come
AWAY = 0.06  # m by which the surface is missed


class FaultyCell(CellNode):
    """A cell node; see the module."""

    def __init__(self) -> None:
        self.fault, self.number, self.since = "", 0, math.inf
        self._armed: dict[str, Any] | None = None
        self._last: dict[str, Any] = {}
        self._held_back: deque[Any] = deque()
        self._shift = self._max_force = 0.0
        self._last_pressing = self._last_loose = self._last_moving = 0.0
        self._steps = 0
        cell_node.ros_time = self._stamp  # type: ignore[assignment]  # by which each step is stamped
        super().__init__()
        self._sound = self.cell.cell
        waits, self.followers = self.followers, cast(Any, self)  # a fault must not hold the cell's time up
        self._waits = waits
        self._disc = self.cell.arm.disc
        self._report = self.create_publisher(String, "faults/report", 50)
        self.create_subscription(String, "faults/arm", self._on_arm, 10)
        self.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, LATCHED_QOS)

    def _stamp(self, t: float) -> Time:
        return ros_time(max(0.0, t + self._shift))

    def may_go_on(self, now: float) -> bool:
        """In place of the followers'."""
        return bool(self.fault) or self._waits.may_go_on(now)

    # --- when it begins and ends -------------------------------------------------------------------------------------

    def _on_arm(self, message: String) -> None:
        order = json.loads(message.data)
        if order.get("clear"):
            self.loop.call(lambda: self._clear(float(order.get("speed", 1.0))))
        elif not order["states"]:
            self.loop.call(lambda: self._begin(order))
        else:
            self._armed = order

    def _on_status(self, status: ProcedureStatus) -> None:
        order = self._armed
        if order is None or status.state not in order["states"] or status.pose < order.get("from_pose", 1):
            return
        self._armed = None
        self.loop.call(lambda: self._begin(order))

    def _begin(self, order: dict[str, Any]) -> None:
        self.fault, self.number, self.since = order["fault"], int(order["id"]), self.cell.time
        self.loop.speed = float(order.get("speed", 1.0))
        self._max_force = 0.0
        self._last_pressing = self._last_loose = self._last_moving = 0.0
        if self.fault == "slip":
            self.cell.arm.disc = Disc(friction=0.02)
        elif self.fault == "contact missed":
            self.cell.arm.surface = cast(Any, _Moved(self._sound.surface))
        elif self.fault == "e-stop":
            self.cell.freeze()
            self.cell.mode = FAULT
        elif self.fault in ("clock forward", "clock back"):
            self._shift = 1000.0 if self.fault == "clock forward" else -20.0
        self._tell()

    def _clear(self, speed: float) -> None:
        if self.fault == "e-stop" or self.cell.mode == FAULT:
            self.cell.clear_fault()
        self.cell.arm.disc = self._disc
        self.cell.arm.surface = self._sound.surface
        self.fault, self.since, self._shift, self._armed = "", math.inf, 0.0, None
        self._held_back.clear()
        self._last.clear()
        self.loop.speed = speed

    # --- what goes out -----------------------------------------------------------------------------------------------

    def _sender(self, message_class: type, topic: str, fill: Callable[[], Any]) -> Callable[[], None]:
        def spoilt() -> Any:
            message = fill()
            if not self.fault or message is None:
                if message is not None and topic in ("wrench", "tracker/point"):
                    self._last[topic] = message
                return message
            return self._spoil(message_class, topic, message)

        return super()._sender(message_class, topic, spoilt)

    def _spoil(self, kind: type, topic: str, message: Any) -> Any:
        fault = self.fault
        if fault == "partition":
            return None
        wanted = {
            "tracker": "tracker/point", "force": "wrench", "joints": "joint_states", "rail": "joint_states",
        }.get(fault.split()[0])  # fmt: skip
        if topic != wanted:
            return message
        what = fault.split(maxsplit=1)[1]
        if what in ("beam", "silent", "gap"):
            return None
        if what == "late":
            self._held_back.append((self.cell.time, message))
            return self._held_back.popleft()[1] if self._held_back[0][0] <= self.cell.time - LATE else None
        m = deserialize_message(bytes(message), kind) if isinstance(message, bytes) else copy.deepcopy(message)
        if what == "frozen" and topic in self._last:
            before = deserialize_message(bytes(self._last[topic]), kind)
            before.header.stamp = m.header.stamp
            return before
        return _CHANGES[fault](m)

    # --- what comes in -----------------------------------------------------------------------------------------------

    def refuses(self, what: str) -> str:
        """Why a command is not carried out now; `gone`: it never arrives."""
        if self.fault == "partition":
            return "gone"
        return "the mode selector at the cabinet is locked" if self.fault == "mode refused" and what == "mode" else ""

    # --- what truly happens ------------------------------------------------------------------------------------------

    def _step(self) -> None:
        super()._step()
        if self.since < math.inf:
            self._look()
        self._steps += 1
        if self._steps % (REPORTS_IN_FAULT if self.fault else REPORTS) == 0:
            self._tell()

    def _look(self) -> None:
        t, cell = self.cell.time - self.since, self.cell
        force = cell.true_force()
        size = float(np.linalg.norm(force))
        self._max_force = max(self._max_force, size)
        if cell.mode == FORCE or (size > TOUCH and cell.mode != FAULT):
            self._last_pressing = t
            if size > HELD * float(np.linalg.norm(self._sound.load_cases, axis=1).max()):
                self._last_loose = t
        if self.robot.in_motion:
            self._last_moving = t

    def _tell(self) -> None:
        running = self.since < math.inf
        self._outbox.append((self._report, String(data=json.dumps({
            "id": self.number if running else 0, "t": self.cell.time - self.since if running else 0.0,
            "time": self.cell.time, "mode": int(self.cell.mode), "force": float(np.linalg.norm(self.cell.true_force())),
            "max_force": self._max_force, "last_pressing": self._last_pressing, "last_loose": self._last_loose,
            "last_moving": self._last_moving, "expired": self.robot.lease.expired, "retreating": self.robot.retreating,
            "moving": self.robot.in_motion,
        }))))  # fmt: skip


class _Moved:
    """A surface that is elsewhere."""

    def __init__(self, surface: Any) -> None:
        self._surface = surface

    def __getattr__(self, name: str) -> Any:
        return getattr(self._surface, name)

    def gap(self, p: np.ndarray) -> tuple[float, np.ndarray]:
        distance, normal = self._surface.gap(p)
        return distance + AWAY, normal


def _change_force(x: float, y: float, z: float) -> Callable[[WrenchStamped], WrenchStamped]:
    def change(m: WrenchStamped) -> WrenchStamped:
        f = m.wrench.force
        f.x, f.y, f.z = f.x + x, f.y + y, f.z + z
        return m

    return change


def _saturated(m: WrenchStamped) -> WrenchStamped:
    m.wrench.force.z = -2500.0  # range of the sensor; the other axes go on
    return m


def _jumped(m: PointStamped) -> PointStamped:
    m.point.x, m.point.y, m.point.z = m.point.x + 3e-3, m.point.y + 3e-3, m.point.z + 3e-3
    return m


def _short(m: Any) -> Any:
    m.position = m.position[:3]
    return m


def _renamed(m: Any) -> Any:
    m.name = [f"axis_{k}" for k in range(1, len(m.name) + 1)]
    return m


def _rail(m: Any) -> Any:
    m.position[-1] += 0.3
    return m


_CHANGES: dict[str, Callable[[Any], Any]] = {
    "tracker jump": _jumped,
    "force saturated": _saturated,
    "force biased": _change_force(0.0, 0.0, -300.0),
    "force NaN": _change_force(math.nan, 0.0, 0.0),
    "joints length": _short,
    "joints names": _renamed,
    "rail elsewhere": _rail,
}


def _with_refusals(node: type[FaultyCell]) -> None:
    """Commands pass the fault first; callbacks are bound when RobotSide is made, so its class is changed before."""
    force, mode, start = RobotSide._on_force, RobotSide._on_mode, RobotSide._start

    def on_force(self: RobotSide, message: Any) -> None:
        if not self._node.refuses("force"):  # type: ignore[attr-defined]
            force(self, message)

    def on_mode(self: RobotSide, request: Any, response: Any) -> Any:
        why = self._node.refuses("mode")  # type: ignore[attr-defined]
        if why:
            response.success, response.message = False, why
            response.force_lease = float(self.lease.settings.hold)
            return response
        return mode(self, request, response)

    def start_move(self: RobotSide, handle: Any, ended: Any) -> None:
        why = self._node.refuses("move")  # type: ignore[attr-defined]
        if why:
            raise SimError(why)
        start(self, handle, ended)

    RobotSide._on_force, RobotSide._on_mode, RobotSide._start = on_force, on_mode, start_move  # type: ignore[method-assign]


def main() -> int:
    """As cell_node."""
    _with_refusals(FaultyCell)
    return run_process("cell", lambda asked_to_stop: cell_node.run(FaultyCell(), asked_to_stop), SimError)


if __name__ == "__main__":
    sys.exit(main())
