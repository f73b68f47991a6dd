# SPDX-License-Identifier: Apache-2.0
"""What a remainder claims to explain is what model and remainder explain together."""

from __future__ import annotations

import numpy as np
import pytest
from irec_calibration.diagnose import remainder
from irec_calibration.diagnose.evidence import Bench, Block
from irec_calibration.diagnose.family import Family, Structure
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.remainder import Part, Remainder, grow
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


@pytest.mark.parametrize(
    ("off", "by_structures", "is_accident"),
    [(2, 100.0, True), (5, 100.0, False), (5, 60.0, True)],
    ids=["few poses", "structures do about as well", "structures do worse"],
)
def test_many_poses_that_stand_out_are_no_accidents_where_structures_do_about_as_well(
    monkeypatch, off, by_structures, is_accident
):
    law = Part(Structure(("joint_1",), "along p", slice(0, 1), 1), 1.0, by_structures)
    poses = [Structure((), f"all of pose {i}", slice(i, i + 1), 20, is_bad_row=True, rows=(i, i + 1)) for i in range(1, off + 1)]
    accidents = tuple(Part(p, 1.0, 110.0 / off) for p in poses)

    def grown(bench, family, base, start, most, left_out):
        parts = (law,) if left_out(poses[0]) else accidents
        assert all(not left_out(p.structure) for p in (*start, *parts))
        return Remainder(parts, 0.0, base, slice(1, None))

    monkeypatch.setattr(remainder, "_grow", grown)
    found = grow(Bench(NOISE, POSE), _along_p(), _spring(0.0), start=accidents)
    assert found.parts == (accidents if is_accident else (law,))


def test_what_rounding_leaves_of_columns_gains_nothing():
    rng = np.random.default_rng(1)
    here = np.where((np.arange(N) >= 30) & (np.arange(N) < 39), rng.normal(size=N), 0.0)  # some readings, seen by four columns
    sizes, rests = np.array([570.0, 1.7e7, 55.0, 0.0]), np.array([0.01, 0.006, 0.005, 0.035])
    A = here[:, None] * sizes + rng.normal(size=(N, 4)) * rests
    ground = Ground(Bench(NOISE + 3.0 * P, POSE), _spring(0.0))
    gain, _ = Family((Structure((), "along four columns", slice(0, 4), 1),), A).gains(ground)
    each = [Family((Structure((), "along one", slice(0, 1), 1),), A[:, j : j + 1].copy()).gains(ground)[0][0] for j in range(4)]
    assert gain[0] < max(each) + 1.0
