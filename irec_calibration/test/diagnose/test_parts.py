# SPDX-License-Identifier: Apache-2.0
"""What is said of the parts of an effect, by the scores of its sets alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.diagnose.evidence import Posterior
from irec_calibration.diagnose.part_sets import Names, PartSets

TWO, TWO_AND_THREE, TWO_AND_FIVE = ("axis 2",), ("axis 2", "axis 3"), ("axis 2", "axis 5")


class Known(PartSets):
    """Sets with scores and squared residuals that are given."""

    def __init__(self, sets: dict[Names, tuple[float, float]]) -> None:
        self.names = ("axis 2", "axis 3", "axis 5")
        self.rest = SimpleNamespace(bench=SimpleNamespace(saved=lambda before, after: before - after))
        self.alone = Posterior(np.zeros(0), 1000.0, -1000.0)
        self._known = {n: (score, Posterior(np.zeros(0), chi2, score), 0) for n, (score, chi2) in sets.items()}

    def fit(self, names: Names) -> tuple[float, Posterior, int]:
        return self._known.get(names, (-1000.0, self.alone, 0))


@pytest.mark.parametrize(("left", "one_of"), [(110.0, ()), (200.0, (("axis 3",), ("axis 5",)))])
def test_one_of_several_further_parts_is_there_only_where_it_brings_more_than_an_inexact_form_does(left, one_of) -> None:
    sets = Known({TWO_AND_THREE: (0.0, 100.0), TWO_AND_FIVE: (-2.8, 103.0), TWO: (-8.0, left)})
    said = sets.parts(TWO_AND_THREE, [TWO_AND_FIVE])
    assert (said.proven, said.one_of) == (TWO, one_of)
    assert said.perhaps == (() if one_of else ("axis 3",))
