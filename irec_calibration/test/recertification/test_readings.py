# SPDX-License-Identifier: Apache-2.0
"""What the instruments read before anything moves: each thing that is wrong is told with what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.recertification.readings import MANNED, Readings, enough_readings, judged_readings

GOOD = Readings(
    force_in_tool=np.full((200, 3), 2.0),
    p_marker_in_station=np.ones((100, 3)),
    q=np.zeros((100, 6)),
    t_marker=np.linspace(0.0, 3.0, 100),
    stations=["A"] * 100,
    temperature={"gear_2": 30.0},
    mode="position",
    moving=False,
)

NOISE = {"tracker_m": 22e-6}  # stated, m
BEFORE = replace(synthetic.session(4), temperature={"gear_2": np.full(24, 35.0)})


def problems(readings: Readings, confirmed: tuple[str, ...] = MANNED) -> dict[str, str]:
    return {p.name: p.text for p in judged_readings(readings, 2500.0, ["A"], confirmed, BEFORE, NOISE) if not p.holds}


def test_a_robot_that_stands_ready_has_no_problem() -> None:
    assert problems(GOOD) == {}


@pytest.mark.parametrize(
    ("wrong", "name", "text"),
    [
        ({"mode": ""}, "robot", "silent"),
        ({"mode": "force"}, "robot", "force control"),
        ({"mode": "fault"}, "robot", "fault"),
        ({"moving": True}, "robot", "moves"),
        ({"q": np.linspace(0, 1, 600).reshape(100, 6)}, "robot", "moves"),
        ({"force_in_tool": np.zeros((3, 3))}, "force sensor", "silent"),
        ({"force_in_tool": np.full((200, 3), np.nan)}, "force sensor", "no number"),
        ({"force_in_tool": np.full((200, 3), 80.0)}, "force sensor", "80.0 N in free air (limit 50 N); free the tool"),
        ({"p_marker_in_station": np.full((100, 3), np.nan)}, "tracker", "line of sight"),
        ({"p_marker_in_station": np.zeros((0, 3)), "t_marker": np.zeros(0), "stations": []}, "tracker", "line of sight"),
        ({"stations": ["A"] * 99 + ["B"]}, "tracker", "'B'"),
        ({"p_marker_in_station": np.linspace(0, 2e-3, 300).reshape(100, 3)}, "tracker", "warm up"),
        ({"temperature": {"gear_2": 15.0}}, "temperature", "gear_2 is 15 degC"),
    ],
)
def test_what_is_wrong_is_told_with_its_value(wrong: dict[str, object], name: str, text: str) -> None:
    found = problems(replace(GOOD, **wrong))  # type: ignore[arg-type]
    assert list(found) == [name]
    assert text in found[name]


def test_thermometers_that_are_not_heard_are_told_though_they_keep_nobody() -> None:
    told = {p.name: p for p in judged_readings(replace(GOOD, temperature={}), 2500.0, ["A"], MANNED, BEFORE, NOISE)}
    assert told["temperature"].holds and "no thermometer is heard now" in told["temperature"].text
    told = {p.name: p for p in judged_readings(GOOD, 2500.0, ["A"], MANNED, None, NOISE)}
    assert told["temperature"].holds and "none was logged with the calibration" in told["temperature"].text


@pytest.mark.parametrize("name", MANNED)
def test_what_only_a_person_can_see_has_to_be_confirmed(name: str) -> None:
    found = problems(GOOD, tuple(n for n in MANNED if n != name))
    assert list(found) == [name] and f"confirm '{name}'" in found[name]


def standing(rng: np.random.Generator, noise: float, n: int, seconds: float, rate: float = 0.0, air: float = 0.0) -> Readings:
    """Readings of a tracker: white noise, m; number; time, s; drift along x, m/s; slow noise, m."""
    t = np.sort(rng.uniform(0.0, seconds, n))
    p = noise * rng.standard_normal((n, 3))
    for k in range(3 if air else 0):
        keep = np.exp(-np.diff(t, prepend=-100.0) / 10.0)
        steps = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
        p[:, k] += air * lfilter_varying(keep, steps)
    p[:, 0] += rate * t
    return replace(GOOD, p_marker_in_station=p, t_marker=t, stations=["A"] * n)


def lfilter_varying(keep: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """x_i = keep_i x_(i-1) + steps_i."""
    out, x = np.empty_like(steps), 0.0
    for i, (k, s) in enumerate(zip(keep.tolist(), steps.tolist(), strict=True)):
        out[i] = x = k * x + s
    return out


@pytest.mark.parametrize(
    ("noise", "air", "n", "seconds"),
    [(10e-6, 20e-6, 300, 6.0), (20e-6, 40e-6, 300, 6.0), (10e-6, 20e-6, 300, 30.0), (45e-6, 0.0, 60, 6.0), (22e-6, 0.0, 30, 3.0)],
    ids=["air", "twice the data sheet", "long look", "slow tracker", "few readings"],
)
def test_an_ordinary_tracker_is_not_refused(noise: float, air: float, n: int, seconds: float) -> None:
    rng = np.random.default_rng(4)
    refused = [problems(standing(rng, noise, n, seconds, air=air)) for _ in range(700)]
    assert sum(bool(p) for p in refused) == 0  # of 3500 in all five


def test_a_tracker_that_drifts_just_within_the_limit_is_not_refused() -> None:
    rng = np.random.default_rng(5)
    assert not any(problems(standing(rng, 10e-6, 300, 30.0, rate=2.0e-6, air=20e-6)) for _ in range(500))


@pytest.mark.parametrize(("seconds", "rate"), [(3.0, 150e-6), (6.0, 80e-6), (30.0, 20e-6)])
def test_a_tracker_that_drifts_is_refused(seconds: float, rate: float) -> None:
    rng = np.random.default_rng(6)
    refused = [problems(standing(rng, 10e-6, 300, seconds, rate=rate, air=20e-6)) for _ in range(300)]
    assert sum(bool(p) for p in refused) >= 297
    assert all("let the tracker warm up" in p["tracker"] for p in refused if p)


@pytest.mark.parametrize("rate", [30e-6, 100e-6])
def test_a_drift_that_is_not_plain_yet_is_looked_at_for_longer(rate: float) -> None:
    rng = np.random.default_rng(7)
    first = [enough_readings(standing(rng, 10e-6, 300, 6.0, rate=rate, air=20e-6), NOISE) for _ in range(100)]
    assert sum(first) <= 10
    still = [enough_readings(standing(rng, 10e-6, 300, 6.0, air=20e-6), NOISE) for _ in range(100)]
    assert sum(still) >= 98


def test_a_tracker_so_noisy_that_no_drift_would_show_is_refused_with_the_reason() -> None:
    assert "scatter" in problems(standing(np.random.default_rng(7), 2e-3, 300, 6.0))["tracker"]


def test_two_stations_that_see_the_marker_at_once_are_no_drift() -> None:
    r = standing(np.random.default_rng(8), 1e-5, 200, 6.0)
    p = r.p_marker_in_station + np.arange(200)[:, None] % 2
    both = replace(r, p_marker_in_station=p, stations=["A", "B"] * 100)
    assert all(c.holds for c in judged_readings(both, 2500.0, ["A", "B"], MANNED, None, NOISE))


def test_one_reading_that_is_far_off_is_no_drift_and_no_movement() -> None:
    r = standing(np.random.default_rng(9), 1e-5, 200, 6.0)
    r.p_marker_in_station[199] += 5e-3
    q = np.zeros((100, 6))
    q[99] = 0.5
    assert problems(replace(r, q=q)) == {}
