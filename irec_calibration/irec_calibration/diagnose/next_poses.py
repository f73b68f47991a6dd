# SPDX-License-Identifier: Apache-2.0
"""What to measure next: samples in which rival explanations predict different displacements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects.of_session import marker_by_controller, scene_of
from ..effects.scene import Scene
from ..identification.noise import InferredNoise, position_sigma
from ..model import Term, total_displacement
from ..session.data import Session
from ..typing import BoolArray
from .result import Measurement
from .settings import SETTINGS


def next_measurements(session: Session, a: Sequence[Term], b: Sequence[Term], names: tuple[str, str]) -> tuple[Measurement, ...]:
    """Rank measured and new poses times load cases by how differently two fitted models predict them; best first.

    Args:
        a, b: the terms of the two models with values.
        names: what they are called.
    """
    pool: list[tuple[Session, bool]] = [(session, False)]
    rng = np.random.default_rng(0)
    pool += [(_moved(session, rng), True) for _ in range(SETTINGS.proposed.new_poses)]
    found: list[Measurement] = []
    for rows_of, new in pool:
        scene = scene_of(rows_of)
        difference = scene.change(total_displacement(a, scene) - total_displacement(b, scene))
        size = np.linalg.norm(difference, axis=1)
        sigma = np.sqrt(3.0) * position_sigma(rows_of) * (np.sqrt(2.0) if session.kind == "loaded" else 1.0)
        seen = _usable(scene, session) & np.isfinite(size)
        for i in np.flatnonzero(seen)[np.argsort(-(size / sigma)[seen])][: SETTINGS.proposed.at_most]:
            found.append(
                Measurement(
                    pose=0 if new else int(session.pose[i]),
                    load_case=session.case_name(int(session.load_case[i])),
                    separates=names,
                    difference_m=float(size[i]),
                    gain=0.5 * float((size[i] / sigma[i]) ** 2),
                    q=tuple(rows_of.q[i].tolist()) if new else (),
                )
            )
    return tuple(sorted(found, key=lambda m: -m.gain)[: SETTINGS.proposed.at_most])


def repeats_to_tell(m: Measurement, noise: InferredNoise | None) -> int:
    """How often a sample has to be taken to tell two explanations apart; 0 where nobody would take it so often.

    Args:
        noise: what the session shows; that which it states where None.
    """
    ratio = noise.ratio if noise is not None and noise.differs else 1.0
    gain = m.gain / max(ratio, 1e-9) ** 2
    repeats = max(1, int(np.ceil(0.5 * SETTINGS.proposed.sigmas_to_tell**2 / max(gain, 1e-9))))
    return repeats if repeats <= SETTINGS.proposed.most_repeats else 0


def _usable(scene: Scene, session: Session) -> BoolArray:
    return (scene.load_case != 0) if session.kind == "loaded" else session.marker_seen


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
    return replace(moved, p_marker_in_station=np.einsum("nji,nj->ni", R, believed - t))
