# SPDX-License-Identifier: Apache-2.0
"""Whether force and deflection of a session can be true: sign, unit, frame, size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..robot.ratings import rated_torque
from ..typing import Array, IntArray
from .data import Session
from .plausible_side import (
    AXES,
    FITS,
    Fit,
    Pairs,
    across,
    against_stated,
    alterations,
    best_of,
    constant,
    dead_channels,
    least,
    pairs_of,
)

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
POINTS = 0.9  # cosine between force and load_cases that another frame has to give
FEW = 50  # rows that tell which alteration would mend it


def forces(session: Session) -> Iterator[str]:
    """Size and direction of the force against what the load cases say, and what a contact can do."""
    loaded = session.load_case != 0
    if not loaded.any():
        yield "there is no loaded row (load_case 1 and on), only references: nothing shows how the robot gives way"
        return
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
        yield from _pointing(session, nominal)
    yield from _exchanged_reference(session, nominal)
    if session.has_torque:
        arm = float(np.median(np.linalg.norm(session.torque_in_tool[loaded], axis=1) / np.maximum(size, 1e-9)))
        if arm > LARGEST_ARM:
            yield f"torque_* over force_* is {arm:.4g} m (median), more than {LARGEST_ARM:g} m (N mm for N m?)"


def _pointing(session: Session, nominal: dict[int, Array]) -> Iterator[str]:
    """Whether the force points as load_cases says."""

    def cosine(force: Array) -> float:
        found = []
        for c, f in nominal.items():
            of_case = force[session.load_case == c]
            found.append(float(np.median(of_case @ f / np.maximum(np.linalg.norm(of_case, axis=1) * np.linalg.norm(f), 1e-12))))
        return float(np.median(found))

    usual = cosine(session.force_in_tool)
    if usual >= 0.5:
        return
    R_tool = session.robot.kinematics(session.q).R_tool
    R_station = np.stack([s.R_in_base for s in session.stations])[session.station]
    in_base = np.einsum("nji,nj->ni", R_tool, session.force_in_tool)
    others = {
        "force_* in base_link": cosine(in_base),
        "force_* in base_link and of the other sign": cosine(-in_base),
        "force_* in the frame of the station": cosine(
            np.einsum("nji,nj->ni", R_tool, np.einsum("nij,nj->ni", R_station, session.force_in_tool))
        ),
    }
    best = max(others, key=lambda k: others[k])
    dead = [k for k in range(3) if constant(session, k) is not None and any(abs(f[k]) > 0.0 for f in nominal.values())]
    if others[best] > POINTS and usual > -POINTS:
        what = f"it would fit ({others[best]:.2f}) with {best}"
    elif dead:
        what = f"force_{AXES[dead[0]]} is exactly {constant(session, dead[0]):g} N in every loaded row: the channel is dead"
    else:
        what = "the sign is turned" if usual < -0.5 else "axes or frame are others"
    yield (
        f"force_* does not point as load_cases says (cosine {usual:.2f}, at least 0.5 is expected): {what}; it is the force of "
        "the environment on the robot, in tool0"
    )


def _exchanged_reference(session: Session, nominal: dict[int, Array]) -> Iterator[str]:
    """Whether a load case reads nothing and the reference reads as that load case should."""
    if not (session.load_case == 0).any():
        return
    reference = np.median(session.force_in_tool[session.load_case == 0], axis=0)
    for case, f in nominal.items():
        read = np.median(session.force_in_tool[session.load_case == case], axis=0)
        size = float(np.linalg.norm(f))
        if np.linalg.norm(read) < 0.1 * size and np.linalg.norm(reference - f) < 0.3 * size:
            yield (
                f"load_case {case} reads {np.linalg.norm(read):.3g} N where load_cases says {size:.4g} N, and the reference "
                f"(load_case 0) reads {np.linalg.norm(reference):.4g} N: are {case} and 0 exchanged?"
            )


def deflection(session: Session) -> tuple[list[str], list[str]]:
    """The deflection against the force: along it, of the size that drives give, mostly proportional to it; doubts and notes."""
    reference = session.reference_row()
    seen = session.marker_seen & session.on_tool  # a marker on the base does not move with the arm
    rows = np.flatnonzero((session.load_case != 0) & seen & seen[reference])
    if len(rows) < 3:
        return _without_work(session)
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    off = np.einsum("nij,nj->ni", R, session.p_marker_in_station) - marker_as_believed(session)
    moved = off[rows] - off[reference[rows]]
    kin = session.robot.kinematics(session.q)
    change = session.force_in_tool[rows] - session.force_in_tool[reference[rows]]
    force = np.einsum("nij,nj->ni", kin.R_tool[rows], change)
    size = float(np.median(np.linalg.norm(moved, axis=1)))
    floor = float(np.sqrt(6.0)) * session.noise.tracker_m
    if size < ABOVE_NOISE * floor:
        return _without_work(session)
    pairs = pairs_of(session, off, kin.R_tool)
    found, notes = _by_work(session, pairs, lambda f: _along(f[rows] - f[reference[rows]], moved))
    J = kin.jacobian(session.p_tcp_in_base)[rows]
    springs = np.einsum("nik,nk->ni", J, np.einsum("nik,ni->nk", J, force) * _typical(session))
    expected = float(np.median(np.linalg.norm(springs, axis=1)))
    ratio = size / max(expected, 1e-30)
    if expected > 0.0 and not 1.0 / COMPLIANCE_RATIO < ratio < COMPLIANCE_RATIO:
        found.append(
            f"the deflection is {1e3 * size:.4g} mm (median), {ratio:.3g} times what drives of these ratings would give under "
            f"this force; {1 / COMPLIANCE_RATIO:.2g} .. {COMPLIANCE_RATIO:g} is expected: units of force_* or marker_*?"
        )
    left = _beside_springs(session, rows, reference, moved, force)
    if left > RESIDUAL:
        found.append(
            f"{100 * left:.0f} % of the deflection are no answer of springs to this force (at most {100 * RESIDUAL:.0f} % is "
            f"expected): load cases, axes of force_* or poses mixed up{_at_rest(session)}?"
        )
    return found, notes


def _by_work(session: Session, pairs: Pairs, fit: Fit) -> tuple[list[str], list[str]]:
    """Sign and axes of the force by the work it does: doubts and notes."""
    along = fit(pairs.force_in_base)
    stated, notes = against_stated(session, pairs)
    if along < ALONG_FORCE:
        others = {name: min(fit(f), least(pairs, f, none=1.0)) for name, f in alterations(session, pairs.R_tool)}
        return [
            f"the robot gives way by {along:.2f} of its deflection along the force (median cosine), at least {ALONG_FORCE:g} is "
            f"expected of springs: {_why_not_along(session, along, others)}"
        ], notes
    found, odd = across(session, pairs, fit)
    return dead_channels(session) or found or stated, [*notes, *odd]


def _without_work(session: Session) -> tuple[list[str], list[str]]:
    """The same where no deflection says anything: doubts and notes."""
    stated, notes = against_stated(session, None)
    return [*dead_channels(session), *stated], notes


def _at_rest(session: Session) -> str:
    """What the force reads at the reference, where that is much, in words."""
    size = np.linalg.norm(session.force_in_tool, axis=1)
    rest, usual = float(np.median(size[session.load_case == 0])), float(np.median(size[session.load_case != 0]))
    return f", or the reference not relaxed (it reads {rest:.4g} N)" if rest > 0.3 * usual else ""


def _along(force: Array, moved: Array) -> float:
    """Median cosine between force and deflection."""
    most = np.linalg.norm(force, axis=1) * np.linalg.norm(moved, axis=1)
    return float(np.median(np.einsum("ni,ni->n", force, moved) / np.maximum(most, 1e-30)))


def _why_not_along(session: Session, along: float, others: dict[str, float]) -> str:
    """What may be wrong where the robot does not give way along the force, in words."""
    if _is_commanded(session):
        return "tcp_* is the same to the last digit in all rows of a pose: commanded, not measured; the measured one is needed"
    best, fits = best_of(others)
    if fits > FITS:
        return f"it would fit ({fits:.2f}) with {best}"
    return "sign of force_* or marker_* turned" if along < -ALONG_FORCE else "axes or frame of force_* or of the station?"


def _is_commanded(session: Session) -> bool:
    """Whether the TCP is the same to the last digit in nearly all rows of a pose and repeat."""
    group = np.unique(np.stack([session.pose, session.repeat], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    first = np.unique(group, return_index=True)[1][group]
    others = np.arange(len(session)) != first
    same = (session.p_tcp_in_base == session.p_tcp_in_base[first]).all(axis=1)
    return bool(others.any() and same[others].mean() > 0.9)


def mixed_up(session: Session) -> str:
    """Whether rows of one pose are of several, or an empty string: as far from their reference as poses are from each other.

    A tool may be aligned as it comes to rest, or come down from a reference well above: then they are apart, yet all alike.
    """
    reference = session.reference_row()
    seen = session.marker_seen
    rows = np.flatnonzero((session.load_case != 0) & seen & seen[reference])
    if len(rows) < 3:
        return ""
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
