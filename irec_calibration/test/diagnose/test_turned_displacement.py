# SPDX-License-Identifier: Apache-2.0
"""Sessions in which the measured displacement is turned or scaled, or has what the tool's rotation moves a marker by that sits
elsewhere, and what is read at the references has nothing of it: as the catalogue has `station_registration`, `tracker_scale` and
`marker_offset`, and as a station does that was placed by these readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose, start_terms
from irec_calibration.diagnose.candidates import try_effect
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.session import Session
from irec_calibration.typing import Array
from scipy.spatial.transform import Rotation
from test_expected_error import springs


def with_displacement(by: Array) -> Session:
    """A session whose displacements in base_link are multiplied by a matrix."""
    made = synthetic.session(31, 4)
    reference = scene_of(made).reference
    start = made.p_marker_in_station[np.where(reference >= 0, reference, np.arange(len(made)))]
    R_station = made.stations[0].R_in_base
    p = start + (made.p_marker_in_station - start) @ (R_station.T @ by @ R_station).T
    return replace(made, p_marker_in_station=p)


def turned(w: Array, stations: int = 1) -> Session:
    """A session whose displacements are turned by a rotation vector in base_link, rad, by whichever station they are seen."""
    made = with_displacement(Rotation.from_rotvec(w).as_matrix())
    several = tuple(replace(made.stations[0], name=name) for name in "ABC"[:stations])
    return replace(made, stations=several, station=made.pose % stations)


def test_a_turn_of_all_displacements_is_named_though_no_reading_has_it() -> None:
    verdict = diagnose(turned(np.array([0.03, -0.02, 0.0]))).verdict
    assert verdict.effects == ("station_registration",), verdict.text


def test_about_the_first_axis_no_geometry_error_is_named_for_it() -> None:
    verdict = diagnose(turned(np.array([0.0, 0.0, 0.04]))).verdict
    assert "geometry_error" not in verdict.effects, verdict.text
    assert "station_registration" in (*verdict.effects, *(i for of in verdict.one_of for i in of))


def test_a_scale_of_all_displacements_is_named_though_no_reading_has_it() -> None:
    verdict = diagnose(with_displacement(1.05 * np.eye(3))).verdict
    assert verdict.effects == ("tracker_scale",), verdict.text


def test_a_marker_elsewhere_is_named_where_displacements_alone_have_it() -> None:
    made = synthetic.session(31, 4, approach=0.0)
    scene = scene_of(made)
    turned = np.zeros((len(made), 3))
    for axis, c, origin in springs(scene.kin, synthetic.TRANSVERSE):
        turned += c * np.einsum("ni,ni->n", axis, np.cross(scene.p_tcp - origin, scene.force))[:, None] * axis
    moved = np.cross(turned, scene.kin.R_tool @ np.array([0.1, 0.0, 0.1]))
    session = replace(made, p_marker_in_station=made.p_marker_in_station + moved @ made.stations[0].R_in_base)
    verdict = diagnose(session).verdict
    assert verdict.effects == ("marker_offset",), verdict.text


def test_a_small_turn_is_not_named_against_all_readings() -> None:
    verdict = diagnose(turned(np.array([3e-3, -2e-3, 0.0]))).verdict
    assert verdict.effects == (), verdict.text


@pytest.mark.parametrize("stations", [2, 3])
def test_stations_that_are_turned_alike_are_turned_together(stations: int) -> None:
    session = turned(np.array([0.03, -0.02, 0.01]), stations)
    trial = try_effect(prepare(session, start_terms(session)), find_effect("station_registration"))
    assert trial is not None
    assert trial.best.groups == ("all stations",)


@pytest.mark.parametrize(("common", "is_usual"), [(0.0, True), (3e-4, True), (3e-3, False)])
def test_a_turn_of_all_stations_is_as_usual_as_one_of_each(common: float, is_usual: bool) -> None:
    values = {"w_x": common, "w_y": common, "w_z": 0.0, "w_x_A": -common, "w_y_A": -common, "w_z_A": 0.0}
    scene = scene_of(turned(np.zeros(3), 2))  # B has what all have in common
    assert find_effect("station_registration").is_usual(values, 0.0, scene) == is_usual


def test_one_station_has_no_turn_beside_its_own() -> None:
    groups = {p.group for p in find_effect("station_registration").parameters(scene_of(turned(np.zeros(3))))}
    assert groups == {"station A"}
