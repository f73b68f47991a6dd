# SPDX-License-Identifier: Apache-2.0
"""What the simulated instruments do to a session, and what goes wrong in single rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_sim.cellfile import read_cell
from irec_sim.hidden import draw_absolute_session
from irec_sim.matrix import clean_cases
from irec_sim.mishaps import KINDS
from irec_sim.noise import TrueNoise, claimed_over_true, draw_claim, marker_noise
from irec_sim.session import Conduct, generate
from irec_sim.truth import make_truth

AFP = read_cell("afp")
QUIET = TrueNoise(10e-6, 0.0, 0.0, 1.0)


def test_noise_of_the_marker_is_the_linear_sum_that_the_header_states():
    made = generate(AFP, make_truth("afp", [], 1), 40, seed=0)
    error = made.passes[0].marker - made.rows[0].p_marker
    noise = AFP.noise
    sigma = np.hypot(noise["tracker_m"] + noise["tracker_m_per_m"] * made.rows[0].distance, noise["settling_m"])
    assert (error / sigma[..., None]).std() == pytest.approx(1.0, abs=0.08)
    force = made.passes[0].force - made.rows[0].force_reading
    assert force.std() == pytest.approx(noise["force_n"], rel=0.1)


@pytest.mark.parametrize("tail", ["normal", "student", "contaminated"])
@pytest.mark.parametrize("slow_share", [0.0, 0.7])
def test_tails_and_slow_wandering_leave_the_standard_deviation_as_it_is(tail, slow_share):
    noise = replace(QUIET, tail=tail, dof=6.0, slow_share=slow_share)
    n = 20000
    error = marker_noise(noise, 30.0 * np.arange(n), np.zeros(n, int), np.full(n, 4.0), np.random.default_rng(0))
    assert error.std() == pytest.approx(10e-6, rel=0.05)


def test_heavy_tails_are_heavier_than_normal():
    n = 20000
    size = {}
    for tail in ("normal", "student", "contaminated"):
        noise = replace(QUIET, tail=tail)
        error = marker_noise(noise, np.arange(n) * 1.0, np.zeros(n, int), np.full(n, 4.0), np.random.default_rng(0))
        size[tail] = (np.abs(error) > 40e-6).mean()
    assert size["student"] > 10 * size["normal"] and size["contaminated"] > 10 * size["normal"]


def test_slow_noise_is_alike_within_seconds_and_forgotten_after_minutes_and_apart_per_station():
    noise = replace(QUIET, slow_share=1.0, slow_time=60.0)
    n = 20000
    station = np.arange(n) % 2
    error = marker_noise(noise, np.repeat(np.arange(n // 2) * 6.0, 2), station, np.full(n, 4.0), np.random.default_rng(0))
    a, b = error[::2, 0], error[1::2, 0]
    assert np.corrcoef(a[:-1], a[1:])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.05)
    assert abs(np.corrcoef(a[:-60], a[60:])[0, 1]) < 0.1 and abs(np.corrcoef(a, b)[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("way", "low", "high"), [("factor", 0.5, 2.0), ("settling_left_out", 0.3, 0.99), ("root_sum", 0.6, 0.99)]
)
def test_a_wrong_claim_is_wrong_within_a_factor_of_two(way, low, high):
    noise = TrueNoise(10e-6, 3e-6, 3e-6, 1.0)
    for seed in range(10):
        factor = claimed_over_true(draw_claim(noise, way, np.random.default_rng(seed)), noise, np.array([3.0, 5.0]))
        assert low - 1e-3 <= factor <= high + 1e-3 and abs(np.log(factor)) > 0.02
    assert claimed_over_true(draw_claim(noise, "right", np.random.default_rng(0)), noise, np.array([4.0])) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mishap_spoils_the_rows_that_the_truth_says_and_no_others(kind):
    truth = make_truth("afp", [], 1)
    plain = generate(AFP, truth, 6, seed=3, conduct=Conduct(random_order=True))
    spoiled = generate(AFP, truth, 6, seed=3, conduct=Conduct(random_order=True, mishap=kind))
    (mishap,) = spoiled.mishaps
    a, b = plain.passes[0], spoiled.passes[0]
    moved = [(x != y).reshape(6, 6, -1).any(axis=2) for x, y in ((a.marker, b.marker), (a.q, b.q), (a.force, b.force))]
    changed = np.any(moved, axis=0)
    if kind == "reseated_reflector":  # stays where it is put: later poses see it at their reference too
        changed[np.arange(6) > np.flatnonzero(a.pose == mishap.pose)[0]] = False
    i = int(np.flatnonzero(a.pose == mishap.pose)[0])
    assert list(np.flatnonzero(changed.any(axis=1))) == [i]
    if kind == "bumped_reference":
        assert list(np.flatnonzero(changed[i])) == [0] and set(mishap.load_cases) == set(range(1, 6))
    else:
        assert {int(c) for c in a.case[i][changed[i]]} == set(mishap.load_cases)


def test_clean_sessions_hide_nothing_whatever_the_noise():
    cases = clean_cases(np.random.default_rng(0), 12)
    assert [c.kind for c in cases] == 12 * ["clean"] + 12 * ["absolute"]
    assert {c.slow for c in cases} == {False, True}
    assert {c.claim == "right" for c in cases} == {False, True}
    assert not any(draw_absolute_session(c, i, 20, 3).made.truth.hidden for i, c in enumerate(cases[12:16]))
