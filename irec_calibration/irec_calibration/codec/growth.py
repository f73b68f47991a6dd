# SPDX-License-Identifier: Apache-2.0
"""When are there enough poses: where growth has saturated, and what the next pose is expected to gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import PlanError
from ..model import Term
from ..session.data import Session
from ..typing import Array
from .algorithm1 import Codec, pose_data, run_codec

SATURATED = 0.05  # share by which the mean error may exceed what twice the largest training set is expected to reach
ENOUGH = 0.01  # expected gain of the next pose below which there are enough
_DRAWS = 400


@dataclass(frozen=True)
class Growth:
    """What a CODEC says about the number of poses. Intervals are 5 to 95 %, from resampling the combinations; these share
    their poses, so the true uncertainty is somewhat larger.

    saturated_at: smallest training set from which on the mean error stays within 5 % of what twice the largest set is expected
        to reach, with (low, high) beside it; one more than the largest set where growth has not saturated.
    next_gain: share by which one pose more than the session has is expected to lower the mean error, (low, high) beside it.
    poses: number of poses of the session.
    """

    saturated_at: int
    saturated_interval: tuple[int, int]
    next_gain: float
    next_gain_interval: tuple[float, float]
    poses: int
    largest_training_set: int

    @property
    def saturated(self) -> bool:
        """Whether growth has come to rest before the largest training set."""
        return self.saturated_at <= self.largest_training_set

    @property
    def enough(self) -> bool:
        """Whether the next pose is expected to gain less than 1 %, with 95 % confidence."""
        return self.next_gain_interval[1] < ENOUGH

    def __str__(self) -> str:
        low, high = self.saturated_interval
        least, most = self.next_gain_interval
        gain = f"{100 * self.next_gain:.1f} % ({100 * least:.1f} to {100 * most:.1f} %)"
        if self.saturated:
            where = f"accuracy has saturated at {self.saturated_at} training poses ({low} to {high})"
        else:
            where = f"accuracy is still growing at {self.largest_training_set} training poses"
        verdict = f"enough: after {self.poses} poses the next one" if self.enough else f"not enough: pose {self.poses + 1}"
        return f"{verdict} is expected to gain {gain}; {where}"


def growth_of(codec: Codec) -> Growth:
    """Saturation and expected gain of a CODEC.

    Between its start and its floor the mean error follows e^2 = a + b / j with j training poses (variance of a fit falls with the
    number of data); a and b come from the upper half of the chart and carry it on to the size of the session.

    Raises PlanError: fewer than four sizes of training sets.
    """
    n_cv, n_c = codec.norm_mean.shape
    if n_c < 4:
        raise PlanError(f"growth can't be judged from training sets of up to {n_c} poses, 4 are needed: measure more poses")
    rng = np.random.default_rng(0)
    draws = codec.norm_mean[rng.integers(n_cv, size=(_DRAWS, n_cv))].mean(axis=1)
    curve = codec.norm_mean.mean(axis=0)
    low, high = np.percentile(_saturation(draws), [5, 95])
    gain_low, gain_high = np.percentile(_next_gain(draws, codec.poses), [5, 95])
    return Growth(
        saturated_at=int(_saturation(curve[None])[0]),
        saturated_interval=(int(np.floor(low)), int(np.ceil(high))),
        next_gain=float(_next_gain(curve[None], codec.poses)[0]),
        next_gain_interval=(float(gain_low), float(gain_high)),
        poses=codec.poses,
        largest_training_set=n_c,
    )


def growth_so_far(session: Session, terms: Sequence[Term]) -> tuple[Codec, Growth]:
    """CODEC (COVER, 70/30) and verdict of the poses measured so far: for use while the procedure runs.

    Raises:
        PlanError: too few poses yet. SolveError: the model can't be identified from them.
    """
    codec = run_codec(pose_data(session, terms), label="so far")
    return codec, growth_of(codec)


def _saturation(curves: Array) -> Array:
    """Smallest number of poses from which on each curve (k, n_c) stays near its expected end, n_c + 1 for none, (k,)."""
    n_c = curves.shape[1]
    above = curves > (1.0 + SATURATED) * _expected(curves, 2 * n_c)[:, None]
    return np.where(above.any(axis=1), n_c - np.argmax(above[:, ::-1], axis=1) + 1, 1)


def _next_gain(curves: Array, poses: int) -> Array:
    """Expected relative gain from `poses` to `poses` + 1 training poses of each curve (k, n_c), (k,)."""
    return 1.0 - _expected(curves, poses + 1) / _expected(curves, poses)


def _expected(curves: Array, poses: int) -> Array:
    """Error that each curve (k, n_c) is expected to reach with a number of training poses, (k,)."""
    n_c = curves.shape[1]
    first = min(n_c // 2, n_c - 3)
    inverse = 1.0 / np.arange(first + 1, n_c + 1)
    design = np.column_stack([np.ones_like(inverse), inverse])
    upper = curves[:, first:] ** 2
    a, b = np.linalg.lstsq(design, upper.T, rcond=None)[0]
    rises = b <= 0.0  # a curve that rises with more poses does so by chance
    squared = np.where(rises, upper.mean(axis=1), a + b / poses)
    # the start of a steep curve may ask for a negative end: then it falls as 1 / sqrt(poses) at most
    least = upper[:, -1] * min(n_c / poses, 1.0)
    return np.sqrt(np.maximum(squared, least))
