# SPDX-License-Identifier: Apache-2.0
"""What a remainder claims to explain is what model and remainder explain together."""

from __future__ import annotations

import numpy as np
from irec_calibration.diagnose.evidence import Bench, Block
from irec_calibration.diagnose.family import Family, Structure
from irec_calibration.diagnose.remainder import grow
from numpy.typing import NDArray

Array = NDArray[np.float64]
N = 300
RNG = np.random.default_rng(1)
P, Q = RNG.normal(size=(2, N))
NOISE = RNG.normal(size=N)
POSE = np.repeat(np.arange(N // 15), 15)


def _spring(lower: float) -> Block:
    """One that moves along both directions, whose prior leaves it free."""
    return Block((P + Q)[:, None], np.array([lower]), np.array([np.inf]), np.array([10.0]))


def _along_p() -> Family:
    return Family((Structure(("joint_1",), "along p", slice(0, 1), 1),), P[:, None].copy())


def _loss(bench: Bench, *columns: tuple[Array, float]) -> float:
    """Smallest squared residual and penalty, by columns with the width of the prior of each."""
    X = np.concatenate([np.stack([c for c, _ in columns], axis=1), np.diag([1.0 / width for _, width in columns])])
    y = np.concatenate([bench.b, np.zeros(len(columns))])
    return float(((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2).sum())


def test_a_structure_gains_nothing_by_a_spring_that_is_less_than_rigid():
    bench = Bench(7.0 * P - 2.0 * Q + NOISE, POSE)  # alone the spring is soft; beside the structure it would have to be -2
    (bounded,), (free,) = (grow(bench, _along_p(), _spring(lower)).parts for lower in (0.0, -np.inf))
    assert bounded.amplitude == free.amplitude
    own = P, free.amplitude
    losses = np.array([_loss(bench, own, (P + Q, 10.0)), _loss(bench, own)])  # with the spring, and at its bound
    with_spring, without = bench.log_fit(losses)
    assert with_spring - without > 100.0
    np.testing.assert_allclose(bounded.log_evidence, free.log_evidence - (with_spring - without), rtol=1e-6)


def test_a_structure_that_explains_only_with_such_a_spring_is_not_taken():
    bench = Bench(0.5 * P - 0.2 * Q + NOISE, POSE)
    hidden = Family(_along_p().structures, (P + 0.98 * Q)[:, None])
    assert not grow(bench, hidden, _spring(0.0)).parts
    assert grow(bench, hidden, _spring(-np.inf)).parts
