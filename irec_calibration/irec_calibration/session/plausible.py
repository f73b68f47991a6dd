# SPDX-License-Identifier: Apache-2.0
"""Whether a session can be what it says, before anything is identified from it: units, signs, columns and frames.

Each doubt names the value, the limit and, where one alteration would mend it, which. A missing effect or a bad row is no doubt:
limits are far from what real robots do. What is odd and may be so is a note.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..errors import ImplausibleSession
from . import plausible_place as place
from .data import Session
from .plausible_load import deflection, forces, mixed_up
from .plausible_rows import remarks
from .plausible_tcp import tcp
from .plausible_weight import gravity_elsewhere, weights

NOISE_M = 2e-3  # m; a tracker that is worse is none
GRAVITY = (9.0, 10.5)
TEMPERATURE = (-40.0, 120.0)
FAR_M = 80.0  # m; range of a tracker


def check_plausible(session: Session) -> Session:
    """A session that can be what it says, with notes on what is odd about it.

    Raises:
        ImplausibleSession: it can't be; all reasons in its message.
    """
    found, notes = judged(session)
    if found:
        where = session.path or session.name
        raise ImplausibleSession(f"{where}: " + "; ".join(found), found)
    return replace(session, notes=(*session.notes, *notes)) if notes else session


def judged(session: Session) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What speaks against a session, most basic first, and what is odd about it (notes)."""
    found, notes = list(_stated(session)), list(remarks(session))
    heavy, odd = weights(session)
    found += heavy
    notes += odd
    if session.kind == "loaded":
        at_tcp, odd = tcp(session)
        notes += odd
        mixed = "" if at_tcp else mixed_up(session)
        at_marker, odd = ([], []) if at_tcp or mixed else place.markers(session)
        notes += odd
        found += at_tcp or at_marker or ([mixed] if mixed else [])
        found += forces(session)
        if not found:
            under_load, odd = deflection(session)
            found += under_load
            notes += odd
    else:
        if session.has_tcp:
            at_tcp, odd = tcp(session)
            found += at_tcp
            notes += odd
        found += place.registration(session)
        if not found:
            notes += gravity_elsewhere(session)
    return tuple(found), tuple(notes)


def _stated(session: Session) -> Iterator[str]:
    """Header and columns by themselves."""
    n = session.noise
    for name, value in (("tracker_m", n.tracker_m), ("settling_m", n.settling_m), ("robot_m", n.robot_m)):
        if value > NOISE_M * (5.0 if name == "robot_m" else 1.0):
            yield f"noise: {name} is {value:g} m, more than {NOISE_M:g} m is no such instrument (mm or um for m?)"
    if n.tracker_m_per_m > 1e-3:
        yield f"noise: tracker_m_per_m is {n.tracker_m_per_m:g}, more than 0.001 is no tracker (um/m for m/m?)"
    g = float(np.linalg.norm(session.gravity_in_base))
    if session.gravity_in_base != (0.0, 0.0, 0.0) and not GRAVITY[0] < g < GRAVITY[1]:
        yield f"gravity is {g:g} m/s^2, {GRAVITY[0]} .. {GRAVITY[1]} is expected"
    for name, values in session.temperature.items():
        middle = float(np.nanmedian(values)) if np.isfinite(values).any() else 20.0
        if not TEMPERATURE[0] < middle < TEMPERATURE[1]:
            yield f"temp_{name} is {middle:g} degC (median), {TEMPERATURE[0]:g} .. {TEMPERATURE[1]:g} is expected (K or F?)"
    for name, values in session.ext.items():
        size = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        if size > FAR_M:
            yield f"ext_{name} reaches {size:g}, more than {FAR_M:g} m or rad (mm or degrees?)"
    seen = session.p_marker_in_station[session.marker_seen]
    if len(seen) and session.meta.get("without_tracker") is True:
        yield f"without_tracker says that no tracker measured, marker_* has values in {len(seen)} rows: one of the two is wrong"
    if len(seen):
        far = float(np.median(np.linalg.norm(seen, axis=1)))
        if far > FAR_M:
            yield f"markers are {far:.4g} m from their station (median), a tracker reaches {FAR_M:g} m (mm for m?)"
        if len(seen) > 3 and float(np.ptp(seen, axis=0).max()) == 0.0:
            yield "the marker is at the very same place in every row: the tracker's reading did not change"
