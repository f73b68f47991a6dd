# SPDX-License-Identifier: Apache-2.0
"""CODEC: Algorithm 1 gives what a fresh bounded solve at each step gives, and says when there are enough poses."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_calibration.codec import RIDGE, pose_data, run_codec, split_sizes
from irec_calibration.codec.growth import growth_of, growth_so_far
from irec_calibration.errors import PlanError, SolveError
from irec_calibration.identification.absolute import base_terms
from irec_calibration.identification.identify import fit, observe_with_force_noise
from irec_calibration.identification.system import linearise
from irec_calibration.model import EIGHTEEN_DOF, SIX_DOF, blank_model
from irec_calibration.poses.select import METHODS, cover
from irec_calibration.session import Noise, write_table
from scipy.optimize import nnls
from synthetic import COMPLIANCE, session

EIGHTEEN, SIX = blank_model(EIGHTEEN_DOF), blank_model(SIX_DOF)


@pytest.fixture(scope="module")
def recording():
    return session(16)


@pytest.fixture(scope="module")
def data(recording):
    return pose_data(recording, EIGHTEEN)


@pytest.fixture(scope="module")
def codec(data):
    return run_codec(data)


def test_its_numbers_are_those_of_a_fresh_bounded_solve_of_the_stacked_system_at_each_step(recording, data, codec):
    observation = observe_with_force_noise(recording, EIGHTEEN)
    system = linearise(fit(EIGHTEEN, observation).terms, observation)
    for i in (0, 5, 15):
        held = np.isin(data.poses, codec.verification[i])
        for j in range(codec.norm_mean.shape[1]):
            rows = np.isin(system.pose, codec.training[i, : j + 1])
            A, b = system.A[rows], system.b[rows]
            ridge = np.sqrt(RIDGE * np.sum(A**2, axis=0).max()) * np.eye(A.shape[1])
            x, _ = nnls(np.vstack([A, ridge]), np.append(b, np.zeros(len(ridge))))  # compliances: bounded by 0 below
            residual = np.abs(data.y[held] - data.A[held] @ x).reshape(-1, 3)
            np.testing.assert_allclose(codec.E_mean[i, j], residual.mean(axis=0), rtol=1e-6)
            np.testing.assert_allclose(codec.E_max[i, j], residual.max(axis=0), rtol=1e-6)
            np.testing.assert_allclose(codec.C[i, j] / system.scale, x, rtol=1e-6, atol=1e-6 * np.abs(x).max())


def test_verification_poses_are_covers_that_begin_at_another_pose_each_and_training_sets_are_the_rest(data, codec):
    n_c, n_v = split_sizes(16)
    assert (n_c, n_v) == (11, 5)
    assert codec.verification.shape == (16, 5) and codec.training.shape == (16, 11)
    assert len(set(codec.verification[:, 0])) == 16
    for held, trained in zip(codec.verification, codec.training, strict=True):
        assert set(held) | set(trained) == set(data.poses)
        first = int(np.flatnonzero(data.poses == held[0])[0])
        np.testing.assert_array_equal(held, data.poses[cover(data.points, 5, first=np.array([first]))])
        pool = np.flatnonzero(np.isin(data.poses, trained))
        np.testing.assert_array_equal(trained, data.poses[pool[cover(data.points[pool], 11)]])


@pytest.mark.parametrize(("poses", "sizes"), [(31, (22, 9)), (15, (11, 4)), (10, (7, 3)), (4, (3, 1))])
def test_the_split_is_70_to_30_in_whole_poses(poses, sizes):
    assert split_sizes(poses) == sizes


@pytest.mark.parametrize("method", METHODS)
def test_every_pose_search_ends_with_the_same_full_training_sets(data, codec, method):
    other = run_codec(data, method=method, combinations=3)
    assert other.norm_mean.shape == (3, 11)
    np.testing.assert_allclose(other.norm_mean[:, -1], codec.norm_mean[:3, -1], rtol=1e-9)


def test_arrays_have_the_shapes_of_algorithm_1(codec):
    assert codec.E_mean.shape == codec.E_max.shape == (16, 11, 3)
    assert codec.C_a.shape == (16, 11, 6) and codec.C_v.shape == (16, 11, 12)
    assert (codec.E_max >= codec.E_mean).all() and (codec.norm_max >= codec.norm_mean).all()


def test_compliances_approach_the_truth_where_they_are_known(codec):
    np.testing.assert_allclose(codec.C_a[:, -1, 1:3].mean(axis=0), COMPLIANCE[1:3], rtol=0.1)


def test_a_perfect_model_comes_down_to_the_noise_floor_and_not_below():
    codec = run_codec(pose_data(session(31, seed=3), EIGHTEEN))
    assert codec.norm_mean[:, -1].mean() == pytest.approx(codec.floor_mean, rel=0.12)
    assert codec.norm_max[:, -1].mean() == pytest.approx(codec.floor_max, rel=0.15)


def test_without_noise_a_perfect_model_predicts_exactly():
    quiet = Noise(tracker_m=0.0, tracker_m_per_m=0.0, force_n=0.0, settling_m=0.0)
    codec = run_codec(pose_data(session(12, noise=quiet), EIGHTEEN))
    assert codec.norm_max[:, -1].max() < 1e-7  # the ridge leaves nanometres


def test_training_on_one_load_case_verifies_on_all(recording, codec):
    only_normal = run_codec(pose_data(recording, EIGHTEEN, train_cases=[1]))
    np.testing.assert_array_equal(only_normal.verification, codec.verification)
    assert only_normal.norm_mean[:, -1].mean() > 1.2 * codec.norm_mean[:, -1].mean()


def test_a_load_case_that_was_not_measured_is_refused(recording):
    with pytest.raises(SolveError, match=r"no observed row has load case \[7\]"):
        pose_data(recording, EIGHTEEN, train_cases=[7])


def test_rows_without_a_marker_are_left_out(recording, codec):
    p = recording.p_marker_in_station.copy()
    unseen = (recording.pose == 3) & (recording.load_case == 2)
    p[unseen] = np.nan
    partial = pose_data(replace(recording, p_marker_in_station=p), EIGHTEEN)
    assert partial.seen.sum() == 16 * 5 - 1
    assert np.isfinite(run_codec(partial).E_mean).all()


def test_poses_are_spread_on_the_tooling_whatever_the_rail_position(recording):
    rail = 0.1 * recording.pose.astype(float)
    from irec_calibration.session.data import ExternalAxis

    on_rail = replace(recording, ext={"rail": rail}, ext_axes=(ExternalAxis("rail", "prismatic", (0.0, 1.0, 0.0)),))
    shift = pose_data(on_rail, SIX).points - pose_data(recording, SIX).points
    np.testing.assert_allclose(shift, np.outer(0.1 * np.arange(1, 17), [0, 1, 0]), atol=1e-12)


@pytest.mark.parametrize(("poses", "said"), [(3, "3 poses are too few to split 70/30"), (2, "2 poses are too few")])
def test_too_few_poses_for_the_split_are_refused_with_the_counts(poses, said):
    with pytest.raises(PlanError, match=said):
        run_codec(pose_data(session(poses), SIX))


def test_more_combinations_than_poses_are_refused(data):
    with pytest.raises(PlanError, match="17 combinations were asked for; .* 1 to 16 are possible"):
        run_codec(data, combinations=17)


def chart(codec, curve, scatter=0.0, poses=None):
    rng = np.random.default_rng(0)
    n_cv, n_c = codec.norm_mean.shape[0], len(curve)
    values = np.asarray(curve) * np.exp(scatter * rng.normal(size=(n_cv, n_c)))
    return replace(codec, norm_mean=values, norm_max=3 * values, poses=poses or codec.poses)


def test_a_flat_chart_means_enough_poses(codec):
    growth = growth_of(chart(codec, np.sqrt(1.0 + 0.05 / np.arange(1, 23)), scatter=0.005, poses=31))
    assert growth.enough and growth.saturated
    assert growth.saturated_at < 5
    assert "enough: after 31 poses the next one is expected to gain 0.0 %" in str(growth)


def test_a_chart_that_still_falls_means_not_enough(codec):
    growth = growth_of(chart(codec, 1.0 / np.arange(1, 12) ** 0.5, poses=16))
    assert not growth.enough and not growth.saturated
    assert growth.next_gain == pytest.approx(1 - np.sqrt(16 / 17), rel=1e-6)
    assert "not enough: pose 17 is expected to gain 3.0 %" in str(growth)


def test_scatter_between_combinations_widens_the_uncertainty(codec):
    curve = np.sqrt(1.0 + 2.0 / np.arange(1, 23))
    calm, rough = (growth_of(chart(codec, curve, scatter=s)) for s in (0.005, 0.1))
    assert np.ptp(rough.next_gain_interval) > 3 * np.ptp(calm.next_gain_interval)


def test_growth_can_be_followed_while_poses_come_in():
    whole = session(24, seed=2)
    gains = []
    for n in (6, 12, 24):
        codec, growth = growth_so_far(whole.select_poses(np.arange(1, n + 1)), EIGHTEEN)
        assert codec.poses == growth.poses == n
        gains.append(growth.next_gain_interval[1])
    assert gains[2] < gains[0]


def test_growth_is_not_judged_from_four_poses():
    with pytest.raises(PlanError, match="4 are needed: measure more poses"):
        growth_so_far(session(4), SIX)


def absolute_session(poses=30):
    """A plain tracker calibration of the synthetic robot: joint zeros off by up to 1 mrad, the station placed roughly."""
    rng = np.random.default_rng(0)
    blank = session(poses)
    first = blank.select(blank.load_case == 0)
    true = first.robot.kinematics(first.q + np.array([0.0, 4e-4, -1e-3, 7e-4, -5e-4, 0.0]))
    station = replace(first.stations[0], known=False)
    p_marker = true.p_tcp + true.R_tool @ np.array(first.markers[0].xyz) - np.array(station.xyz) + np.array([1e-3, -2e-3, 1e-3])
    p_marker = p_marker @ station.R_in_base + 1e-5 * rng.normal(size=p_marker.shape)
    none = np.zeros_like(p_marker)
    return replace(first, kind="absolute", stations=(station,), p_marker_in_station=p_marker, force_in_tool=none)


def test_an_absolute_session_has_its_chart_too():
    codec = run_codec(pose_data(absolute_session(), base_terms()))
    assert codec.poses == 30 and codec.norm_mean.shape == (30, 21)
    assert codec.norm_mean[:, -1].mean() == pytest.approx(codec.floor_mean, rel=0.35)
    assert codec.norm_mean[:, 4].mean() > 2 * codec.norm_mean[:, -1].mean()


def run(tmp_path, *arguments):
    write_table(session(16), tmp_path / "session")
    return main(["codec", str(tmp_path / "session"), "-o", str(tmp_path / "out"), *arguments])


def test_irec_codec_writes_chart_arrays_and_table(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="extra 'report' is not installed")
    assert run(tmp_path) == 0
    assert "error on unseen poses with 11 training poses" in capsys.readouterr().out
    arrays = np.load(tmp_path / "out" / "codec.npz")
    assert arrays["E_mu"].shape == arrays["E_m"].shape == (16, 11, 3)
    assert arrays["C_a"].shape == (16, 11, 6) and arrays["C_v"].shape == (16, 11, 12)
    with (tmp_path / "out" / "codec.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 16 * 11
    assert float(rows[12]["mean_y_m"]) == pytest.approx(arrays["E_mu"][1, 1, 1], rel=1e-6)
    assert (tmp_path / "out" / "codec.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("comparison", "labels"),
    [
        ("pose-search", ["cover", "ioops"]),
        ("model", ["18 DOF", "6 DOF"]),
        ("load-cases", ["all load cases", "1 only"]),
    ],
)
def test_each_comparison_of_the_paper_is_one_option(tmp_path, capsys, comparison, labels):
    assert run(tmp_path, "--compare", comparison, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert [figures["label"] for figures in printed["codecs"]] == labels
    assert len(list((tmp_path / "out").glob("*.npz"))) == 2


def test_any_two_models_can_be_compared(tmp_path, capsys):
    models = ["--model", "joint_torsion,tool_compliance", "--model", "18"]
    assert run(tmp_path, "--compare", "model", "--json", *models) == 0
    labels = [figures["label"] for figures in json.loads(capsys.readouterr().out)["codecs"]]
    assert labels == ["18 DOF", "joint_torsion,tool_compliance"]


def test_too_few_poses_end_with_exit_code_2(tmp_path, capsys):
    write_table(session(3), tmp_path / "session")
    assert main(["codec", str(tmp_path / "session"), "-o", str(tmp_path / "out")]) == 2
    assert "3 poses are too few" in capsys.readouterr().err
