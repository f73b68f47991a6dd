# SPDX-License-Identifier: Apache-2.0
"""What a remainder claims to explain is what model and remainder explain together."""

from __future__ import annotations

import numpy as np
from irec_calibration.diagnose.evidence import Bench, Block
from irec_calibration.diagnose.family import Family, Structure
from irec_calibration.diagnose.remainder import grow

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


def test_a_structure_gains_nothing_by_a_spring_that_is_less_than_rigid():
    bench = Bench(7.0 * P - 2.0 * Q + NOISE, POSE)  # alone the spring is soft; beside the structure it would have to be -2
    bounded, free = (grow(bench, _along_p(), _spring(lower)) for lower in (0.0, -np.inf))
    claimed = bounded.gained
    shown = bench.posterior(bounded.block).log_evidence - bench.posterior(_spring(0.0)).log_evidence
    assert len(bounded.parts) == 1 and claimed <= shown + 5.0  # nats that a spring at its bound is worth
    assert claimed < 0.6 * free.gained


def test_a_structure_that_explains_only_with_such_a_spring_is_not_taken():
    bench = Bench(0.5 * P - 0.2 * Q + NOISE, POSE)
    hidden = Family(_along_p().structures, (P + 0.98 * Q)[:, None])
    assert not grow(bench, hidden, _spring(0.0)).parts
    assert grow(bench, hidden, _spring(-np.inf)).parts
