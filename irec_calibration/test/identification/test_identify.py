# SPDX-License-Identifier: Apache-2.0
"""Identification on sessions with a known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.diagnose import validated
from irec_calibration.errors import SolveError
from irec_calibration.identification.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, SIX_DOF, blank_model
from irec_calibration.session import Noise
from synthetic import COMPLIANCE, TRANSVERSE, session

QUIET = Noise(tracker_m=1e-9)


def test_a_noise_free_session_is_explained_to_the_last_nanometre():
    fit = identify(session(12, noise=QUIET, weight=False), blank_model(EIGHTEEN_DOF))
    assert fit.rms < 5e-9


def test_of_what_the_arm_sags_only_that_of_springs_which_no_process_tells_apart_is_left():
    measured = session(12, noise=QUIET)
    weightless = replace(measured, gravity_in_base=(0.0, 0.0, 0.0))
    known, unknown = (identify(s, blank_model(EIGHTEEN_DOF)).rms for s in (measured, weightless))
    assert known < 1e-8 and unknown > 100.0 * known


def test_the_spherical_wrist_leaves_combinations_that_are_named():
    fit = identify(session(31), blank_model(EIGHTEEN_DOF))
    assert 14 <= fit.rank < 18
    assert fit.combinations
    linked = {name for c in fit.combinations for name in c.weights}
    for term in fit.terms:
        for name, e in term.estimates.items():
            if f"{term.effect.id}.{name}" in linked:
                assert not e.identified and np.isnan(e.se)


def _truth() -> dict[str, float]:
    truth = {f"joint_torsion.c_{k + 1}": c for k, c in enumerate(COMPLIANCE)}
    return truth | {f"link_bending.c_{i // 2 + 1}{'ab'[i % 2]}": c for i, c in enumerate(TRANSVERSE)}


def _deviations(fit):
    """Deviation from the truth in standard errors, of parameters and of combinations that no bound holds."""
    truth = _truth()
    values = {f"{t.effect.id}.{n}": e for t in fit.terms for n, e in t.estimates.items()}
    for name, e in values.items():
        if e.se == e.se and e.value > 0.0:
            yield (e.value - truth[name]) / e.se
    for c in fit.combinations:
        if all(values[n].value > 0.0 for n in c.weights):
            yield (c.value - sum(w * truth[n] for n, w in c.weights.items())) / c.se


def test_parameters_and_combinations_are_within_their_standard_errors_of_the_truth():
    deviations = list(_deviations(identify(session(31, seed=3), blank_model(EIGHTEEN_DOF))))
    assert len(deviations) >= 10
    assert max(map(abs, deviations)) < 4.0


@pytest.mark.slow
def test_95_percent_intervals_cover_the_truth_in_90_to_99_percent_of_100_seeds():
    # six compliances, so that no bound is active and the errors are those of plain weighted least squares
    within = []
    for seed in range(100):
        fit = identify(session(15, seed=seed, transverse=np.zeros(12)), blank_model(SIX_DOF))
        within += [abs(d) < 1.96 for d in _deviations(fit)]
    assert 0.90 < np.mean(within) < 0.99


def test_held_out_error_of_the_true_model_is_the_instrument_noise():
    found = validated(session(31, seed=5), blank_model(EIGHTEEN_DOF))
    assert 0.9 < found.held_out.rms_m / found.study.observation.whiten.claimed_floor < 1.15


def test_six_compliances_leave_the_bending_unexplained():
    data = session(31, seed=5)
    six, eighteen = (identify(data, blank_model(e)) for e in (SIX_DOF, EIGHTEEN_DOF))
    assert six.rms > 2.0 * eighteen.rms


def test_compliances_are_never_negative():
    fit = identify(session(5, seed=1), blank_model(EIGHTEEN_DOF))
    assert all(e.value >= 0.0 for t in fit.terms for e in t.estimates.values())


def test_a_session_without_loaded_rows_is_refused():
    data = session(3)
    with pytest.raises(SolveError, match="no loaded row"):
        identify(data.select(data.load_case == 0), blank_model(SIX_DOF))


def test_a_fit_that_looks_for_the_marker_too_leaves_no_more_than_one_that_knows_its_place():
    known = session(20, seed=3)
    beside = np.array(known.markers[0].xyz) - [0.15, 0.02, 0.06]
    elsewhere = replace(known, markers=(replace(known.markers[0], xyz=tuple(beside)),))
    told = identify(known, blank_model(EIGHTEEN_DOF))
    found = identify(elsewhere, blank_model([*EIGHTEEN_DOF, "marker_offset"]))
    assert found.converged
    assert found.chi2 < told.chi2
