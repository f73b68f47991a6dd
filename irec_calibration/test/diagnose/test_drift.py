# SPDX-License-Identifier: Apache-2.0
"""A thermometer may go through a small part of what the drifting part does."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
from irec_calibration.diagnose import diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.session import Marker, Noise, Session
from test_diagnose import session


def drifting(m_per_kelvin: float) -> Session:
    """A session whose air temperature goes to and fro by 0.6 K, with a marker that drifts along with it."""
    still = session()
    along = np.linspace(0.0, 1.0, still.stamp.size)
    warmer = 0.3 * np.sqrt(along) * np.sin(0.9 * np.arange(still.stamp.size))
    drift = m_per_kelvin * warmer[:, None] * np.array([0.2, 1.0, 0.3])
    return replace(still, p_marker_in_station=still.p_marker_in_station + drift, temperature={"air": 20.0 + warmer})


@pytest.mark.parametrize("m_per_kelvin", [2e-4, pytest.param(3e-3, marks=pytest.mark.long)])
def test_a_drift_with_a_thermometer_is_named_whatever_it_is_per_kelvin(m_per_kelvin: float) -> None:
    verdict = diagnose(drifting(m_per_kelvin)).verdict
    assert (verdict.effects, verdict.parts["thermal_drift"].proven) == (("thermal_drift",), ("temp_air",))


@pytest.mark.long
def test_a_drift_by_more_than_robots_warm_up_is_not_named() -> None:
    verdict = diagnose(drifting(8e-3)).verdict
    assert (verdict.status, verdict.effects) == ("unexplained", ())
    assert verdict.depends_on == ("temp_air",)


@pytest.mark.parametrize(
    ("values", "is_told"),
    [
        ({"v_x": 1e-6, "T": 160.0}, True),
        ({"v_x": 1e-6, "T": 1000.0}, False),
        ({"v_x": 1e-6, "k_air_x": 1e-5, "T": 160.0}, False),  # what follows a thermometer is as quick as that
    ],
)
def test_a_drift_that_ends_within_minutes_is_no_warm_up(values: dict[str, float], is_told: bool) -> None:
    scene = scene_of(session())
    said = find_effect("thermal_drift").why_impossible({n: (v, 0.0) for n, v in values.items()}, {}, scene)
    assert ("160 s" in said) == is_told


def growing(per_kelvin: float) -> Session:
    """A session whose upper arm warms up by 15 K, to and fro by 1 K beside, and grows along its own direction."""
    still = session()
    along = np.linspace(0.0, 1.0, still.stamp.size)
    warmer = 15.0 * along + np.sin(0.9 * np.arange(still.stamp.size))
    origin = still.robot.kinematics(still.q).origin
    longer = per_kelvin * warmer[:, None] * (origin[:, 2] - origin[:, 1])
    in_station = np.einsum("nji,nj->ni", np.stack([s.R_in_base for s in still.stations])[still.station], longer)
    return replace(
        still, p_marker_in_station=still.p_marker_in_station + in_station, temperature={"upper_arm": 22.0 + warmer}
    )


def test_a_link_that_grows_with_its_temperature_is_told_from_a_stand_that_drifts() -> None:
    verdict = diagnose(growing(1.2e-4)).verdict
    assert verdict.effects == ("thermal_drift",), verdict.text
    assert verdict.parts["thermal_drift"].proven == ("temp_upper_arm of the arm",)
    assert verdict.remaining_m == 0.0


def test_links_grow_along_themselves_and_turn_what_is_beyond_them_where_they_bow() -> None:
    scene = scene_of(growing(0.0))
    effect = find_effect("thermal_drift")
    names = [p.name for p in effect.parameters(scene)]
    theta = np.array([{"k_upper_arm_link_2": 1.5e-5, "k_upper_arm_turn_2": 2e-6, "T": 1e5}.get(n, 0.0) for n in names])
    kelvin = scene.temperature["upper_arm"][:, None] - 20.0
    grown = 1.5e-5 * kelvin * (scene.kin.origin[:, 2] - scene.kin.origin[:, 1])
    turned = np.cross(2e-6 * kelvin * scene.kin.axis[:, 1], scene.p_observed - scene.kin.origin[:, 1])
    np.testing.assert_allclose(effect.displacement(scene, theta), grown + turned, atol=1e-12)


@pytest.mark.parametrize("stand", [False, True], ids=["the arm grows", "the stand moves"])
def test_an_arm_that_grows_with_time_is_told_from_a_stand_that_moves(stand: bool) -> None:
    markers = (*absolute_sessions.THREE_MARKERS[:2], Marker("G", "base_link", (0.5, 0.4, 0.1), known=False))
    rate = 1e-6  # 1/s, a growth by 0.4 mm of what is 1 m away

    def drift(s: Session, p: np.ndarray) -> np.ndarray:
        on_tool = np.array([m.link == "tool0" for m in s.markers])[s.marker][:, None]
        return rate * s.stamp[:, None] * (np.array([0.5, -0.5, 0.3]) if stand else on_tool * p)

    found = diagnose(absolute_sessions.session(poses=80, noise=Noise(tracker_m=1e-5), markers=markers, moved=drift)).verdict
    assert found.effects == ("thermal_drift",), found.text
    assert found.parts["thermal_drift"].proven == (("time",) if stand else ("time of the arm",))
    assert found.remaining_m == 0.0


def test_a_cell_that_warms_up_in_two_ways_has_a_time_constant_beside_a_shorter_one() -> None:
    still = session()
    scene = scene_of(replace(still, stamp=np.linspace(0.0, 12000.0, len(still)), temperature={}))
    stand, hall = np.array([-1.1e-3, 0.3e-3, 1.0e-3]), np.array([-1.5e-3, -0.6e-3, -3.7e-3])
    quick, slow = (-np.expm1(-scene.stamp / T)[:, None] * by for T, by in ((900.0, stand), (8000.0, hall)))
    seen = scene.change(quick + slow).ravel()
    effect = find_effect("thermal_drift")
    names = [p.name for p in effect.parameters(scene)]

    def left(own: tuple[str, ...]) -> float:
        """Share that is left at the best T."""
        out = []
        for T in (300.0, 1000.0, 3000.0, 1e5):
            columns = effect.regressor(scene, np.concatenate([np.zeros(len(names) - 2), [1.0, T]]))
            X = scene.change(columns)[:, :, [i for i, n in enumerate(names) if n[0] in own]].reshape(len(seen), -1)
            out.append(np.linalg.norm(seen - X @ np.linalg.lstsq(X, seen, rcond=None)[0]) / np.linalg.norm(seen))
        return float(min(out))

    assert left(("v",)) > 0.25, "no example"
    assert left(("v", "w")) < 0.13
