# SPDX-License-Identifier: Apache-2.0
"""A loaded session read without its tracker: the tooling is the measuring instrument.

As long as the disc stands on the tooling, joint angles and elastic deflection together leave it where it is. Along the surface
normal that holds even where the disc slips; across, as far as friction holds it. How far the disc gives way is an effect
(`disc_compliance`). The reference row of Procedure 1 is away from the tooling and says nothing here: a loaded row takes its
place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SessionError
from ..typing import Array, BoolArray, IntArray
from .data import Contact, Marker, Session, Station

ENCODER_RAD = 2e-6  # one standard deviation of the mean angle of a row: 20 to 24 bits per turn, behind a gear
SLIP_M = 1e-4  # one standard deviation of what a disc slips and creeps between two load cases of a pose
PRESSED = 0.05  # share of the session's largest force below which a disc is not pressed on
HOLDS = 1.0  # force across over force along the tool above which no disc holds
CARRIED = 1e-5  # m or rad by which an external axis may move within a pose
MOVED = 2e-6  # m by which the controller's TCP moves at least (median) under changing loads where joint angles were measured
FEWEST_POSES = 3
DISC_LIMITS = (1e4, 1e9)  # N/m: a sponge, a block of steel


def without_tracker(
    session: Session, slip_m: float = SLIP_M, encoder_rad: float = ENCODER_RAD, disc: tuple[float, float] | None = None
) -> Session:
    """The session whose measured point is the contact of the disc with the tooling; marker columns are not read.

    Args:
        session: loaded, with the joint angles measured in every row while the disc pressed.
        slip_m: by how much the disc slips or creeps across tool0 z within a pose, one standard deviation, m.
        encoder_rad: noise of the joint angles of a row, one standard deviation, rad.
        disc: stiffness of the disc along tool0 z and across it as somebody measured it, N/m; None: to be identified along.

    Returns:
        Loaded rows only, in the order of the file. The lowest load case of each pose and repeat is the reference now
        (load_case 0), whose force counts as any other's.

    Raises:
        SessionError: the session can't tell anything this way; says why.
    """
    where = str(session.path or session.name)
    if session.kind != "loaded":
        raise SessionError(
            f"{where}: kind is {session.kind}; without a tracker loaded is needed: a disc that presses on the tooling"
        )
    if session.contact is not None:
        raise SessionError(f"{where}: is read without its tracker already")
    if not (0.0 < slip_m <= 1.0 and 0.0 < encoder_rad <= 0.01):
        raise SessionError(
            f"slip is {slip_m:g} m and encoder noise {encoder_rad:g} rad; above 0 and up to 1 m, 0.01 rad are allowed"
        )
    if disc is not None and not all(DISC_LIMITS[0] <= k <= DISC_LIMITS[1] for k in disc):
        low, high = DISC_LIMITS
        raise SessionError(f"stiffness of the disc is {disc[0]:g} and {disc[1]:g} N/m, {low:g} to {high:g} N/m are allowed")
    notes = list(session.notes)
    loaded = _one_marker(session) & (session.load_case != 0)
    usable = loaded & _pressed(session)
    if not usable.any():
        raise SessionError(
            f"{where}: no loaded row in contact: force_z is nowhere below {-PRESSED:g} times the largest force and larger than "
            "the force across it; without a tracker the disc has to press on the tooling"
        )
    if lost := int((loaded & ~usable).sum()):
        notes.append(f"{lost} loaded rows left out: the disc was not pressed on, or could not hold the force across")
    _check_carried(session, usable, where)
    kept = usable & _in_company(session, usable)
    poses = len(np.unique(session.pose[kept]))
    if lost := len(np.unique(session.pose[loaded])) - poses:
        notes.append(f"{lost} poses left out: fewer than two load cases in contact")
    if poses < FEWEST_POSES:
        raise SessionError(f"{where}: {poses} poses have two load cases in contact; without a tracker {FEWEST_POSES} are needed")
    found = session.select(np.flatnonzero(kept))
    reference = _lowest_case(found)
    case = np.where(np.arange(len(found)) == reference, 0, found.load_case)
    _check_measured(found, reference, where)
    normal = float(np.hypot(_by_encoders(found, encoder_rad), found.noise.settling_m))
    across = max(slip_m, normal)
    notes.append(f"read without its tracker: displacements across tool0 z count {normal / across:.2g} times as much as along it")
    of_tcp = np.zeros(len(found), dtype=np.int64)
    where_tcp_is = found.p_tcp_in_base[reference]
    if disc is not None:
        where_tcp_is = where_tcp_is - _given_way(found, disc)
    return replace(
        found, load_case=case, p_marker_in_station=where_tcp_is, station=of_tcp,
        stations=(Station("tooling", known=True),), marker=of_tcp.copy(), markers=(Marker("disc"),),
        noise=replace(found.noise, tracker_m=normal, tracker_m_per_m=0.0, settling_m=0.0),
        notes=tuple(notes), contact=Contact(normal, across, disc is not None),
    )  # fmt: skip


def _one_marker(session: Session) -> BoolArray:
    """One row of each pose, repeat and load case, where several markers give several."""
    _, first = np.unique(np.stack([session.pose, session.repeat, session.load_case], axis=1), axis=0, return_index=True)
    out = np.zeros(len(session), dtype=bool)
    out[first] = True
    return out


def _pressed(session: Session) -> BoolArray:
    """Rows in which the disc is pressed on and friction can hold it."""
    f = session.force_in_tool
    enough = PRESSED * float(np.linalg.norm(f, axis=1).max(initial=0.0))
    held: BoolArray = (-f[:, 2] > enough) & (np.hypot(f[:, 0], f[:, 1]) < HOLDS * -f[:, 2])
    return held


def _groups(session: Session) -> IntArray:
    """Number of the pose and repeat of each row, from 0."""
    return np.unique(np.stack([session.pose, session.repeat], axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _in_company(session: Session, usable: BoolArray) -> BoolArray:
    """Rows whose pose and repeat have two usable rows or more."""
    group = _groups(session)
    alone: BoolArray = np.bincount(group, weights=usable)[group] < 2
    return ~alone


def _lowest_case(session: Session) -> IntArray:
    """Index of the row of the lowest load case of each row's pose and repeat."""
    group = _groups(session)
    order = np.lexsort((session.load_case, group))
    first = order[np.unique(group[order], return_index=True)[1]]
    return np.asarray(first[group])


def _check_carried(session: Session, usable: BoolArray, where: str) -> None:
    """The base stands where it stood. Raises SessionError."""
    group = _groups(session)
    for name, value in session.ext.items():
        for g in np.unique(group[usable]):
            at = value[usable & (group == g)]
            at = at[np.isfinite(at)]
            if len(at) and float(np.ptp(at)) > CARRIED:
                pose = int(session.pose[np.flatnonzero(group == g)[0]])
                raise SessionError(
                    f"{where}: ext_{name} moves by {np.ptp(at):.3g} within pose {pose}, at most {CARRIED:g} is expected: without "
                    "a tracker the base has to stand while the disc presses"
                )


def _check_measured(found: Session, reference: IntArray, where: str) -> None:
    """Joint angles changed as the forces did. Raises SessionError."""
    way = np.linalg.norm(found.p_tcp_in_base - found.p_tcp_in_base[reference], axis=1)[np.arange(len(found)) != reference]
    middle = 1e6 * float(np.median(way))
    if middle < 1e6 * MOVED:
        raise SessionError(
            f"{where}: the controller's TCP moves by {middle:.2g} um (median) from one load case to the next, at least "
            f"{1e6 * MOVED:g} um is expected where force control presses on: joint angles seem to be commanded ones, not measured"
        )


def _given_way(found: Session, disc: tuple[float, float]) -> Array:
    """By how much a disc of this stiffness, N/m, lets the TCP come nearer to its place on the tooling, (n, 3), m in base_link."""
    compliance = 1.0 / np.array([disc[1], disc[1], disc[0]])
    return np.asarray(np.einsum("nij,nj->ni", found.robot.kinematics(found.q).R_tool, compliance * found.force_in_tool))


def _by_encoders(found: Session, encoder_rad: float) -> float:
    """Noise of the TCP along tool0 z that the encoders make, one standard deviation, m."""
    kin = found.robot.kinematics(found.q)
    along = np.einsum("nik,ni->nk", kin.jacobian(found.p_tcp_in_base), kin.R_tool[:, :, 2])
    return encoder_rad * float(np.sqrt((along**2).sum(axis=1).mean()))
