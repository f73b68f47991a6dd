# SPDX-License-Identifier: Apache-2.0
"""Poses that tell rival models apart: what they are expected to bring, and that they bring it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.diagnose.freed import Freed
from irec_calibration.diagnose.next_poses import next_measurements
from irec_calibration.diagnose.questions import Question
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.diagnose.telling import Side, Told, chance, choose
from irec_calibration.effects import find_effect
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.model import Term, total_displacement
from irec_calibration.session import Session
from irec_calibration.session.join import joined
from irec_calibration.typing import Array
from synthetic import session

POSES, EQUATIONS, PARAMETERS = 4, 6, 3


def side(seed: int) -> Side:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(PARAMETERS, PARAMETERS))
    return Side(rng.normal(size=(POSES, EQUATIONS)), rng.normal(size=(POSES, EQUATIONS, PARAMETERS)), root @ root.T)


@given(st.integers(0, 10_000))
def test_evidence_is_what_a_refit_of_the_wrong_model_leaves(seed: int) -> None:
    s = side(seed)
    left = []
    for r, J in zip(s.difference, s.J, strict=True):
        A = np.vstack([J, np.linalg.cholesky(np.linalg.inv(s.P)).T])
        b = np.concatenate([r, np.zeros(PARAMETERS)])
        x = np.linalg.lstsq(A, b, rcond=None)[0]
        left.append(0.5 * float(((b - A @ x) ** 2).sum()))
    assert s.expected() == pytest.approx(left, rel=1e-6)


@given(st.integers(0, 10_000), st.permutations(range(POSES)))
def test_poses_one_by_one_bring_what_they_bring_together(seed: int, order: list[int]) -> None:
    s = side(seed)
    r, J = s.difference.ravel(), s.J.reshape(-1, PARAMETERS)
    together = 0.5 * float(r @ np.linalg.solve(np.eye(len(r)) + J @ s.P @ J.T, r))
    for pose in order:
        s.measure(pose)
    assert s.gained == pytest.approx(together, rel=1e-6)


def test_what_the_other_model_makes_up_for_brings_nothing() -> None:
    J = np.random.default_rng(0).normal(size=(1, EQUATIONS, PARAMETERS))
    same = Side((J[0] @ np.ones(PARAMETERS))[None], J, 1e12 * np.eye(PARAMETERS))
    assert same.expected()[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("nats", "lacks", "probability"), [(0.0, 5.0, 0.0), (5.0, 5.0, 0.5), (8.0, 0.0, 0.977), (50.0, 5.0, 1.0)]
)
def test_the_chance_of_an_answer_follows_from_evidence_and_need(nats: float, lacks: float, probability: float) -> None:
    assert chance(nats, lacks) == pytest.approx(probability, abs=1e-3)


def told(lacks: tuple[float, float], first: float, names: tuple[str, str] = ("a", "b")) -> Told:
    question = Question(names, None, None, lacks, first)  # type: ignore[arg-type]
    return Told((question,), np.array([3]), np.array([[[8.0, 8.0]]]))


def test_the_chance_counts_each_answer_as_likely_as_it_is() -> None:
    assert told((0.0, 100.0), 0.75).chance(0) == pytest.approx(0.75 * chance(8.0, 0.0))


def test_that_an_effect_is_there_is_asked_as_if_it_were() -> None:
    assert told((0.0, 100.0), 0.5, ("a", "")).chance(0) == pytest.approx(chance(8.0, 0.0))


def soft_tool(scene: Scene) -> Array:
    """A tool that gives way by 4e-8 m/N across, whichever way it is pushed."""
    R, f = scene.kin.R_tool, scene.force_in_tool
    return np.asarray(np.einsum("nij,nj->ni", R, f * np.array([4e-8, 4e-8, 0.0])))


def fitted(s: Session, effect: str) -> Study:
    return prepare(s, (*default_terms(s), Term(find_effect(effect))))


@cache
def tool_or_base() -> tuple[Session, Question]:
    s = session(8, seed=3, extra=soft_tool)
    return s, Question(
        ("tool_compliance", "base_compliance"), fitted(s, "tool_compliance"), fitted(s, "base_compliance"), (5.0, 5.0)
    )


def other_poses() -> Session:
    return session(40, seed=9, extra=soft_tool)


def advantage(question: Question, s: Session) -> float:
    """Evidence that a session brings for the first of two models, each refitted with what was known before, nats."""
    whole = [fitted(s, name) for name in question.names]
    return 0.5 * float(whole[1].true_chi2 - whole[0].true_chi2)


def test_chosen_poses_tell_more_than_others() -> None:
    _, question = tool_or_base()
    found = choose([question], other_poses(), 4)
    every = [
        choose([question], other_poses().select_poses([p, p + 1, p + 2, p + 3]), 4).nats[0, -1].min() for p in range(1, 37, 4)
    ]
    assert len(set(found.chosen.tolist())) == 4
    assert found.nats[0, -1].min() > max(every)
    assert (np.diff(found.nats[0], axis=0) >= -1e-9).all()


def test_poses_bring_about_the_evidence_that_is_promised() -> None:
    s, question = tool_or_base()
    found = choose([question], other_poses(), 6)
    more = other_poses().select_poses((found.chosen + 1).tolist())
    gained = advantage(question, joined([s, more])) - advantage(question, s)
    promised = float(found.nats[0, -1, 0])
    assert abs(gained - promised) < 3.5 * np.sqrt(2.0 * promised)


def test_more_noise_promises_less() -> None:
    _, question = tool_or_base()
    quiet, loud = (choose([question], other_poses(), 3, ratio).nats[0, -1, 0] for ratio in (1.0, 3.0))
    assert loud < quiet


def test_a_proposed_sample_says_how_often_to_take_it() -> None:
    s, question = tool_or_base()
    few = next_measurements(s, question)
    assert few and all(m.separates == question.names for m in few)
    assert [m.repeats or np.inf for m in few] == sorted(m.repeats or np.inf for m in few)
    loud = next_measurements(s, question, ratio=4.0)
    assert (loud[0].repeats or np.inf) > (few[0].repeats or np.inf) or loud[0].gain < few[0].gain


def test_models_that_predict_alike_are_not_told_apart() -> None:
    s, question = tool_or_base()
    same = Question(question.names, question.one, question.one, question.lacks)
    assert all(m.repeats == 0 and m.gain == pytest.approx(0.0, abs=1e-9) for m in next_measurements(s, same))


def test_what_a_model_predicts_is_what_its_terms_move() -> None:
    _, question = tool_or_base()
    study = question.one
    moved = study.observation.of(total_displacement(study.terms, study.observation.scene))
    assert np.allclose(Freed(study, {"tool_compliance"}).seen(study.observation), moved)
