# SPDX-License-Identifier: Apache-2.0
"""What models predict for the process course: the deviation without correction, and what an earlier model would leave of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..effects.of_session import scene_of
from ..model import Model, regressors
from ..poses.course import Course
from ..typing import Array
from .study import Study


@dataclass(frozen=True)
class OnCourse:
    """A course as the model in use predicts it, n points; absolute lateral deviations, m.

    Attributes:
        s: way along the course, (n,), m.
        without: no correction. before: corrected with the earlier model, if the one in use is right.
        se: standard error of the prediction, from the parameters' standard errors; tolerance: of the process, m.
        is_turned: the cell file says how the tool is turned about its axis.
    """

    s: Array
    without: Array
    before: Array
    se: Array
    tolerance: float
    is_turned: bool = False

    def in_words(self) -> str:
        """One sentence with mean and largest deviations, mm."""
        without, before = (f"{1e3 * v.mean():.3f} (at most {1e3 * v.max():.3f})" for v in (self.without, self.before))
        turned = "as the cell file says (course.tool_x)" if self.is_turned else "as in the nearest pose of the session"
        return (
            f"Predicted lateral deviation on the course, if this model is right: {without} mm without correction,"
            f" {before} mm corrected with the first model; this model itself is known to {1e3 * self.se.mean():.3f} mm"
            f" there (standard error). The tolerance is {1e3 * self.tolerance:.2f} mm. Each point is pressed on by"
            f" itself, the tool turned about its axis {turned}."
        )


def on_course(course: Course, before: Model, after: Study) -> OnCourse:
    """Predict a course with an earlier model and the one in use.

    Args:
        before: what the controller would be corrected with today; after: the model in use, as fitted to the session.
    """
    scene = scene_of(course.session, observe="tcp")
    pressed = course.session.load_case != 0
    old = before.predict(scene)[pressed]
    new = Model(after.terms, course.session.serial).predict(scene)[pressed]
    return OnCourse(
        course.s,
        np.abs(course.across(new)),
        np.abs(course.across(new - old)),
        _standard_error(course, after),
        course.tolerance,
        course.is_turned,
    )


def _standard_error(course: Course, study: Study) -> Array:
    """Of the lateral deviation at each point, from the posterior covariance of the fit, (n,), m."""
    scene = scene_of(course.session, observe="tcp")
    blocks = []
    for term, block in zip(study.terms, regressors(study.terms, scene), strict=True):
        blocks.append(block[:, :, term.free(term.effect.parameters(scene))])
    columns = scene.change(np.concatenate(blocks, axis=2))[course.session.load_case != 0] * study.scale
    lateral = np.stack([course.across(columns[:, :, p]) for p in range(columns.shape[2])], axis=1)
    H = study.base.A.T @ study.base.A + np.diag(1.0 / study.base.width**2)
    return np.asarray(np.sqrt(np.einsum("np,pn->n", lateral, np.linalg.solve(H, lateral.T))))
