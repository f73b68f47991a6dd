# SPDX-License-Identifier: Apache-2.0
"""`irec filter`: from recordings of courses to the table that the correction reads."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_correction.filters import low_pass
from irec_correction.fir import Fir, read_taps
from scipy import signal

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
from case_parts.bag import write_bag

RATE, LATE = 250.0, 0.028  # Hz; s, from a reading to the motion, without the low-pass
NOISE = 1.5  # N


def unsteady(seed: int, n: int) -> np.ndarray:
    sos = signal.butter(2, 5.0, fs=RATE, output="sos")
    return 40.0 * signal.sosfilt(sos, np.random.default_rng(seed).standard_normal((n, 3)), axis=0)


def write_course(path: Path, seed: int, pressed: float = 600.0, seconds: float = 16.0) -> Path:
    """A course whose TCP is moved by 1e-6 m/N against the filtered force of a while ago; 1 s without contact at either end."""
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    contact = ((t > 1.0) & (t < seconds - 1.0)).astype(float)
    force = (unsteady(seed, n) + np.array([0.0, 0.0, pressed])) * contact[:, None]
    read = force + np.random.default_rng(seed + 50).normal(0.0, NOISE, force.shape)
    smooth = signal.sosfilt(signal.butter(2, 40.0, fs=RATE, output="sos"), read, axis=0)
    moved = np.stack([np.interp(t - LATE, t, x) for x in smooth.T], axis=1)
    p = np.array([0.1, 0.0, 0.0]) * t[:, None] - 1e-6 * moved
    return write_bag(path, read, p, np.tile(np.eye(3), (n, 1, 1)))


def test_the_table_is_a_filter_that_misses_less_than_the_low_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = [write_course(tmp_path / f"course_{i}.mcap", i) for i in range(3)]
    table = tmp_path / "filter.csv"
    assert main(["filter", *map(str, bags), "--acceleration", "5", "-o", str(table), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["lead_s"] == pytest.approx(LATE, abs=0.003)
    assert told["noise_n"] == pytest.approx(NOISE, rel=0.15)
    assert told["acceleration_m_s2"] <= 5.0 / 3.0
    f, late = unsteady(99, 5000), round(LATE * RATE)
    missed = []
    for stage in (Fir(read_taps(table).taps[0], RATE), low_pass(40.0, 2, RATE)):
        out = np.array([stage.step(np.r_[x, x])[:3] for x in f])
        missed.append(float(np.sqrt(((f[late:] - out[: len(f) - late])[300:] ** 2).mean())))
    assert missed[0] < 0.8 * missed[1]
    assert main(["filter", str(bags[0]), "--lead", "0.02", "-o", str(table)]) == 0
    assert f"filter.file: {table}" in capsys.readouterr().out


def test_recordings_and_options_that_tell_no_filter_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = str(write_course(tmp_path / "course.mcap", 1))
    short = str(write_course(tmp_path / "short.mcap", 1, seconds=7.0))
    table = tmp_path / "filter.csv"
    for given, word in (
        ([short], "in contact for 5"),
        ([bag, "--lead", "0.5"], "--lead is 0.5"),
        ([bag, "--cutoff", "200"], "--cutoff is 200"),
        ([bag, "--taps", "1000"], "2 to 250"),
        ([bag, "--acceleration", "0"], "--acceleration is 0"),
        ([bag, "--acceleration", "0.001", "--compliance", "0.001"], "allow more"),
        ([bag, "--wrench", "nothing"], "0 messages on 'nothing'"),
    ):
        assert main(["filter", *given, "-o", str(table)]) == 2
        assert word in capsys.readouterr().err
    assert not table.exists()
