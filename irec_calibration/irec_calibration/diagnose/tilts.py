# SPDX-License-Identifier: Apache-2.0
"""Structures of the generic family that tilt what carries the arm: its links and bearings across their axes, base_link on the
ground. Without them a bearing that is worn, or a foot that lifts, is named for a gear or for a base that merely gives way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..typing import Array
from .directions import TAKEN_UP, Direction, scaled, under_load, waves
from .study import Study

LEAST = 1e-6  # N m; a moment that is smaller is rounding
AZIMUTHS = np.deg2rad([0.0, 45.0, 90.0, 135.0])  # of the axes in the xy plane of base_link about which the ground may give way


def tilts(study: Study) -> Iterator[Direction]:
    """A link that tilts across its axis by any curve of the moment about that direction, or by the moment and the angle of the
    axis: what a worn bearing does, and one that is softer over a part of its turn."""
    scene, rows = study.ready, study.observation.rows
    on = under_load(scene)
    across, moment = scaled(scene.V, rows), scene.load_torque_virtual()
    whole = moment + (scene.gravity.tau_virtual if scene.kind == "loaded" else 0.0)
    several = len(np.unique(scene.load_case[rows])) > 1
    for i in range(moment.shape[1]):
        largest = float(np.abs(moment[rows, i]).max())
        if largest <= LEAST:
            continue
        k, t = i // 2, moment[:, i] / largest
        own, tau = across[:, :, i : i + 1], f"tau_{k + 1}"
        names = ("load_case", tau) if several else (tau, f"joint_{k + 1}")
        shape = np.stack([t**2, t * np.abs(t), t**3, np.tanh(5.0 * t)], axis=1)
        words = f"tilting the link of axis {k + 1} across it, by its moment"
        yield Direction(words, names, own * on * shape[:, None, :], is_tilt=True)
        words = f"tilting the link of axis {k + 1} across it, by its whole moment, gravity included"
        yield Direction(words, names, own * _over(whole[:, i], whole[rows, i])[:, None, :], is_tilt=True)
        # in an absolute session springs may be missing yet, and it would stand for them
        if scene.kind == "loaded" and not scene.kin.is_prismatic[k]:
            turn = waves(scene.q[:, k], 2)
            words = f"tilting the link of axis {k + 1} across it, by its moment and over its turn"
            yield Direction(words, (f"joint_{k + 1}", "load_case"), own * on * (t[:, None] * turn)[:, None, :], is_tilt=True)


def on_the_ground(study: Study) -> Iterator[Direction]:
    """Base_link that tilts by any curve of the moment about some axes in its plane, gravity included, as a base does whose bolts
    are not all tight; in a loaded session, as under the weight alone much else passes for it."""
    scene, rows = study.ready, study.observation.rows
    if scene.kind != "loaded":
        return
    moment = scene.load_wrench_at_base()[1] + scene.gravity.wrench_at_base[1]
    for azimuth in AZIMUTHS:
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        about = moment @ axis
        if np.ptp(about[rows]) <= LEAST:
            continue
        tilted = scaled(np.cross(axis, scene.p_observed)[:, :, None], rows)
        words = f"tilting base_link on the ground, about its axis at {np.rad2deg(azimuth):.0f} degrees"
        yield Direction(words, ("load_case", "joint_1"), tilted * _over(about, about[rows])[:, None, :])


def _over(moment: Array, seen: Array) -> Array:
    """Curves over the whole moment about a direction, (n, 5)."""
    w = moment / max(float(np.abs(seen).max()), 1e-9)
    return np.column_stack([*(np.tanh(w / share) for share in TAKEN_UP), w**2, w**3])
