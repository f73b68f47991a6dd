# SPDX-License-Identifier: Apache-2.0
"""The way of the marker against that of the TCP within one pose: the tracker has to follow the marker of this tool.

The TCP that joint angles say goes on by the deflection of the arm while the tool is held by the surface. So from the reference
into the contact the marker goes as far as the TCP did until the tool touched, at least, and as far as the TCP at most.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..typing import Array
from .standstill import Window

if TYPE_CHECKING:
    from .machine import Procedure

WAY_SHARE = 0.01  # of the way: a station that is registered half a degree wrong
SAME_TIME = 0.1  # s by which the newest point may be behind the other readings


def contact_way_problem(
    window: Window, reference: Window, p_touch: Array | None, R_station: Array, R_tool: Array, limit: float
) -> str:
    """Why the marker can't be that of the tool that presses; empty if it may.

    Args:
        window, reference: loaded, and before contact; of one station.
        p_touch: TCP by the controller when the tool touched, (3,), m in base_link; None where that is not known.
        R_station, R_tool: rotations of the station into the cell frame and of tool0 into base_link, (3, 3).
        limit: m.
    """
    z = R_tool[:, 2]
    p_begin = reference.p_tcp_in_base.mean(axis=0)
    marker = float(z @ R_station @ (window.p_marker_in_station.mean(axis=0) - reference.p_marker_in_station.mean(axis=0)))
    tcp = float(z @ (window.p_tcp_in_base.mean(axis=0) - p_begin))
    least = float(z @ (p_touch - p_begin)) if p_touch is not None else 0.0
    least = min(least, tcp)
    if least - limit <= marker <= tcp + limit:
        return ""
    return (
        f"the marker does not move as the tool does: from the reference into the contact it went {1e3 * marker:.2f} mm along the"
        f" tool, {1e3 * least:.2f} to {1e3 * tcp:.2f} mm are possible by tcp_pose (limit {1e3 * limit:g} mm beside,"
        " procedure.checks.marker_m): does the tracker repeat a held point, or see another reflector?"
    )


def free_way_problem(p: Procedure) -> str:
    """The marker after the retract against the reference window of the pose; empty where it is not seen, or where it fits."""
    reference, marker, tcp = p.reference, p.streams.newest_marker, p.streams.newest_tcp
    if p.settings.without_tracker or reference is None or marker is None or tcp is None:
        return ""
    if marker[2] != reference.station or marker[0] < max(p.streams.newest().values()) - SAME_TIME:
        return ""
    R_station = p.station_rotation.get(reference.station)
    if R_station is None:
        return ""
    way = tcp[0] - reference.p_tcp_in_base.mean(axis=0)
    seen = R_station @ (marker[1] - reference.p_marker_in_station.mean(axis=0))
    off = float(np.linalg.norm(seen - way))
    limit = p.settings.checks.marker_m + WAY_SHARE * float(np.linalg.norm(way))
    if off <= limit:
        return ""
    return (
        f"the marker does not move as the TCP does: from the reference to the end of the retract tcp_pose went"
        f" {1e3 * np.linalg.norm(way):.1f} mm, the tracker ({reference.station}) {1e3 * np.linalg.norm(seen):.1f} mm,"
        f" {1e3 * off:.1f} mm apart, limit {1e3 * limit:.1f} mm (procedure.checks.marker_m): does it repeat a held point, see"
        " another reflector, or was the marker knocked?"
    )
