# SPDX-License-Identifier: Apache-2.0
"""Structures of the generic family that hold back a part of what has changed, as dry friction does, but in no gear: in the force
sensor, where the tool is mounted, under base_link. Without them friction in gears is named for it, with axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..effects.scene import Scene
from ..typing import Array
from .directions import Direction, scaled
from .study import Study

HELD = (0.1, 0.3, 0.6)  # of the largest change, beyond which what holds back slips


def memories(study: Study) -> Iterator[Direction]:
    """What is held back of the force and of the moment about base_link since each reference, by friction with some thresholds."""
    scene, rows = study.ready, study.observation.rows
    if scene.kind != "loaded" or scene.instruments.by_contact or scene.clock == "none" or not np.any(scene.previous >= 0):
        return
    force = scene.force_in_tool - scene.force_in_tool[scene.reference]
    in_base = np.einsum("nij,nj->ni", scene.kin.R_tool, force)
    moment = np.cross(scene.p_tcp, in_base)
    turned = np.stack([np.cross(e, scene.p_observed) for e in np.eye(3)], axis=2)
    for share in HELD:
        of_force, of_moment = (held_back(scene, x, share * np.abs(x[rows]).max(axis=0)) for x in (force, moment))
        by_sensor = scene.response.compliance[:, :, :3] * of_force[:, None, :]
        yield Direction("as if the force sensor held back a part of each change", ("load_case",), scaled(by_sensor, rows))
        in_tool = scene.kin.R_tool * of_force[:, None, :]
        yield Direction("as if friction held the tool where it is mounted", ("load_case",), scaled(in_tool, rows))
        below = turned * of_moment[:, None, :]
        yield Direction("as if friction held base_link to the ground", ("load_case",), scaled(below, rows))


def held_back(scene: Scene, x: Array, threshold: Array) -> Array:
    """Minus the part of x (n, k) that a slider with a threshold (k,) holds (stop operator), history within a pose from its
    reference on, (n, k)."""
    played = np.zeros_like(x)
    for n, rows in enumerate(scene.rows.in_turn):
        last = played[scene.previous[rows]] if n else np.zeros_like(x[rows])
        played[rows] = np.clip(last, x[rows] - threshold, x[rows] + threshold)
    return np.asarray(played - x)
