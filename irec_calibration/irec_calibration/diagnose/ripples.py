# SPDX-License-Identifier: Apache-2.0
"""What repeats many times per turn of a joint: the transmission error of a gear, an encoder with many lines.

Smooth functions of an angle don't follow it, and unseen it passes for noise. How often it repeats is not known beforehand, so it
is looked for in what a model leaves, and the number of frequencies that were tried counts against it. In absolute sessions only:
between two readings at one pose it cancels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effects.joint_ripple import FEWEST as FIRST
from ..effects.joint_ripple import MOST as LAST
from ..typing import Array, ComplexArray
from .study import Study

FEWEST, MOST = 3.0, 400.0  # repeats per turn; smooth functions follow fewer, and gears have up to some 320
FEWEST_IN_SPAN = 1.5  # repeats within the angles of a session
ROWS_SEARCHED = 2000  # of a larger session: enough to find what readings follow
LEAST = 3e-2  # of the largest: directions in a band of frequencies that angles over less than a turn do not show
FINER = 21  # frequencies about the strongest one, over two steps
KEPT = 3  # of each residual, the strongest


def ripples(study: Study, residuals: Sequence[Array]) -> Iterator[tuple[int, float, str, Array, int]]:
    """The ripples that residuals follow most: of each residual one per joint, in the joints where most is won.

    Args:
        residuals: of the observed rows, (m, 3) each, m.

    Yields:
        joint (counted from 0), repeats per turn, words, displacement by sine and cosine in all rows of the session, (n, 3, 2),
        m/rad, how many frequencies of joints were tried; then, for each joint once, the same for all frequencies of a band
        together, (n, 3, p), with the strongest of them, and how many joints there are.
    """
    scene, rows = study.ready, study.observation.rows
    turning = np.flatnonzero(scene.driven & ~scene.kin.is_prismatic)
    if scene.kind != "absolute" or not len(turning):
        return
    some = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), ROWS_SEARCHED)).astype(int))
    sigma = study.observation.whiten.sigma[some, None]
    by_joint = {int(k): _frequencies(scene.q[rows[some], k]) for k in turning}
    tried = sum(len(f) for f in by_joint.values())
    best: dict[tuple[int, float], float] = {}
    for residual in residuals:
        r = residual[some] / sigma
        found = {}
        for k, frequency in by_joint.items():
            if len(frequency):
                n, power = _strongest(scene.q[rows[some], k], scene.J[rows[some], :, k] / sigma, r, frequency)
                found[k, n] = power
        best |= dict(sorted(found.items(), key=lambda t: -t[1])[:KEPT])
    for k, n in best:
        waves = _waves(scene.q[:, k], np.array([n]))
        yield k, n, f"turning axis {k + 1}, {n:.3g} times per turn", scene.J[:, :, k, None] * waves[:, None], tried
    strongest = {k: n for k, n in reversed(best) if n <= LAST}
    for k, n in strongest.items():  # gears and encoders have many at once
        band = _waves(scene.q[:, k], np.arange(FIRST, LAST + 1.0))
        _, size, directions = np.linalg.svd(band, full_matrices=False)
        band = band @ directions[size > LEAST * size[0]].T
        yield k, n, f"turning axis {k + 1}, many times per turn", scene.J[:, :, k, None] * band[:, None], len(turning)


def _waves(q: Array, frequency: Array) -> Array:
    """Sines and cosines of angles (n,), rad, at some frequencies (f,), per turn, (n, 2f)."""
    phase = q[:, None] * frequency
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def _frequencies(q: Array) -> Array:
    """Repeats per turn that angles (m,), rad, can show, as close as they tell them apart."""
    span = float(np.ptp(q)) / (2.0 * np.pi)
    first = max(FEWEST, FEWEST_IN_SPAN / max(span, 1e-9))
    return np.arange(first, MOST, 0.5 / span) if first < 0.5 * MOST else np.zeros(0)


def _strongest(q: Array, by_angle: Array, residual: Array, frequency: Array) -> tuple[float, float]:
    """The frequency with the most power, and that; arguments as of `_power`."""
    step = frequency[1] - frequency[0]
    near = frequency[int(np.argmax(_power(q, by_angle, residual, frequency)))] + np.linspace(-step, step, FINER)
    power = _power(q, by_angle, residual, near)
    i = int(np.argmax(power))
    return float(near[i]), float(power[i])


def _turned_sums(q: Array, x: Array, frequency: Array) -> ComplexArray:
    """Sums over m of x exp(i n q) at evenly spaced frequencies n, (f,): a product of few coarse and few fine steps of n."""
    step = frequency[1] - frequency[0]
    fine = int(np.ceil(np.sqrt(len(frequency))))
    coarse = np.exp(1j * frequency[::fine, None] * q)
    within = np.exp(1j * step * np.arange(fine)[:, None] * q)
    out: ComplexArray = ((coarse * x) @ within.T).ravel()[: len(frequency)]
    return out


def _power(q: Array, by_angle: Array, residual: Array, frequency: Array) -> Array:
    """How far the squared residual falls with sine and cosine of each frequency, (f,).

    Args:
        q: angles of the joint, (m,), rad. by_angle: displacement by it, (m, 3), standard deviations per rad. residual: (m, 3),
            standard deviations. frequency: (f,), per turn, evenly spaced.
    """
    along, weight = (by_angle * residual).sum(axis=1), (by_angle**2).sum(axis=1)
    b = _turned_sums(q, along, frequency)
    twice = _turned_sums(2.0 * q, weight, frequency)
    ss, cc, sc = 0.5 * (weight.sum() - twice.real), 0.5 * (weight.sum() + twice.real), 0.5 * twice.imag
    determinant = np.maximum(ss * cc - sc**2, 1e-12 * weight.sum() ** 2)
    s, c = b.imag, b.real
    out: Array = (cc * s**2 - 2.0 * sc * s * c + ss * c**2) / determinant
    return out
