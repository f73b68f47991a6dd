# SPDX-License-Identifier: Apache-2.0
"""From a driven course to what `course_filter.learn` takes: what the model predicts for each axis of the force, and how far that
would have moved the TCP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array

from .course_filter import DrivenCourse
from .deflection import Deflection
from .filters import Filter
from .fir import nearness
from .offset_answer import moved_by, moved_by_axes
from .preview import Preview

_APART = 50  # samples between two places at which the model is asked for its slopes
_STEP = 30.0  # N, by which the force is changed for that


@dataclass(frozen=True)
class Answers:
    """Postures (m, joints), rad, and the answer of the TCP to an offset at each (`offset_answer.impulse`)."""

    postures: Array
    impulses: Sequence[Array]


@dataclass(frozen=True)
class Known:
    """Force that the correction knows from other courses (`preview.file`), in tool0, each (k, 3), N: as it is expected now, with
    the stages before the filter passed, and as it is expected when an offset acts."""

    now: Array
    ahead: Array


@dataclass(frozen=True)
class DrivenPart:
    """Samples of a course.

    Attributes:
        q: (k, joints), rad; force: in tool0 as the filter will get it, (k, 3), N.
        moved: deviation of the TCP in base_link, (k, 3), m.
        counts: direction that counts, unit, in base_link, (k, 3). used: samples to learn from, (k,). rail: m.
        offset: as it was sent to the robot, in base_link, (k, 3), m, where the course was driven with correction.
        known: where the correction will have a force profile: the filter is then learnt for what this does not tell.
    """

    q: Array
    force: Array
    moved: Array
    counts: Array
    used: Array
    rail: float = 0.0
    offset: Array | None = None
    known: Known | None = None


def passed(stages: Sequence[Filter], force: Array) -> Array:
    """Forces (k, 3), N, as they leave these stages."""
    if not stages:
        return force
    out = np.zeros((len(force), 6))
    for k, one in enumerate(force):
        sample = np.concatenate([one, np.zeros(3)])
        for stage in stages:
            sample = stage.step(sample)
        out[k] = sample
    return np.asarray(out[:, :3])


def known_along(preview: Preview, q: Array, reading: Array, stages: Sequence[Filter]) -> Known:
    """What a correction with this profile knows along a course.

    Args:
        preview: made without filters. q: (k, joints), rad. reading: force before the filters, in tool0, (k, 3), N.
        stages: of the wrench before the filter.
    """
    preview.reset()
    for stage in stages:
        stage.reset()
    now, ahead = np.zeros_like(reading), np.zeros_like(reading)
    for k, (angles, force) in enumerate(zip(q, reading, strict=True)):
        preview.step(angles, np.concatenate([force, np.zeros(3)]))
        now[k], ahead[k] = (wrench[:3] for wrench in preview.expected())
    return Known(passed(stages, now), ahead)


def driven_course(deflection: Deflection, part: DrivenPart, answers: Answers, postures: Array, period: float) -> DrivenCourse:
    """What is learnt from; postures: that have taps of their own, (m, joints), rad.

    What an offset has moved by the measured answer is taken off: what is left is the deviation as it would be without correction.
    Where that answer is not quite that of the arm, a filter learnt from courses that it corrected itself is wrong by less.

    A known force reaches the model without the filter, ahead of its time: what it moves is taken off too, and the filter is
    learnt on the rest of the force.
    """
    slope = _slope(deflection, part)
    near, impulses = nearness(answers.postures, part.q), list(answers.impulses)
    # what the springs' curves make of the force beyond the sum over its axes passes whatever the taps are
    passing = _predicted(deflection, part, period) - (slope * part.force[:, :, None]).sum(axis=1)
    force = part.force
    if part.known is not None:
        force = force - part.known.now
        passing = passing + (slope * part.known.ahead[:, :, None]).sum(axis=1)
    beyond = moved_by(impulses, near, passing if part.offset is None else passing + part.offset)
    deviation = ((part.moved - beyond) * part.counts).sum(axis=1)
    moved = moved_by_axes(impulses, near, slope, force, part.counts)
    return DrivenCourse(moved, deviation, slope, force, nearness(postures, part.q), part.used)


def _predicted(deflection: Deflection, part: DrivenPart, period: float) -> Array:
    """Predicted deflection along a course, (k, 3), m."""
    deflection.reset()
    still = np.zeros(3)
    return np.array([deflection(a, f, still, period, part.rail)[0].copy() for a, f in zip(part.q, part.force, strict=True)])


def _slope(deflection: Deflection, part: DrivenPart) -> Array:
    """Predicted deflection per force along each axis, about the force that there is, (k, 3 axes, 3), m/N."""
    q, force = part.q, part.force
    at = np.unique(np.r_[np.arange(0, len(q), _APART), len(q) - 1])
    slope = np.empty((len(at), 3, 3))
    still = np.zeros(3)
    deflection.reset()
    for j, k in enumerate(at):
        about = force[max(0, k - _APART) : k + _APART].mean(axis=0)
        for a in range(3):
            d = _STEP * np.eye(3)[a]
            up = deflection(q[k], about + d, still, 0.0, part.rail)[0].copy()
            slope[j, a] = (up - deflection(q[k], about - d, still, 0.0, part.rail)[0]) / (2.0 * _STEP)
    t = np.arange(len(q))
    return np.stack([np.interp(t, at, slope[:, a, p]) for a in range(3) for p in range(3)], axis=1).reshape(-1, 3, 3)
