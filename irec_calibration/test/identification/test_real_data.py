# SPDX-License-Identifier: Apache-2.0
"""Measurements of real robots by others, where they are at hand: IREC_REAL_DATA, or ../shared/data beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from irec_calibration.diagnose import compare, improve, validated
from irec_calibration.errors import SessionError
from irec_calibration.identification.absolute import base_terms, near_pairs
from irec_calibration.identification.identify import fit, identify
from irec_calibration.identification.observe import observe
from irec_calibration.model import blank_model
from irec_calibration.sensors.joint_recording import read_recordings
from irec_calibration.sensors.joint_stiffness import joint_stiffness
from irec_calibration.session.align import align_bag
from irec_calibration.session.foreign import import_table

ROOT = Path(__file__).resolve().parents[3]
PROFILES = ROOT / "docs" / "real-data"
DATA = Path(os.environ.get("IREC_REAL_DATA", ROOT.parent / "shared" / "data"))


def data(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not there; set IREC_REAL_DATA to the folder with measured data")
    return DATA / name


def held_out_mm(session, terms) -> float:
    return 1e3 * validated(session, terms).held_out.mean_m


def test_ur5_geometry_takes_most_joint_compliance_a_little_and_transverse_terms_are_not_warranted(tmp_path):
    table = data("jacobi_ur5_wam_lasertracker") / "UR5" / "3D_UR5_uncalibrated_grid_cleaned.csv"
    session = import_table(PROFILES / "ur5-jacobi.profile.yaml", table, tmp_path)
    placed, geometric, torsion, bending = (
        held_out_mm(session, terms)
        for terms in (
            blank_model(["station_pose", "marker_position"]),
            base_terms(),
            [*base_terms(), *blank_model(["joint_torsion"])],
            [*base_terms(), *blank_model(["joint_torsion", "link_bending"])],
        )
    )
    assert 0.55 < placed < 0.75
    assert 0.09 < geometric < 0.115
    assert 0.85 < torsion / geometric < 0.98
    assert bending > 0.97 * torsion


@pytest.mark.long
@pytest.mark.slow
def test_ur10_stays_unexplained_and_its_residual_repeats_with_the_pose(tmp_path):
    table = data("ipa_ur10_lasertracker") / "Series_A" / "measurements_grid.csv"
    session = import_table(PROFILES / "ur10-ipa-a.profile.yaml", table, tmp_path)
    assert any("sorted by stamp" in n for n in session.notes)
    whole = observe(session)
    geometric = fit(base_terms(), whole)
    pairs = near_pairs(whole, geometric.residual)
    assert pairs.repeats and len(pairs.first) > 300 and pairs.difference_m < 0.06e-3
    everything = [
        *base_terms(),
        *blank_model(["joint_torsion", "encoder_harmonics", "joint_hysteresis", "joint_settling", "thermal_drift"]),
    ]
    assert 0.38 < held_out_mm(session, base_terms()) < 0.42
    assert 0.34 < held_out_mm(session, everything) < 0.39


def test_wam_is_far_from_explained_by_geometry(tmp_path):
    table = data("jacobi_ur5_wam_lasertracker") / "WAM" / "3D_WAM_uncalibrated_grid_cleaned.csv"
    session = import_table(PROFILES / "wam-jacobi.profile.yaml", table, tmp_path)
    found = identify(session, base_terms())
    assert 1.9 < held_out_mm(session, base_terms()) < 2.6
    assert found.rms > 1.7 * found.observation.whiten.floor


@pytest.mark.slow
def test_wam_is_improved_by_the_side_a_joint_came_from_and_by_torsion(tmp_path):
    table = data("jacobi_ur5_wam_lasertracker") / "WAM" / "3D_WAM_uncalibrated_grid_cleaned.csv"
    told = improve(import_table(PROFILES / "wam-jacobi.profile.yaml", table, tmp_path))
    assert [r.added for r in told.rungs[1:4]] == ["joint_hysteresis", "joint_torsion", "external_force"]
    # gears give way in every arm; what predicts besides has no name
    assert [r.named for r in told.rungs[1:]] == [True, True, *[False] * (len(told.rungs) - 3)]
    assert told.rungs[2].cv_rms_m < 0.87 * told.rungs[0].cv_rms_m
    assert all(b.cv_rms_m < a.cv_rms_m for a, b in zip(told.rungs, told.rungs[1:]))
    assert "structure" in told.stopped  # geometry, lag and springs are not all
    other = table.with_name("3D_WAM_uncalibrated_random_cleaned.csv")  # poses that no fit has seen
    random = import_table(PROFILES / "wam-jacobi.profile.yaml", other, tmp_path / "random")
    errors = [compare(random, r.model.terms).rms_m for r in told.rungs]
    assert all(b < a for a, b in zip(errors, errors[1:])), errors


@pytest.mark.long
def test_what_the_ur10_has_left_repeats_many_times_per_turn_of_its_joints(tmp_path):
    table = data("ipa_ur10_lasertracker") / "Series_D" / "measurements_iso_cubes.csv"
    told = improve(import_table(PROFILES / "ur10-ipa-d.profile.yaml", table, tmp_path))
    ripple = next(r for r in told.rungs if r.added == "joint_ripple")
    assert not ripple.named
    assert ripple.cv_rms_m < 0.5 * told.rungs[told.rungs.index(ripple) - 1].cv_rms_m
    assert "times per turn of axis 2" in told.before.verdict.text


def test_kr300_skew_is_the_same_on_all_axes_and_only_axis_3_tells_a_stiffness():
    r = joint_stiffness(read_recordings(data("kuka_kr300_secondary_encoders"), PROFILES / "kr300.profile.yaml"))
    assert r.silent == (4, 5, 6)
    assert r.common_skew_s.value == pytest.approx(2.9e-3, abs=0.15e-3) and r.same_skew_p > 0.05
    assert [a.identified for a in r.axes] == [False, False, True]
    assert r.axes[2].stiffness_low > 5e6 and r.axes[2].stiffness_high < 20e6


def test_a_foreign_bag_is_aligned_by_its_stamps_and_its_skew_found():
    bag = data("akig_ur5_tracker_bag") / "rotateBaseBFspeed1Pts10hzLAN_ros2_mcap"
    session, delay = align_bag(bag, PROFILES / "ur5-akig.profile.yaml")
    assert len(session) > 180 and session.kind == "absolute"
    assert delay.bursts_s > 0.1  # points were stamped on arrival, three at a time
    assert delay.value_s == pytest.approx(-0.1545, abs=0.005)
    assert delay.rms_after_m < 1e-3 < 0.05 < delay.rms_before_m


@pytest.mark.parametrize(("line", "named"), [("delay: soon", "delay is 'soon'"), ("marker: {scale: big}", "scale is 'big'")])
def test_a_profile_of_a_recording_with_a_word_for_a_number_is_refused(tmp_path, line, named):
    bag = data("akig_ur5_tracker_bag") / "rotateBaseBFspeed1Pts10hzLAN_ros2_mcap"
    text = (PROFILES / "ur5-akig.profile.yaml").read_text().replace("../../config", str(PROFILES.parents[1] / "config"))
    profile = tmp_path / "profile.yaml"
    profile.write_text(text.replace("marker: {topic: /tracker_points}\n", "") + line + "\n")
    with pytest.raises(SessionError, match=named):
        align_bag(bag, profile)
