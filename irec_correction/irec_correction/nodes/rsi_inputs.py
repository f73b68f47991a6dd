# SPDX-License-Identifier: Apache-2.0
"""What comes in by topics for the RSI loop, checked and written to shared memory; the loop is told what was refused and why."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TransformStamped, WrenchStamped

from ..rsi.sources import OFFSET_SIZE
from ..shared import WRENCH_SIZE, SharedValues
from ..topic_check import TopicCheck
from ..watchdog import Fault, Finding
from .chain_clock import ChainClock

LARGEST_OFFSET = 0.05  # m and rad; the limits of the bridge are smaller still
UNIT = 1e-3  # by which a quaternion may miss the length of one

Refuse = Callable[[str, Finding | None], None]


class RsiInputs:
    """Messages into the loop's shared memory.

    Attributes:
        refused: source -> why its messages are not used now.
        closed: the blocks are gone; what still comes is dropped.
    """

    def __init__(
        self, clock: ChainClock, wrench_frame: str, tolerance: float, wrench_range: float, refuse: Refuse,
        other_senders: Callable[[], str] = str,
    ) -> None:  # fmt: skip
        """Args: tolerance: between stamp and now, s. wrench_range: N or N m. refuse: tells the loop (source, why or None).
        other_senders: that send offsets beside the one that is followed, empty where there are none."""
        self._clock, self._refuse, self._other_senders = clock, refuse, other_senders
        self.wrench, self.offset = SharedValues.create(WRENCH_SIZE), SharedValues.create(OFFSET_SIZE)
        self.refused: dict[str, Finding] = {}
        self.closed = False
        self._count = 0
        self._wrench_check = TopicCheck(
            "wrench", wrench_frame, tolerance, wrench_range, Fault.WRENCH_FRAME, Fault.WRENCH_CLOCK, Fault.WRENCH_RANGE
        )
        self._offset_check = TopicCheck(
            "offset", "base_link", tolerance, LARGEST_OFFSET, Fault.OFFSET_FRAME, Fault.OFFSET_CLOCK, Fault.OFFSET_NOT_FINITE
        )

    def take_wrench(self, message: WrenchStamped) -> None:
        """One reading."""
        if self.closed:
            return
        f, t = message.wrench.force, message.wrench.torque
        values = f.x, f.y, f.z, t.x, t.y, t.z
        stamp, now = self._clock.of(message.header.stamp), self._clock.now()
        if self._accept("wrench topic", self._wrench_check.finding(message.header.frame_id, stamp, now, values)):
            self._count += 1
            self.wrench.write(np.array([_steady(stamp, now), self._count, 0.0, *values]))

    def take_offset(self, message: TransformStamped) -> None:
        """One offset that somebody else has computed."""
        if self.closed:
            return
        t, r = message.transform.translation, message.transform.rotation
        turn = rotation_vector(r.x, r.y, r.z, r.w)
        stamp, now = self._clock.of(message.header.stamp), self._clock.now()
        finding = self._offset_check.finding(message.header.frame_id, stamp, now, (t.x, t.y, t.z, *turn))
        length = float(np.linalg.norm([r.x, r.y, r.z, r.w]))
        if finding is None and abs(length - 1.0) > UNIT:
            finding = Finding(Fault.OFFSET_NOT_FINITE, f"offset holds a quaternion of length {length:g}, 1 is needed")
        if others := self._other_senders():
            finding = Finding(Fault.OTHER_SENDER, others)
        if self._accept("offset topic", finding):
            self.offset.write(np.array([_steady(stamp, now), 1.0, t.x, t.y, t.z, *turn]))

    def _accept(self, source: str, finding: Finding | None) -> bool:
        """Tell the loop when a source begins to be refused, for another reason, or is sound again."""
        before = self.refused.get(source)
        if (finding.fault if finding else None) is not (before.fault if before else None):
            self._refuse(source, finding)
        if finding is None:
            self.refused.pop(source, None)
        else:
            self.refused[source] = finding
        return finding is None


def rotation_vector(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Of a unit quaternion, (3,), rad."""
    sign = -1.0 if w < 0.0 else 1.0
    v = sign * np.array([x, y, z])
    sine = float(np.linalg.norm(v))
    a, b, c = (v * (2.0 * np.arctan2(sine, sign * w) / sine) if sine > 1e-12 else 2.0 * v).tolist()
    return a, b, c


def _steady(stamp: float, now: float) -> float:
    """The same moment by the clock of the loop; a stamp ahead of now counts as now."""
    return time.monotonic() - max(0.0, now - stamp)
