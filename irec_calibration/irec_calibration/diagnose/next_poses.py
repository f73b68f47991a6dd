# SPDX-License-Identifier: Apache-2.0
"""What to measure next: samples at measured poses or near them that tell rival explanations apart.

A sample counts for what it tells once both models are refitted (`telling`): where the rival would only make up for it, it tells
nothing, however far the models are apart there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects.of_session import marker_by_controller
from ..identification.observe import Observation, observe
from ..session.data import Session
from ..typing import Array
from .questions import Question
from .result import Measurement
from .settings import SETTINGS
from .telling import models_of

MOST_ROWS = 900  # of a session that are tried; evenly chosen poses of a larger one


def next_measurements(session: Session, question: Question, ratio: float = 1.0) -> tuple[Measurement, ...]:
    """Rank measured and new poses times load cases by what they tell; best first.

    Args:
        ratio: of the noise of a sample to what the session states.

    Raises:
        SolveError: no row of the session can be used.
    """
    every = max(1, -(-len(session) // MOST_ROWS))
    session = session.select_poses(session.poses[::every].tolist())
    models = models_of(question)
    needed = max(0.5 * SETTINGS.proposed.sigmas_to_tell**2, question.lacks[0])
    pool: list[tuple[Session, bool]] = [(session, False)]
    rng = np.random.default_rng(0)
    pool += [(_moved(session, rng), True) for _ in range(SETTINGS.proposed.new_poses)]
    found: list[Measurement] = []
    for rows_of, new in pool:
        observation = _each_by_itself(observe(rows_of), ratio)
        difference = models[0].seen(observation) - models[1].seen(observation)
        r = observation.whiten(difference)
        told = []
        for model in (models[1],) if question.is_presence else (models[1], models[0]):
            J = model.columns(observation).reshape(*r.shape, -1)
            told.append((r, J @ model.covariance @ J.transpose(0, 2, 1)))
        once = np.min([_nats(r, JPJ, 1) for r, JPJ in told], axis=0)
        often = np.min([_nats(r, JPJ, SETTINGS.proposed.most_repeats) for r, JPJ in told], axis=0)
        for i in np.argsort(-often)[: SETTINGS.proposed.at_most]:
            row = int(observation.rows[i])
            found.append(
                Measurement(
                    pose=0 if new else int(session.pose[row]),
                    load_case=session.case_name(int(session.load_case[row])),
                    separates=question.names if question.names[1] else (question.names[0], "the model without it"),
                    difference_m=float(np.linalg.norm(difference[i])),
                    gain=float(once[i]),
                    q=tuple(rows_of.q[row].tolist()) if new else (),
                    repeats=_repeats([(r[i], JPJ[i]) for r, JPJ in told], needed),
                )
            )
    return tuple(sorted(found, key=lambda m: (m.repeats or np.inf, -m.gain))[: SETTINGS.proposed.at_most])


def _each_by_itself(observation: Observation, ratio: float) -> Observation:
    """The same rows, each with a reference of its own: one sample is measured, not a pose."""
    whiten = observation.whiten
    sigma = ratio * np.hypot(whiten.sigma, whiten.sigma_reference)
    alone = replace(whiten, sigma=sigma, sigma_reference=np.zeros(len(sigma)), group=np.arange(len(sigma)), wander=None)
    return replace(observation, whiten=alone)


def _nats(r: Array, JPJ: Array, repeats: int) -> Array:
    """Evidence to be expected of samples that are taken so often, (..., 3) and (..., 3, 3) -> (...)."""
    S = JPJ + np.eye(3) / repeats
    return np.asarray(0.5 * np.einsum("...i,...i->...", r, np.linalg.solve(S, r[..., None])[..., 0]))


def _repeats(told: list[tuple[Array, Array]], needed: float) -> int:
    """How often a sample has to be taken to bring so much evidence; 0 where nobody would take it so often."""
    for repeats in range(1, SETTINGS.proposed.most_repeats + 1):
        if min(float(_nats(r, JPJ, repeats)) for r, JPJ in told) >= needed:
            return repeats
    return 0


def _moved(session: Session, rng: np.random.Generator) -> Session:
    """The same procedure at poses nearby, within the joint limits."""
    robot = session.robot
    lower = np.maximum(robot.lower, session.q.min(axis=0) - SETTINGS.proposed.spread_rad)
    upper = np.minimum(robot.upper, session.q.max(axis=0) + SETTINGS.proposed.spread_rad)
    q = session.q.copy()
    for pose in session.poses:
        rows = session.pose == pose
        q[rows] = np.clip(q[rows] + rng.normal(0.0, SETTINGS.proposed.spread_rad, robot.n_joints), lower, upper)
    kin = robot.kinematics(q)
    moved = replace(session, q=q, p_tcp_in_base=kin.p_tcp)
    believed = marker_by_controller(moved, kin)
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    t = np.array([s.xyz for s in session.stations])[session.station]
    seen = np.where(session.marker_seen[:, None], np.einsum("nji,nj->ni", R, believed - t), np.nan)
    return replace(moved, p_marker_in_station=seen)
