# SPDX-License-Identifier: Apache-2.0
"""Level `offset`: the correction channel in free air. Limits, hold, fade, latency; by robot/state and by where the TCP goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import Array
from .observed import Item, Observation

LEVEL = "offset"
APPLIED = 1e-4  # m
LARGEST = 0.01  # m that a driver may ever apply
LATENCY = 0.5  # s from the first offset to the first sign of it: it may be faded in
HOLD = 0.05  # s after the last offset in which it is still there
FADED_AFTER = 1.0  # s after the last offset in which it is gone: 0.1 s and a fade of 0.5 s, and the rate of robot/state
STEP = 5e-4  # m between two messages of tcp_pose
SENT_WITHIN = 0.05  # s from one offset to the next; a driver may begin to fade it out after 0.1 s without one


@dataclass(frozen=True)
class Offsets:
    """What was sent and seen: a small offset (3,), m, at 250 Hz from `begin` to `end`, s; the same with a far too large one.

    Attributes:
        without: longest time between `begin` and `end` in which no small offset was sent, s.
    """

    small: Array
    begin: float
    end: float
    seen: Observation
    large: Array
    large_seen: Observation
    without: float


def judge_offset(o: Offsets) -> list[Item]:
    """All items of the level."""
    items: list[Item] = []

    def item(name: str, passed: bool | None, figure: str, limit: str, advice: str) -> None:
        """passed: None where it could not be checked."""
        items.append(Item(LEVEL, name, bool(passed), figure, limit, advice, passed is not None))

    s, tcp = o.seen.streams.get("robot/state"), o.seen.streams.get("tcp_pose")
    if s is None or tcp is None or len(s.stamp) < 5 or len(tcp.stamp) < 5:
        item("robot/state and tcp_pose", False, "too few messages", "", "publish both")
        return items
    item(
        "offsets are sent in time",
        True if o.without <= SENT_WITHIN else None,
        f"{o.without:.2f} s without one",
        f"{SENT_WITHIN:g} s",
        "this tells nothing of the driver: this computer, or the wrench that each offset is sent with, stood still; check again",
    )
    if o.without > SENT_WITHIN:
        return items
    applied = s.value[:, 2:5]
    inside = (s.stamp > o.begin + 0.5 * (o.end - o.begin)) & (s.stamp <= o.end)
    off = float(np.abs(applied[inside] - o.small).max()) if inside.any() else np.inf
    item(
        "an offset is applied and reported",
        off <= APPLIED,
        f"{1e3 * off:.3f} mm off",
        f"{1e3 * APPLIED:g} mm",
        "add irec/offset to the commanded TCP in base_link and report it in robot/state",
    )
    before = tcp.value[tcp.stamp <= o.begin, :3]
    during = tcp.value[(tcp.stamp > o.begin + 0.7 * (o.end - o.begin)) & (tcp.stamp <= o.end), :3]
    if len(before) and len(during):
        moved = during.mean(axis=0) - before.mean(axis=0)
        wrong = float(np.abs(moved - o.small).max())
        item(
            "the TCP moves by it",
            wrong <= APPLIED,
            f"moved by ({', '.join(f'{1e3 * v:.3f}' for v in moved)}) mm",
            f"({', '.join(f'{1e3 * v:.3f}' for v in o.small)}) mm",
            "the offset is a translation in base_link, m; tcp_pose includes it",
        )
    first = s.stamp[(np.linalg.norm(applied, axis=1) > 0.05 * np.linalg.norm(o.small)) & (s.stamp > o.begin)]
    late = float(first[0] - o.begin) if len(first) else np.inf
    item("latency", late <= LATENCY, f"{late:.2f} s", f"{LATENCY:g} s", "take irec/offset in every cycle")
    gone = s.stamp[(np.linalg.norm(applied, axis=1) < 1e-6) & (s.stamp > o.end)]
    fade = float(gone[0] - o.end) if len(gone) else np.inf
    item(
        "it fades when none comes",
        fade <= FADED_AFTER,
        f"{fade:.2f} s",
        f"{FADED_AFTER:g} s",
        "hold for 20 ms, fade to zero within 0.5 s when none has come for 100 ms",
    )
    item("it is not dropped at once", fade >= HOLD, f"{fade:.2f} s", f"at least {HOLD:g} s", "hold and fade, do not step to zero")
    step = float(np.linalg.norm(np.diff(tcp.value[:, :3], axis=0), axis=1).max())
    item("nothing jumps", step <= STEP, f"{1e3 * step:.3f} mm between two tcp_pose", f"{1e3 * STEP:g} mm", "fade in and out")
    big = o.large_seen.streams.get("robot/state")
    most = float(np.linalg.norm(big.value[:, 2:5], axis=1).max()) if big is not None and len(big.value) else np.inf
    item(
        "an offset beyond all limits is cut",
        most <= LARGEST,
        f"{1e3 * most:.2f} mm of {1e3 * np.linalg.norm(o.large):.0f} mm",
        f"{1e3 * LARGEST:g} mm",
        "apply an offset only within the driver's own limits (5 mm)",
    )
    return items
