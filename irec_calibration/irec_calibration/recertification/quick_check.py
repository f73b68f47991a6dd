# SPDX-License-Identifier: Apache-2.0
"""The quick check: a few poses measured again, and a sequential test whether the robot is still as its calibration says.

The calibration is taken with its own uncertainty. With B the columns of the model in force and of all changes looked for, and
gamma what the rows of the calibration itself say about them (ridge regression on what the model leaves there),

    d = y_now - predicted_now - B_now gamma ~ N(0, s^2 Sigma_now + B_now P B_now' + N V N'),

where P is the covariance of gamma, N holds the unknown rotation of the tracker station and s is the noise that the calibration
showed. A cause that the model lacked already then is thus no change. Where poses were measured again, what differs between
visits of a pose is told from what comes again with it (`same_readings`): only the former becomes less with more visits. When the
robot leaves a pose:

* the robot has *changed* when the mean of the likelihood ratios of all changes, in each way that they may go (play may be taken
  up over little torque or over much) and at several sizes, reaches 1/alpha. That mean is
  a martingale where nothing has changed, so a false alarm has probability alpha at the most however often one looks (Ville);
* it *passes* when the likelihood ratio of each change, at the size at which it must be found, is below beta / 2, or when after
  the last pose the estimate of each is so far below that size that a robot with it comes as low with probability beta / 2: a
  robot with one of these changes passes with probability beta at the most.

The size at which a change must be found is that of `changes`, or a larger one where the poses can't show so little (see
`quick_plan`); what it is, is told.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp, ndtri

from ..effects.scene import Scene
from ..identification.identify import observe_with_force_noise
from ..identification.observe import Observation
from ..model import Term, regressors, total_displacement
from ..session import Session
from ..typing import Array, IntArray
from .advice import with_advice
from .changes import Change, changes, ways
from .same_readings import Level, covariance_of_rows, level_of, places, same_readings
from .station import with_stations_found

FALSE_ALARM = 0.02
MISSED = 0.05
FEWEST_TO_ALARM, FEWEST_POSES = 3, 5  # places
MOST_VISITS = 48
SIZES = (1.0, 2.0, 4.0, 8.0)  # multiples of the size at which a change must be found
STATION_ROTATION = 1e-3  # rad, one standard deviation of what is left after the station was found anew
VISIBLE = 0.3  # whitened length of a change over the whole calibration below which no quick check could show it
QUIETEST = 0.3  # of the stated noise: a fit to few rows must not make the test believe in less
NOTABLE = 0.02  # share of the tolerance: what moves the tool by less is micrometres, and nothing that staff are told of
WIDE = 10.0  # prior standard deviation of each column: multiples of its change, or of the parameter's scale


@dataclass(frozen=True)
class Reference:
    """What the calibration in force was made from, and what it leaves open.

    Attributes:
        terms: of the model in force. observation: of its session.
        level: noise of the rows relative to what session.yaml states, as the calibration itself shows it.
        gamma, covariance: what the calibration says of the columns of `_columns`, (p,) and (p, p).
        columns: these at the rows of the calibration, (3 m, p).
        changes: those that the calibration's poses can show; each with its displacement as observed there, (m, 3), m.
        tolerance: of the process, m.
    """

    terms: tuple[Term, ...]
    observation: Observation
    level: Level
    gamma: Array
    covariance: Array
    columns: Array
    changes: tuple[Change, ...]
    tolerance: float


@dataclass(frozen=True)
class QuickResult:
    """State of the check after some poses.

    Attributes:
        decision: `pass`, `changed` or `undecided`.
        e_value: evidence against "nothing has changed"; 1 / alpha or more is an alarm.
        ratio: change -> likelihood ratio at the size at which it must be found.
        size: change -> most likely size, in multiples of that in `changes`.
        like: changes that the data look like, most likely first (only where changed); none that moves the tool by less than
            NOTABLE of the tolerance.
        named: change -> all about it. words: change -> in plain words at its most likely size.
        poses: how many different ones took part. visits: how many times one was measured. text: for the person at the cell.
    """

    decision: str
    e_value: float
    ratio: dict[str, float]
    size: dict[str, float]
    like: tuple[str, ...]
    poses: int
    text: str
    named: dict[str, Change]
    words: dict[str, str]
    visits: int = 0


def reference_of(terms: Sequence[Term], session: Session, tolerance: float, sag_share: float = 1.0) -> Reference:
    """Prepare the calibration in force for quick checks.

    Args:
        session: the session that the model in force was identified from. tolerance: of the process, m.
        sag_share: see `Model.sag_share`.
    """
    terms = tuple(t for t in terms if not t.effect.registers)
    observation = observe_with_force_noise(with_stations_found(session), terms, sag_share=sag_share)
    residual = observation.whiten(observation.y - observation.of(total_displacement(terms, observation.scene))).ravel()
    columns = _columns(terms, observation)
    white = observation.whiten(columns).reshape(len(residual), -1)
    columns = columns.reshape(len(residual), -1)
    same = same_readings(observation)
    total, gamma, _ = _ridge(white, residual)
    left = observation.y - observation.of(total_displacement(terms, observation.scene))
    level = level_of(observation, same, left - (columns @ gamma).reshape(-1, 3), total) or Level(total)
    gamma, covariance = _posterior(white, residual, level.of_means(len(same) / len(np.unique(same))))
    seen = []
    for change in changes(terms, observation.scene):
        displacement = observation.of(change.displacement)
        if np.linalg.norm(observation.whiten(displacement)) > VISIBLE:
            seen.append(replace(change, displacement=displacement))
    return Reference(terms, observation, level, gamma, covariance, columns, tuple(seen), tolerance)


def _ridge(B: Array, residual: Array) -> tuple[float, Array, Array]:
    """Noise relative to what is stated, coefficients (p,), their covariance (p, p); of whitened columns (n, p) and residual."""
    G = B.T @ B
    scale = 1.0
    for _ in range(3):  # the noise decides how much the prior shrinks, and the other way round
        gamma, inverse = _posterior(B, residual, scale)
        freedom = max(len(residual) - float(np.sum(inverse * G)) / scale**2, 1.0)
        scale = max(float(np.linalg.norm(residual - B @ gamma)) / np.sqrt(freedom), QUIETEST)
    return scale, gamma, inverse


def _posterior(B: Array, residual: Array, scale: float) -> tuple[Array, Array]:
    """Coefficients (p,) and their covariance (p, p) at a noise relative to what is stated."""
    inverse = np.linalg.inv(B.T @ B / scale**2 + np.eye(B.shape[1]) / WIDE**2)
    return inverse @ (B.T @ residual) / scale**2, np.asarray(inverse, dtype=np.float64)


def _columns(terms: Sequence[Term], observation: Observation) -> Array:
    """Displacement as observed per unit of each free parameter (scaled) and of each change, (m, 3, p), m."""
    scene = observation.scene
    blocks = []
    for term, block in zip(terms, regressors(terms, scene), strict=True):
        own = term.effect.parameters(scene)
        free = term.free(own)
        blocks.append(block[:, :, free] * np.array([own[j].scale for j in free]))
    blocks += [c.displacement[:, :, None] for c in changes(terms, scene)]
    return observation.of(np.concatenate(blocks, axis=2))


def loaded_columns(reference: Reference, lateral: float) -> tuple[Array, Array]:
    """`Reference.columns`, (3 m, p), and the displacement by each of its changes in each way that it may go, (ways, 3 m,
    changes), at the rows of the calibration with the forces across the tool multiplied by `lateral`."""
    o = reference.observation
    force = o.scene.force_in_tool * np.array([lateral, lateral, 1.0])
    loaded = replace(o, scene=o.scene.with_wrench(force, o.scene.torque_in_tool))
    each_way = _each_way(reference, loaded.scene)
    displacement = [np.stack([loaded.of(c.displacement).ravel() for c in way], axis=1) for way in each_way]
    return _columns(reference.terms, loaded).reshape(3 * len(o.rows), -1), np.stack(displacement)


def _each_way(reference: Reference, scene: Scene) -> list[list[Change]]:
    """The changes of a reference at other rows, in its order, in each way that they may go."""
    out = []
    for way in range(ways(reference.terms, scene)):
        found = {c.name: c for c in changes(reference.terms, scene, way)}
        nothing = np.zeros((len(scene.q), 3))
        out.append([found.get(c.name, replace(c, displacement=nothing)) for c in reference.changes])
    return out


def check(reference: Reference, session: Session, sizes: Mapping[str, float] | None = None, last: bool = False) -> QuickResult:
    """Test the poses measured so far.

    Args:
        session: complete poses of this check, of the same robot.
        sizes: change -> multiple of its size in `changes` at which it must be found; 1 where it is not named.
        last: nothing more will be measured.

    Raises:
        SolveError: no row can be used.
    """
    terms = reference.terms
    now = _observed(reference, session)
    columns = _columns(terms, now)
    B = columns.reshape(3 * len(now.rows), -1)
    d = (now.y - now.of(total_displacement(terms, now.scene))).ravel() - B @ reference.gamma
    same = same_readings(now)
    level = reference.level
    if d.size > 2 * B.shape[1]:  # a noisier tracker is no change of the robot
        white, columns = now.whiten(d.reshape(-1, 3)).ravel(), now.whiten(columns).reshape(B.shape)
        total, gamma, _ = _ridge(columns, white)
        left = (d - B @ gamma).reshape(-1, 3)
        told = level_of(now, same, left, total)
        if told is None:
            level = Level(max(float(np.hypot(level.scatter, level.lasting)), total))
        else:
            level = Level(told.scatter, max(told.lasting, level.lasting))
    covariance = _covariance(reference, now, B, level, same)
    each_way = _each_way(reference, now.scene)
    looked_for = each_way[0]
    least = np.array([(sizes or {}).get(c.name, 1.0) for c in looked_for])
    A = np.concatenate([np.stack([now.of(c.displacement).ravel() for c in way], axis=1) * least for way in each_way], axis=1)
    WA = weighted(covariance, _station(now), A)
    moved = np.linalg.norm(A.reshape(-1, 3, A.shape[1]), axis=1).max(axis=0)
    z, information, share = (
        v.reshape(len(each_way), -1) for v in (WA.T @ d, np.einsum("ij,ij->j", A, WA), moved / reference.tolerance)
    )
    return _decide(looked_for, least, z, information, share, len(np.unique(places(now))), len(now.poses), last)


def signal_to_noise(reference: Reference, session: Session, displacement: Array, repeats: float = 1.0) -> float:
    """Of a change in the rows of a check, by the best test that there is: one that is told how each row changes.

    With false alarms of probability a it finds the change with probability Phi(this - z), where Phi(z) = 1 - a.

    Args:
        displacement: of the observed point by the change, relative to that at the reference, (m, 3), m, in base_link.
        repeats: as if each row were the mean of so many.
    """
    now = _observed(reference, session)
    B = _columns(reference.terms, now).reshape(3 * len(now.rows), -1)
    a = displacement.reshape(-1, 1)
    level = replace(reference.level, scatter=reference.level.scatter / np.sqrt(repeats))
    covariance = _covariance(reference, now, B, level, same_readings(now))
    return float(np.sqrt(max((a.T @ weighted(covariance, _station(now), a)).item(), 0.0)))


def _observed(reference: Reference, session: Session) -> Observation:
    """The observation of a check, which sees as much of the arm's sag as the calibration did."""
    share = reference.observation.scene.view.sags
    return observe_with_force_noise(with_stations_found(session), reference.terms, sag_share=share)


def _covariance(reference: Reference, now: Observation, B: Array, level: Level, same: IntArray) -> Array:
    """Of the displacements of a check, (3 m, 3 m), m^2: noise of the rows, and what the calibration leaves open of columns B."""
    noise = np.kron(covariance_of_rows(level, row_covariance(now), same), np.eye(3))
    return np.asarray(noise + B @ reference.covariance @ B.T, dtype=np.float64)


def _station(now: Observation) -> Array:
    return station_columns(now.of(now.scene.p_observed) + now.y)


def weighted(covariance: Array, nuisance: Array, columns: Array) -> Array:
    """W A with the inverse covariance W of rows (n, n) of which columns (n, r) with unit variance are unknown; A (n, p)."""
    L = cho_factor(covariance, lower=True)
    Z, U = cho_solve(L, columns), cho_solve(L, nuisance)
    return np.asarray(Z - U @ np.linalg.solve(np.eye(nuisance.shape[1]) + nuisance.T @ U, nuisance.T @ Z), dtype=np.float64)


def _decide(
    looked_for: Sequence[Change], least: Array, z: Array, information: Array, moved: Array, poses: int, visits: int, last: bool
) -> QuickResult:
    """Decide from the scores z and informations of the changes, and by what share of the tolerance they move the tool, each at
    its size `least`, and in each way that it may go: (ways, changes)."""
    so_far = f"{visits} visits to {poses} pose{'s' if poses > 1 else ''}"
    k = np.array(SIZES)[:, None, None]
    log_ratio = k * z - 0.5 * k**2 * information  # (sizes, ways, changes)
    e_value = float(np.exp(min(logsumexp(log_ratio) - np.log(log_ratio.size), 700.0)))
    ratio = {c.name: float(np.exp(min(r, 700.0))) for c, r in zip(looked_for, log_ratio[0].max(axis=0), strict=True)}
    by_way = logsumexp(log_ratio, axis=0)
    likeliest = by_way.argmax(axis=0), np.arange(len(looked_for))
    times = np.clip(np.divide(z, information, out=np.zeros_like(z), where=information > 0), 0.0, None)[likeliest]
    found = times * least
    size = {c.name: float(f) for c, f in zip(looked_for, found, strict=True)}
    named = {c.name: c for c in looked_for}
    words = {c.name: c.text(size[c.name]) for c in looked_for}
    by_change = by_way[likeliest]
    order = np.argsort(-by_change)
    likely = [i for i in order if by_change[i] > by_change[order[0]] - np.log(20.0)]
    like = tuple(looked_for[i].name for i in likely if times[i] * moved[likeliest][i] >= NOTABLE)
    if e_value >= 1.0 / FALSE_ALARM and poses >= FEWEST_TO_ALARM:
        looks = " or ".join(words[n] for n in like[:3])
        looks = f"It looks like: {looks}." if like else "By micrometres only: none of the changes looked for matters."
        text = f"The robot has changed since its calibration (odds {odds_text(e_value)} after {so_far}). {looks}"
        text = with_advice(text, "run the full recalibration.")
        return QuickResult("changed", e_value, ratio, size, like, poses, text, named, words, visits)
    lowest = ndtri(MISSED / 2.0)  # of (estimate - size) / standard error, for a robot that has changed by just that size
    root = np.sqrt(np.maximum(information, 1e-300))
    far_below = (log_ratio[0] <= np.log(MISSED / 2.0)) | (last & (information > 0) & ((z - information) / root <= lowest))
    excluded = {c.name for c, out in zip(looked_for, far_below.all(axis=0), strict=True) if out}
    if poses >= FEWEST_POSES and set(ratio) <= excluded:
        text = f"The robot is as it was when it was calibrated ({so_far}). Nothing has to be done."
        return QuickResult("pass", e_value, ratio, size, (), poses, text, named, words, visits)
    left = [c.text(k) for c, k in zip(looked_for, least.tolist(), strict=True) if c.name not in excluded]
    more = f" and {len(left) - 3} more" if len(left) > 3 else ""
    text = f"After {so_far} not excluded yet: {', '.join(left[:3]) or 'any change'}{more}."
    return QuickResult("undecided", e_value, ratio, size, (), poses, text, named, words, visits)


def odds_text(of_change: float) -> str:
    """`120 to 1`, `1 to 3000`; what is beyond ten thousand needs no figure."""
    larger = max(of_change, 1.0 / max(of_change, 1e-300))
    figure = f"{larger:.2g}" if larger < 100.0 else f"{larger:.0f}" if larger < 1e4 else "more than 10000"
    return f"{figure} to 1" if of_change >= 1.0 else f"1 to {figure}"


def row_covariance(observation: Observation) -> Array:
    """Covariance of the observed rows per coordinate, (m, m), m^2: their own noise, and that of the reference they share."""
    w = observation.whiten
    same = w.group[:, None] == w.group[None, :]
    return np.diag(w.sigma**2) + np.where(same, w.sigma_reference[:, None] * w.sigma_reference[None, :], 0.0)


def station_columns(displacement: Array) -> Array:
    """Change of displacements (m, 3) by one standard deviation of the station's rotation about x, y, z: (3 m, 3)."""
    return np.stack([np.cross(e, displacement).ravel() for e in np.eye(3)], axis=1) * STATION_ROTATION
