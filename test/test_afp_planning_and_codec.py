# SPDX-License-Identifier: Apache-2.0
"""The paper's findings on the simulated AFP cell: COVER and IOOPS on the mould (Fig. 3), CODECs (Figs. 7, 9, 10)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.codec.growth import SATURATED
from irec_calibration.poses import plan as plan_module
from irec_calibration.poses.blocks import observation_blocks
from irec_calibration.poses.plan import make_plan
from irec_calibration.poses.pool import generate_pool

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent


@pytest.fixture(scope="module")
def cell():
    return read_cell(ROOT / "config" / "cells" / "afp.yaml")


@pytest.fixture(scope="module")
def plans(cell):
    """Plans of 31 poses by each method from one pool of 3000."""
    pool = generate_pool(cell, 3000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "generate_pool", lambda *_: pool)
        found = {method: make_plan(cell, 31, method=method) for method in ("cover", "ioops", "d_optimal", "i_optimal", "random")}
        found["stopped"] = make_plan(cell, 100, method="cover", d_max=0.175)
    return found


@pytest.fixture(scope="module")
def codec(tmp_path_factory):
    """`irec codec` on a session of the simulator, by the comparison; label -> figures."""
    folder = tmp_path_factory.mktemp("codec")
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    command = [BIN / "irec-sim", "session", "--cell", "afp", "--poses", "31", "--seed", "1", "-o", folder / "session"]
    subprocess.run(command, check=True, timeout=120, stdout=subprocess.DEVNULL, env=environment)

    @cache
    def run(comparison):
        command = [BIN / "irec", "codec", folder / "session", "--compare", comparison, "--json", "-o", folder / comparison]
        done = subprocess.run(command, check=True, timeout=120, capture_output=True, text=True, env=environment)
        return {figures["label"]: figures for figures in json.loads(done.stdout)["codecs"]}

    return run


def test_cover_at_175_mm_from_3000_candidates_stops_near_the_31_poses_of_the_paper(plans):
    assert 27 <= len(plans["stopped"].chosen) <= 36
    assert plans["stopped"].figures["cover_distance_m"] <= 0.175


def test_ioops_clusters_at_the_edges_and_cover_does_not(plans):
    cover, ioops = plans["cover"].figures, plans["ioops"].figures
    assert ioops["nearest_neighbour_ratio"] < 1.0 < 1.7 < cover["nearest_neighbour_ratio"]
    assert ioops["edge_share"] > 0.5 and ioops["edge_share"] > cover["edge_share"]
    assert ioops["cover_distance_m"] > 2 * cover["cover_distance_m"]


def test_each_method_is_the_best_by_its_own_measure(plans):
    figures = {method: plan.figures for method, plan in plans.items() if method != "stopped"}
    best_o1 = max(figures, key=lambda m: figures[m]["o1"])
    assert best_o1 in ("ioops", "d_optimal")  # the same criterion but for the noise of the shared reference
    assert min(figures, key=lambda m: figures[m]["cover_distance_m"]) == "cover"
    assert min(figures, key=lambda m: figures[m]["predicted_uncertainty_rms_m"]) == "i_optimal"


def test_the_uncertainty_that_a_plan_predicts_is_what_repeated_measurements_scatter(cell, plans):
    """Monte Carlo: identify from the planned poses with tracker noise, predict the deflection elsewhere on the surface."""
    plan = plans["cover"]
    rng = np.random.default_rng(0)
    where = rng.choice(len(plan.pool), size=40, replace=False)
    measured = cell.robot.kinematics(plan.pool.q[plan.chosen])
    asked = cell.robot.kinematics(plan.pool.q[where])
    A = observation_blocks(measured, cell.forces_in_tool, cell.marker_in_tool)
    B = observation_blocks(asked, cell.forces_in_tool, np.zeros(3))
    n, M = A.shape[:2]
    station = np.array([s.p_in_cell for s in cell.stations])[plan.pool.station[plan.chosen]]
    distance = np.linalg.norm(plan.pool.p_in_cell[plan.chosen] - station, axis=1)
    sigma = np.sqrt(
        cell.noise["tracker_m"] ** 2 + cell.noise["settling_m"] ** 2 + (cell.noise["tracker_m_per_m"] * distance) ** 2
    )
    readings = rng.normal(size=(600, n, M + 1, 3)) * sigma[:, None, None]
    noise = (readings[:, :, 1:] - readings[:, :, :1]).reshape(600, -1)
    # rows of one pose share a reference: generalised least squares
    shared = np.linalg.inv(np.linalg.cholesky(np.eye(M) + 1.0))
    weight = np.kron(np.diag(1 / sigma), np.kron(shared, np.eye(3)))
    rows = A.reshape(-1, A.shape[3])
    norm = np.linalg.norm(rows, axis=0)
    norm[norm < 1e-9 * norm.max()] = np.inf  # an axis through the TCP bears no torque
    fits = np.linalg.pinv(weight @ (rows / norm), rcond=1e-9) @ (weight @ noise.T)
    scatter = np.sqrt(np.mean(np.sum(((B / norm) @ fits) ** 2, axis=2), axis=2))
    np.testing.assert_allclose(scatter.max(axis=1), plan.uncertainty[where], rtol=0.15)


def beyond_noise(figures, which):
    """What an error has beside the noise of the readings that it is judged by, which no model can explain, m."""
    return np.sqrt(max(figures[f"{which}_m"] ** 2 - figures[f"floor_{which}_m"] ** 2, 0.0))


@pytest.mark.parametrize("which", ["mean", "max"])
def test_18_degrees_of_freedom_beat_6_on_unseen_poses_as_in_fig_9(codec, which):
    figures = codec("model")
    six, eighteen = figures["6 DOF"], figures["18 DOF"]
    assert beyond_noise(eighteen, which) < 0.8 * beyond_noise(six, which)
    # from five poses on, not only at the end
    assert (np.array(eighteen["mean_curve_m"][4:]) < np.array(six["mean_curve_m"][4:])).all()


def test_five_load_cases_beat_the_normal_one_on_unseen_poses_as_in_fig_10(codec):
    figures = codec("load-cases")
    normal, every = figures["normal only"], figures["all load cases"]
    assert every["mean_m"] < 0.5 * normal["mean_m"] and every["max_m"] < 0.5 * normal["max_m"]
    # from the second pose on
    assert (np.array(every["mean_curve_m"][1:]) < np.array(normal["mean_curve_m"][1:])).all()


def test_cover_and_ioops_end_alike_and_from_the_saturation_of_one_on_are_equally_good(codec):
    """Fig. 7 claims a slight lead for COVER; on this cell there is none that could be claimed, either way.

    The number of poses at saturation varies by several poses from session to session, by noise alone: what can be claimed of one
    session is the error there, within the share by which saturation is defined.
    """
    figures = codec("pose-search")
    cover, ioops = figures["cover"], figures["ioops"]
    assert cover["mean_m"] == pytest.approx(ioops["mean_m"], rel=1e-6)  # the largest training sets are the same
    first = min(cover["saturated_at"], ioops["saturated_at"])
    assert first < len(cover["mean_curve_m"])
    np.testing.assert_allclose(cover["mean_curve_m"][first - 1 :], ioops["mean_curve_m"][first - 1 :], rtol=SATURATED)


def test_the_full_model_comes_down_to_the_noise_floor(codec):
    eighteen = codec("model")["18 DOF"]
    assert eighteen["mean_m"] == pytest.approx(eighteen["floor_mean_m"], rel=0.25)
    assert eighteen["enough"]
