# SPDX-License-Identifier: Apache-2.0
"""In an absolute session a station that is bumped turns, and one that drifts leans: what is far from it moves further."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from absolute_sessions import THREE_MARKERS, session, torsion
from irec_calibration.diagnose import diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.session import Noise, Session
from irec_calibration.typing import Array
from scipy.spatial.transform import Rotation
from synthetic import session as loaded_session

TURN = np.array([2e-4, -1e-4, 3e-4])  # rad, about x, y, z of base_link


def by_values(effect_id: str, scene: Scene, values: dict[str, float]) -> Array:
    effect = find_effect(effect_id)
    theta = np.array([values.get(p.name, p.start if p.grid else 0.0) for p in effect.parameters(scene)])
    return effect.displacement(scene, theta)


def turned(scene: Scene) -> Array:
    """What a turn of the station by TURN moves each reading by, as rotations have it, (n, 3), m."""
    lever = scene.noise_free_from_station()
    return np.asarray(Rotation.from_rotvec(TURN).apply(lever) - lever)


def test_a_station_that_was_bumped_turns_what_it_sees_from_then_on() -> None:
    scene = scene_of(session(poses=12, markers=THREE_MARKERS))
    middle = float(np.median(scene.stamp))
    moved = by_values("station_shift", scene, {f"r_{a}": v for a, v in zip("xyz", TURN, strict=True)} | {"t_shift": middle})
    late = (scene.stamp > middle)[:, None]
    assert np.abs(turned(scene)).max() > 1e-4, "no example"
    np.testing.assert_allclose(moved, turned(scene) * late, atol=1e-6)


@pytest.mark.parametrize("rounds", [1, 2])
def test_a_station_is_bumped_where_three_poses_and_more_were_seen_before_and_after(rounds: int) -> None:
    """What the first pose alone shows was called a bump of another simulator's station, which nobody had touched."""
    once = session(poses=12, markers=THREE_MARKERS)
    drawn = replace(once, pose=(once.pose - 1) % (12 // rounds) + 1, repeat=(once.pose - 1) // (12 // rounds))
    scene = scene_of(drawn)
    shift = next(p for p in find_effect("station_shift").parameters(scene) if p.name == "t_shift")
    visits = np.unique(scene.stamp)
    assert len(visits) == 12, "one reading each"
    assert min(shift.grid) == pytest.approx(visits[2:4].mean()) and max(shift.grid) == pytest.approx(visits[-4:-2].mean())


def test_a_stand_that_leans_turns_what_is_seen_in_proportion_to_time() -> None:
    scene = scene_of(session(poses=12, markers=THREE_MARKERS))
    rate = TURN / scene.stamp.max()
    moved = by_values("thermal_drift", scene, {f"v_lean_{a}": v for a, v in zip("xyz", rate, strict=True)} | {"T": 1e9})
    np.testing.assert_allclose(moved, turned(scene) * (scene.stamp / scene.stamp.max())[:, None], atol=1e-6)


def test_a_loaded_session_whose_readings_are_differences_knows_no_turn() -> None:
    scene = scene_of(loaded_session(poses=6))
    names = {p.name for e in ("station_shift", "thermal_drift") for p in find_effect(e).parameters(scene)}
    assert "d_x" in names and not any(n.startswith("r_") or "lean" in n for n in names)


@pytest.mark.slow
def test_a_bump_that_turns_the_station_is_named_with_that() -> None:
    bends = torsion(np.array([2e-6, 3e-6, 4e-6, 1e-5, 1e-5, 2e-5]))

    def moved(s: Session, p: Array) -> Array:
        late = (s.stamp > 0.5 * s.stamp.max())[:, None]
        return np.asarray(bends(s, p) + late * np.cross(TURN, p - s.stations[0].xyz))

    found = session(poses=45, seed=0, noise=Noise(tracker_m=1.2e-5), markers=THREE_MARKERS, moved=moved)
    verdict = diagnose(replace(found, stamp=9.0 * found.stamp)).verdict
    assert set(verdict.effects) == {"joint_torsion", "station_shift"}
    assert verdict.parts["station_shift"].proven == ("tilt",)
