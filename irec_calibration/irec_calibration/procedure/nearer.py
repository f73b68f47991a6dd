# SPDX-License-Identifier: Apache-2.0
"""Tooling that stands nearer than the cell file says, or a heavy arm that sags onto it: the reference is set further out, once.

Where the tool is in contact before or at the reference, the pose is left and measured again from a reference that is as far from
that contact as the cell file asks for. A pose where this happens twice is given up, and so is one where it happened on the fast
part of the way in.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .machine import Procedure


def met_the_tooling(p: Procedure, reason: str) -> None:
    """Leave the contact, and measure the pose again with its reference further out or give it up.

    Args:
        reason: what was read, for the record.
    """
    further = _further_out(p)
    if further is None or p.target is None:
        p.fail(reason)
        return
    pose, z = p.target.pose, p.target.R_tool_in_base[:, 2]
    p.set_out.add(pose)
    p.work = [
        (replace(t, p_reference=t.p_reference - further * z) if t.pose == pose else t, repeat) for t, repeat in p.work
    ]
    p.event("nearer", f"{reason}; measured again from a reference that is {1e3 * further:.1f} mm further out")
    p.break_off()


def _further_out(p: Procedure) -> float | None:
    """By how much the reference is to be set out, m; None: it must not be."""
    target, tcp, distance = p.target, p.streams.newest_tcp, p.settings.reference_distance
    if target is None or tcp is None or target.pose in p.set_out or p.stopped_because or p.state == "advance":
        return None
    z = target.R_tool_in_base[:, 2]
    further = float((target.p_reference - tcp[0]) @ z) + distance
    room = float((target.p_reference - target.p_approach) @ z) - distance
    return further if 0.0 < further <= room else None
