# SPDX-License-Identifier: Apache-2.0
"""Latency from a recording of force and motion, and modes of the structure from a swept force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.latency import find_latency
from irec_calibration.sensors.structure import find_structure
from scipy import signal

RATE = 250.0


def coloured(rng: np.random.Generator, n: int, highest: float) -> np.ndarray:
    return signal.sosfiltfilt(signal.butter(2, highest, fs=RATE, output="sos"), rng.standard_normal((n, 3)), axis=0)


@settings(max_examples=8, deadline=None)
@given(delay=st.floats(0.005, 0.1), seed=st.integers(0, 1000))
def test_latency_is_found_whatever_the_compliance(delay: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(5000) / RATE
    force = 30.0 * coloured(rng, len(t), 8.0)
    C = 1e-6 * (np.eye(3) + 0.3 * rng.standard_normal((3, 3)))
    late = np.stack([np.interp(t - delay, t, force[:, k]) for k in range(3)], axis=1)
    way = np.array([0.1, 0.02, 0.0]) * t[:, None]
    motion = way - late @ C.T + 1e-6 * rng.standard_normal(force.shape)
    found = find_latency(t, force + 1.0 * rng.standard_normal(force.shape), t, motion)
    assert abs(found.delay - delay) < 2e-3


def test_no_latency_is_told_where_the_robot_does_not_follow_the_force() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(5000) / RATE
    with pytest.raises(RecordingError, match="with the correction in force"):
        find_latency(t, coloured(rng, len(t), 8.0), t, 1e-5 * coloured(rng, len(t), 8.0))


def responding(force: np.ndarray, modes: list[tuple[float, float, np.ndarray]]) -> np.ndarray:
    out = 2e-7 * force
    for hertz, zeta, shape in modes:
        w = 2.0 * np.pi * hertz
        system = signal.cont2discrete(([w * w], [1.0, 2.0 * zeta * w, w * w]), 1.0 / RATE, method="foh")
        answer = signal.lfilter(np.ravel(system[0]), system[1], force @ shape)
        out = out + answer[:, None] * shape
    return out


def test_modes_are_found_from_a_swept_force() -> None:
    t = np.arange(int(30.0 * RATE)) / RATE
    u = (t % 10.0) / 10.0
    force = np.zeros((len(t), 3))
    force[np.arange(len(t)), np.minimum((t / 10.0).astype(int), 2)] = 100.0 * np.sin(20.0 * np.pi * (3.0 * u + 16.0 * u * u))
    true = [(9.1, 0.05, 1e-3 * np.array([1.0, 0.1, 0.2])), (12.3, 0.04, 1e-3 * np.array([0.0, 0.8, -0.3]))]
    noise = 3e-6 * np.random.default_rng(2).standard_normal(force.shape)
    found = find_structure(force, responding(force, true) + noise, RATE)
    for hertz, zeta, _ in true:
        nearest = min(found.modes, key=lambda m: abs(m.frequency - hertz))
        assert nearest.frequency == pytest.approx(hertz, rel=0.02)
        assert nearest.damping == pytest.approx(zeta, rel=0.25)


def test_no_modes_are_told_where_the_force_does_not_explain_the_motion() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(RecordingError, match="tap harder"):
        find_structure(rng.standard_normal((5000, 3)), 1e-5 * rng.standard_normal((5000, 3)), RATE)
