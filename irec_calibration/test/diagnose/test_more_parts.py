# SPDX-License-Identifier: Apache-2.0
"""An effect that a model has already gets the further axes that it needs, and no others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.explanation import Explanation
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.more_parts import with_more_parts
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.study import prepare, study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term
from numpy.typing import NDArray

ZERO = 1.5e-3  # rad


def model_of_axis_2(*wrong: int) -> tuple[Explanation, Any]:
    """A model that has the wrong zero of axis 2, of a robot with wrong zeros of some axes; and the structures of the session."""

    def displaced(scene: Scene) -> NDArray[np.float64]:
        return np.asarray(ZERO * scene.J[:, :, [k - 1 for k in wrong]].sum(axis=2))

    session = synthetic.session(poses=24, seed=8, extra=displaced, approach=0.03)
    start = prepare(session, start_terms(session))
    effect = find_effect("geometry_error")
    own = {p.name: Estimate(0.0, unit=p.unit) for p in effect.parameters(start.ready) if p.group == "axis 2"}
    study = study_of(start.observation, (*start.terms, Term(effect, own)))
    family = family_of(study)
    return Explanation(study.terms[-1:], study, 0.0, grow(study.bench, family, study.base)), family


def axes(one: Explanation) -> set[str]:
    return {p.group for p in one.added[0].effect.parameters(one.study.ready) if p.name in one.added[0].estimates}


@pytest.mark.parametrize(("wrong", "found"), [((2, 1), {"axis 1", "axis 2"}), ((2,), {"axis 2"})])
def test_an_effect_gets_the_axes_that_it_lacks_and_no_others(wrong: tuple[int, ...], found: set[str]) -> None:
    one, family = model_of_axis_2(*wrong)
    wider = with_more_parts(one, family, lambda: None, SETTINGS)
    assert axes(wider) == found
    gained = wider.named - one.named
    assert gained > SETTINGS.nats_to_name if len(wrong) > 1 else gained == 0.0


def test_the_rest_of_a_model_stays_as_it_is() -> None:
    one, family = model_of_axis_2(2, 1)
    wider = with_more_parts(one, family, lambda: None, SETTINGS)
    assert [t.effect.id for t in wider.study.terms] == [t.effect.id for t in one.study.terms]
    assert wider.added[0].estimates["zero_1"].value == pytest.approx(ZERO, rel=0.2)
