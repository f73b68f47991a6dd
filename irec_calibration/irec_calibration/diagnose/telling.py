# SPDX-License-Identifier: Apache-2.0
"""Which samples tell two models apart: the evidence to be expected of them once what either leaves free is refitted.

A sample tells where the models predict different displacements, but for what the parameters of the one that is wrong would make
up for, as far as the session leaves them open. With r the difference of the predictions in standard deviations, J the derivatives
of the model that is wrong and P the covariance of its parameters after the session, samples are expected to bring log odds of

    r' (1 + J P J')^-1 r / 2    nats,    with a variance of twice that

(T-optimality after Atkinson and Fedorov 1975, with what the session knows). Poses are chosen one by one; what is chosen counts as
measured: P shrinks, and r by what a refit would make up for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ..identification.observe import Observation, observe
from ..session.data import Session
from ..typing import Array, IntArray
from .freed import Freed, in_question
from .questions import Question
from .settings import SETTINGS


@dataclass(frozen=True)
class Told:
    """Poses chosen to answer questions.

    Attributes:
        chosen: indices of poses in the order of choice, (n,).
        nats: log odds to be expected of the first 1 .. n of them, where the first model is right and where the second is,
            (questions, n, 2).
    """

    questions: tuple[Question, ...]
    chosen: IntArray
    nats: Array

    def chance(self, question: int, poses: int | None = None) -> float:
        """Probability that so many poses answer a question (that an effect is there: if it is)."""
        one = self.questions[question]
        nats = self.nats[question, (len(self.chosen) if poses is None else poses) - 1]
        by_first, by_second = (chance(float(n), lacks) for n, lacks in zip(nats, one.lacks, strict=True))
        return by_first if one.is_presence else one.first * by_first + (1.0 - one.first) * by_second


def chance(nats: float, lacks: float) -> float:
    """Probability that samples of an expected evidence bring what is lacking; both in nats."""
    return float(ndtr((nats - lacks) / np.sqrt(max(2.0 * nats, 1e-12))))


class Side:
    """One question under one of its answers.

    Args:
        difference: of the predictions in standard deviations, n poses of s equations, (n, s).
        J: derivatives of the model that is wrong, (n, s, p); P: covariance of its parameters, (p, p).
    """

    def __init__(self, difference: Array, J: Array, P: Array) -> None:
        self.difference, self.J, self.P = difference, J, P
        self.gained = 0.0

    def expected(self) -> Array:
        """Evidence of each pose on top of what is chosen, (n,), nats."""
        S = self.J @ self.P @ self.J.transpose(0, 2, 1) + np.eye(self.J.shape[1])
        return np.asarray(0.5 * np.einsum("ni,ni->n", self.difference, np.linalg.solve(S, self.difference[..., None])[..., 0]))

    def measure(self, pose: int) -> None:
        """Count a pose as measured."""
        J, r = self.J[pose], self.difference[pose]
        S = J @ self.P @ J.T + np.eye(len(J))
        K = np.linalg.solve(S, J @ self.P).T
        self.gained += 0.5 * float(r @ np.linalg.solve(S, r))
        self.difference = self.difference - self.J @ (K @ r)
        self.P = self.P - K @ J @ self.P


def choose(questions: Sequence[Question], imagined: Session, n: int, ratio: float = 1.0) -> Told:
    """Choose poses that answer questions, one by one.

    Args:
        imagined: poses to choose from, row by row, all with the same load cases in the same order.
        n: number of poses.
        ratio: of the noise of a sample to what the session states.
    """
    observation = observe(imagined)
    sides = [_sides(question, observation, ratio) for question in questions]
    chosen: list[int] = []
    nats = np.zeros((len(questions), n, 2))
    scale = SETTINGS.nats_to_name
    for k in range(n):
        use = np.zeros(len(imagined.poses))
        for question, pair in zip(questions, sides, strict=True):
            asked = pair[:1] if question.is_presence else pair
            have, with_it = (np.min(x, axis=0) for x in ([s.gained for s in asked], [s.gained + s.expected() for s in asked]))
            use += np.exp(-have / scale) - np.exp(-with_it / scale)  # what is told already needs no more
        use[chosen] = -np.inf
        best = int(np.argmax(use))
        chosen.append(best)
        for q, pair in enumerate(sides):
            for side in pair:
                side.measure(best)
            nats[q, k] = [side.gained for side in pair]
    return Told(tuple(questions), np.array(chosen), nats)


def _sides(question: Question, observation: Observation, ratio: float) -> tuple[Side, Side]:
    poses = len(observation.poses)
    one, other = models_of(question)
    moved = observation.whiten(one.seen(observation) - other.seen(observation)).reshape(poses, -1) / ratio
    J_one, J_other = (m.columns(observation).reshape(poses, moved.shape[1], -1) / ratio for m in (one, other))
    return Side(moved, J_other, other.covariance), Side(-moved, J_one, one.covariance)


def models_of(question: Question) -> tuple[Freed, Freed]:
    """Both models of a question, each free in its own effect."""
    one, other = question.one, question.other
    return Freed(one, in_question(question.names[0], one.terms)), Freed(other, in_question(question.names[1], other.terms))
