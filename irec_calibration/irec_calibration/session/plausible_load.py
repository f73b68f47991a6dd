# SPDX-License-Identifier: Apache-2.0
"""Whether force and deflection of a session can be true: sign, unit, frame, size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..robot.ratings import rated_torque
from ..typing import Array, IntArray
from .data import Session

FORCE_RATIO = 5.0  # between nominal and measured force of a load case
COMPLIANCE_RATIO = 60.0  # between the deflection measured and that of drives which twist as drives do
ALONG_FORCE = 0.1  # work of the force over what it would be if each deflection lay along it
RESIDUAL = 0.8  # of the deflection, beside springs and settling fitted to the session: forces of other rows leave 0.86
ABOVE_NOISE = 5.0  # of the deflection over what is stated as noise, for its sign and size to be judged
WITHIN_POSE = 0.05  # rad or m; joints between a reference and its load cases
MIXED_UP = 0.5  # of what joints differ by between poses, beyond which the rows of a pose are of several
TCP_WITHIN_POSE, TURNED_AT_CONTACT = 0.05, 0.5  # m, and rad: a tool that turns about the TCP where poses are near each other
LARGEST_FORCE, LARGEST_ARM = 1e5, 5.0  # N; m, torque over force
FORCE_NOISE = 0.3  # of the force
FEW = 50  # rows that tell which alteration would mend it


def forces(session: Session) -> Iterator[str]:
    """Size and direction of the force against what the load cases say, and what a contact can do."""
    loaded = session.load_case != 0
    force = session.force_in_tool[loaded]
    size = np.linalg.norm(force, axis=1)
    middle = float(np.median(size))
    if middle == 0.0:
        yield "the force is 0 in most loaded rows: nothing loads the robot (column not recorded?)"
        return
    if middle > LARGEST_FORCE:
        yield f"the force is {middle:.4g} N (median of loaded rows), more than {LARGEST_FORCE:g} N (mN for N?)"
    if session.noise.force_n > FORCE_NOISE * middle:
        yield (
            f"noise: force_n is {session.noise.force_n:g} N where the force is {middle:.4g} N (median of loaded rows): more than "
            f"{FORCE_NOISE:g} of it (kN for N?)"
        )
    cases = session.load_case[loaded]
    nominal = {c: np.array(f) for c, f in session.load_cases.items() if np.linalg.norm(f) > 0.0 and (cases == c).any()}
    if nominal:
        ratio = float(np.median([np.median(size[cases == c]) / np.linalg.norm(f) for c, f in nominal.items()]))
        if not 1.0 / FORCE_RATIO < ratio < FORCE_RATIO:
            unit = " (kN for N?)" if 3e-4 < ratio < 3e-3 else " (N for kN?)" if 300.0 < ratio < 3000.0 else ""
            yield f"force_* is {ratio:.3g} times what load_cases says, {1 / FORCE_RATIO:g} .. {FORCE_RATIO:g} is expected{unit}"
        cosine = [
            float(np.median(force[cases == c] @ f / np.maximum(size[cases == c] * np.linalg.norm(f), 1e-12)))
            for c, f in nominal.items()
        ]
        if np.median(cosine) < 0.5:
            what = "the sign is turned" if np.median(cosine) < -0.5 else "axes or frame are others"
            yield (
                f"force_* does not point as load_cases says (cosine {np.median(cosine):.2f}, at least 0.5 is expected): {what}; "
                "it is the force of the environment on the robot, in tool0"
            )
    if session.has_torque:
        arm = float(np.median(np.linalg.norm(session.torque_in_tool[loaded], axis=1) / np.maximum(size, 1e-9)))
        if arm > LARGEST_ARM:
            yield f"torque_* over force_* is {arm:.4g} m (median), more than {LARGEST_ARM:g} m (N mm for N m?)"


def deflection(session: Session) -> Iterator[str]:
    """The deflection against the force: along it, of the size that drives give, and mostly proportional to it."""
    reference = session.reference_row()
    seen = session.marker_seen
    rows = np.flatnonzero((session.load_case != 0) & seen & seen[reference])
    if len(rows) < 3:
        return
    mixed = _mixed_up(session, rows, reference)
    if mixed:
        yield mixed
        return
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    in_base = np.einsum("nij,nj->ni", R, session.p_marker_in_station)
    believed = marker_as_believed(session)
    moved = (in_base - believed)[rows] - (in_base - believed)[reference[rows]]
    kin = session.robot.kinematics(session.q)
    change = session.force_in_tool[rows] - session.force_in_tool[reference[rows]]
    force = np.einsum("nij,nj->ni", kin.R_tool[rows], change)
    size = float(np.median(np.linalg.norm(moved, axis=1)))
    floor = float(np.sqrt(6.0)) * session.noise.tracker_m
    if size < ABOVE_NOISE * floor:
        return
    work = np.einsum("ni,ni->n", force, moved)
    most = np.linalg.norm(force, axis=1) * np.linalg.norm(moved, axis=1)
    along = float(np.median(work / np.maximum(most, 1e-30)))
    if along < ALONG_FORCE:
        what = "sign of force_* or marker_* turned" if along < -ALONG_FORCE else "axes or frame of force_* or of the station?"
        yield (
            f"the robot gives way by {along:.2f} of its deflection along the force (median cosine), at least {ALONG_FORCE:g} is "
            f"expected of springs: {what}"
        )
    J = kin.jacobian(session.p_tcp_in_base)[rows]
    springs = np.einsum("nik,nk->ni", J, np.einsum("nik,ni->nk", J, force) * _typical(session))
    expected = float(np.median(np.linalg.norm(springs, axis=1)))
    ratio = size / max(expected, 1e-30)
    if expected > 0.0 and not 1.0 / COMPLIANCE_RATIO < ratio < COMPLIANCE_RATIO:
        yield (
            f"the deflection is {1e3 * size:.4g} mm (median), {ratio:.3g} times what drives of these ratings would give under "
            f"this force; {1 / COMPLIANCE_RATIO:.2g} .. {COMPLIANCE_RATIO:g} is expected: units of force_* or marker_*?"
        )
    left = _beside_springs(session, rows, reference, moved, force)
    if left > RESIDUAL:
        yield (
            f"{100 * left:.0f} % of the deflection are no answer of springs to this force (at most {100 * RESIDUAL:.0f} % is "
            "expected): load cases, axes of force_* or poses mixed up?"
        )


def _mixed_up(session: Session, rows: IntArray, reference: IntArray) -> str:
    """Whether rows of one pose are of several, or an empty string: as far from their reference as poses are from each other.

    A tool may be aligned as it comes to rest, or come down from a reference well above: then they are apart, yet all alike.
    """
    off = np.abs(session.q[rows] - session.q[reference[rows]]).max(axis=1)
    if np.median(off) <= WITHIN_POSE:
        return ""
    within = float(np.quantile(off, 0.75))  # of rows mixed up some fit by chance
    middle = np.stack([np.median(session.q[rows[session.pose[rows] == p]], axis=0) for p in np.unique(session.pose[rows])])
    apart = np.abs(middle[:, None] - middle[None]).max(axis=2)[np.triu_indices(len(middle), 1)]
    between = float(np.median(apart)) if len(apart) else 0.0
    most = MIXED_UP * between
    moved = float(np.median(np.linalg.norm(session.p_tcp_in_base[rows] - session.p_tcp_in_base[reference[rows]], axis=1)))
    if within <= most or (within <= TURNED_AT_CONTACT and moved <= TCP_WITHIN_POSE):
        return ""
    return (
        f"joints differ by {within:.3g} rad or m (upper quartile) between a reference and its load cases, {between:.3g} (median) "
        f"between poses; at most {MIXED_UP:g} of that is expected: do the rows of a pose belong together?"
    )


def _typical(session: Session) -> Array:
    """Order of magnitude of each joint's compliance, rad/(N m): drives twist by about a milliradian at their rated torque."""
    return 1e-3 / rated_torque(session.robot)


def _beside_springs(session: Session, rows: IntArray, reference: IntArray, moved: Array, force: Array) -> float:
    """Share of the deflection (median norm) beside springs about every axis and across it, and beside axes that settle.

    Settling after each motion may move the marker by more than the force does.
    """
    kin = session.robot.kinematics(session.q)
    believed, tcp = marker_as_believed(session), session.p_tcp_in_base
    at_marker = np.concatenate([kin.jacobian(believed), kin.virtual_jacobian(believed)], axis=2)
    at_tcp = np.concatenate([kin.jacobian(tcp), kin.virtual_jacobian(tcp)], axis=2)
    springs = at_marker[rows] * np.einsum("nik,ni->nk", at_tcp[rows], force)[:, None, :]
    order = np.argsort(session.stamp, kind="stable")
    step = np.zeros_like(session.q)
    step[order[1:]] = np.diff(session.q[order], axis=0)
    settled = kin.jacobian(believed) * step[:, None, :]
    A = np.concatenate([springs, settled[rows] - settled[reference[rows]]], axis=2)
    flat, b = A.reshape(-1, A.shape[2]), moved.ravel()
    if len(b) < 2 * flat.shape[1]:
        return 0.0
    weight = np.ones(len(rows))
    r = moved
    for _ in range(10):  # least absolute deviations: bad rows are not what is asked here
        w = np.repeat(np.sqrt(weight), 3)
        x = np.linalg.lstsq(flat * w[:, None], b * w, rcond=1e-8)[0]
        r = moved - A @ x
        norm = np.linalg.norm(r, axis=1)
        weight = 1.0 / np.maximum(norm, 0.1 * max(float(np.median(norm)), 1e-30))
    return float(np.median(np.linalg.norm(r, axis=1)) / max(float(np.median(np.linalg.norm(moved, axis=1))), 1e-30))


def marker_as_believed(session: Session) -> Array:
    """Where the controller believes the marker, (n, 3), m."""
    kin = session.robot.kinematics(session.q)
    xyz = np.array([m.xyz for m in session.markers])[session.marker]
    on_tool = session.on_tool
    return np.where(on_tool[:, None], session.p_tcp_in_base + np.einsum("nij,nj->ni", kin.R_tool, xyz), xyz)
