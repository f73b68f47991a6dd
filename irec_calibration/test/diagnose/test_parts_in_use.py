# SPDX-License-Identifier: Apache-2.0
"""Which parts of a named effect an improved model has, where a remainder without a name does part of its work."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.candidates import try_effect
from irec_calibration.diagnose.parts import prune
from irec_calibration.diagnose.shape import refit
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.scene import Scene
from numpy.typing import NDArray

GAIN = find_effect("sensor_gain")
WRONG = np.array([[0.0, 0.06, 0.0], [-0.05, 0.0, 0.0], [0.0, 0.0, 0.0]])


def read_wrongly(scene: Scene) -> NDArray[np.float64]:
    """Displacement by what the force sensor does not read, at a compliance of the tool that is the same everywhere."""
    force = np.einsum("nij,nj->ni", scene.kin.R_tool, scene.force_in_tool @ WRONG.T)
    return 2e-6 * force


@pytest.fixture(scope="module")
def fitted() -> Study:
    measured = synthetic.session(poses=20, seed=5, extra=read_wrongly)
    study = prepare(measured, start_terms(measured)).to_weigh
    trial = try_effect(study, GAIN)
    assert trial is not None
    found = refit(study, trial)
    assert found is not None
    return found


def in_use(study: Study) -> set[str]:
    return {n for t in study.terms if t.effect is GAIN for n in t.estimates}


def test_parts_that_a_remainder_made_needless_stay_in_the_model(fitted: Study) -> None:
    """The remainder moves as the named effect does: beside it no part is asked for, and the model would predict without it."""
    own = [i for i, owner in enumerate(fitted.owners) if owner == GAIN.id]
    alone = prune(fitted, (GAIN.id,))
    beside = prune(fitted, (GAIN.id,), fitted.base.take(own))
    assert len(in_use(alone.study)) >= 2
    assert in_use(beside.study) == in_use(alone.study)
    assert beside.study.fit.rms == pytest.approx(alone.study.fit.rms, rel=0.01)
    assert beside.parts[GAIN.id].proven == ()  # none is proven by it
