# SPDX-License-Identifier: Apache-2.0
"""A designed filter and a known force profile: they look ahead, and a constant force passes unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.look_ahead import Response, design
from irec_correction.conditioning import FilterSettings, make_filters
from irec_correction.errors import SettingsError
from irec_correction.filters import low_pass
from irec_correction.fir import Fir
from irec_correction.preview import ForceProfile, Preview, read_profile
from scipy import signal

RATE = 250.0


def force(seed: int, seconds: float = 40.0, highest: float = 6.0) -> np.ndarray:
    sos = signal.butter(2, highest, fs=RATE, output="sos")
    return 40.0 * signal.sosfilt(sos, np.random.default_rng(seed).standard_normal((int(seconds * RATE), 3)), axis=0)


def missed(stage: object, f: np.ndarray, noise: float, lead: float) -> float:
    """RMS of f(t + lead) minus what the stage gives, as a share."""
    late = round(lead * RATE)
    y = f + noise * np.random.default_rng(9).standard_normal(f.shape)
    out = np.array([stage.step(np.r_[x, x])[:3] for x in y])  # type: ignore[attr-defined]
    return float(np.sqrt(((f[late:] - out[: len(f) - late])[200:] ** 2).mean() / (f[200:] ** 2).mean()))


def test_a_designed_filter_misses_less_of_another_recording_than_the_low_pass() -> None:
    found = design(force(1), RATE, 0.028, 1.5)
    other = force(2)
    own, plain = missed(Fir(found.taps, RATE), other, 1.5, 0.028), missed(low_pass(40.0, 2, RATE), other, 1.5, 0.028)
    assert own < 0.8 * plain
    assert own == pytest.approx(found.left, rel=0.2)  # what the design foretells is what comes


def response(mode: float, delay: float) -> Response:
    """Of an arm with one mode that answers a force and an offset alike, the offset later."""
    f = np.linspace(1.0, 30.0, 300)
    H = 1.0 / (1.0 - (f / mode) ** 2 + 0.1j * f / mode)
    return Response(f, H, H * np.exp(-2j * np.pi * f * delay))


def test_measured_responses_of_arm_and_drives_are_undone_where_the_structure_answers_most() -> None:
    f = force(3, highest=12.0)
    flat, shaped = design(f, RATE, 0.03, 1.0), design(f, RATE, 0.03, 1.0, responses=[response(9.0, 0.03)])
    i = np.arange(len(flat.taps))
    rest = [abs(np.exp(2j * np.pi * 9.0 * 0.03) - np.exp(-2j * np.pi * 9.0 * i / RATE) @ d.taps) for d in (flat, shaped)]
    assert rest[1] < 0.6 * rest[0]


def test_responses_that_are_a_delay_alone_give_the_filter_of_that_delay() -> None:
    grid = np.linspace(0.5, 124.0, 2000)
    delay = Response(grid, np.ones(2000, dtype=complex), np.exp(-2j * np.pi * grid * 0.02))
    by_lead, by_response = design(force(4), RATE, 0.02, 1.0), design(force(4), RATE, 0.0, 1.0, responses=[delay])
    assert by_response.left == pytest.approx(by_lead.left, rel=0.02)


def test_a_filter_keeps_the_acceleration_that_it_was_allowed() -> None:
    free = design(force(5), RATE, 0.04, 1.5, compliance=1e-6)
    held = design(force(5), RATE, 0.04, 1.5, compliance=1e-6, acceleration=0.3 * free.acceleration)
    assert held.acceleration <= 0.3 * free.acceleration
    assert free.left <= held.left < held.before  # it costs something, and is still better than the low-pass
    with pytest.raises(RecordingError, match="acceleration"):
        design(force(5), RATE, 0.04, 1.5, compliance=1e-6, acceleration=1e-9)


@settings(max_examples=20, deadline=None)
@given(value=st.lists(st.floats(-2000.0, 2000.0), min_size=6, max_size=6), seed=st.integers(0, 50))
def test_a_constant_force_passes_unchanged(value: list[float], seed: int) -> None:
    taps = np.random.default_rng(seed).standard_normal(30) * 0.2
    taps[0] += 1.0 - taps.sum()
    stage = Fir(taps, RATE)
    for _ in range(40):
        out = stage.step(np.array(value))
    np.testing.assert_allclose(out, value, atol=1e-9 * (1.0 + np.abs(value).max()))


@pytest.mark.parametrize("taps", [[0.5], [np.nan, 1.0], [], [100.0, -99.0]])
def test_taps_that_would_change_a_constant_force_or_shake_the_robot_are_refused(taps: list[float]) -> None:
    with pytest.raises(SettingsError):
        Fir(np.array(taps), RATE)


def profile() -> ForceProfile:
    t = np.arange(1000) / RATE
    q = np.stack([0.1 * t, -0.05 * t], axis=1)
    wrench = np.zeros((1000, 6))
    wrench[:, 2] = -800.0 / (1.0 + np.exp(-(t - 1.5) / 0.05))
    return ForceProfile(q, wrench)


def test_a_force_that_was_expected_is_answered_without_delay() -> None:
    p, lead = profile(), 0.032
    filters, own = [low_pass(20.0, 2, RATE)], [low_pass(20.0, 2, RATE)]
    preview, worst = Preview(p, lead, own), 0.0
    for k in range(950):
        seen = p.wrench[k]
        for stage in filters:
            seen = stage.step(seen)
        ahead = seen + preview.step(p.q[k])
        worst = max(worst, abs(ahead[2] - p.wrench[k + round(lead * RATE), 2]))
    assert worst < 1.0


@pytest.mark.parametrize("late", [-7, 0, 9])
def test_a_touch_down_that_comes_sooner_or_later_is_followed_within_the_slack(late: int) -> None:
    p, lead = profile(), 0.032
    force = p.wrench[np.clip(np.arange(1000) - late, 0, 999)]
    worst = []
    for slack in (0.0, 0.06):
        preview, stage, off = Preview(p, lead, [low_pass(20.0, 2, RATE)], slack=slack), low_pass(20.0, 2, RATE), []
        for k in range(950):
            ahead = stage.step(force[k]) + preview.step(p.q[k], force[k])
            off.append(abs(ahead[2] - force[k + round(lead * RATE), 2]))
        worst.append(max(off))
    assert worst[1] < 0.75 * worst[0] if late else worst[1] < 1.0


def test_a_profile_is_never_moved_beyond_its_slack_nor_by_noise_where_it_is_flat() -> None:
    p, rng = profile(), np.random.default_rng(3)
    preview, moved = Preview(p, 0.032, slack=0.02), []
    for k in range(950):
        preview.step(p.q[k], p.wrench[max(k - 20, 0)] + rng.normal(0.0, 30.0, 6))
        moved.append(preview.shift)
    assert max(np.abs(moved)) <= 0.02 / 0.004 + 1e-9
    assert max(np.abs(moved[:250])) < 0.5  # before the touch-down


def test_a_slack_out_of_range_is_refused() -> None:
    with pytest.raises(SettingsError, match="slack of the force profile is 0.5 s"):
        Preview(profile(), 0.03, slack=0.5)


def test_a_robot_that_is_elsewhere_gets_nothing_added() -> None:
    preview = Preview(profile(), 0.032)
    assert not preview.step(np.array([1.0, 1.0])).any()
    assert preview.at == -1


def test_what_is_added_is_limited() -> None:
    p = profile()
    preview = Preview(p, 0.2, largest=50.0)
    added = np.array([preview.step(q) for q in p.q])
    assert np.abs(added).max() == pytest.approx(50.0)


def test_a_profile_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(SettingsError, match="force profile needs"):
        ForceProfile(np.zeros((10, 6)), np.zeros((9, 6)))


def test_a_profile_is_read_from_a_table(tmp_path) -> None:  # type: ignore[no-untyped-def]
    p, path = profile(), tmp_path / "profile.csv"
    rows = [f"{k / RATE:.4f},{a:.9f},{b:.9f},0,0,{f:.6f}" for k, ((a, b), f) in enumerate(zip(p.q, p.wrench[:, 2], strict=True))]
    path.write_text("stamp,joint_1,joint_2,force_x,force_y,force_z\n" + "\n".join(rows))
    read = read_profile(path, ["joint_1", "joint_2"])
    np.testing.assert_allclose(read.wrench, p.wrench, atol=1e-5)
    assert read.period == pytest.approx(0.004)
    with pytest.raises(SettingsError, match="joint_3"):
        read_profile(path, ["joint_1", "joint_3"])


@pytest.mark.parametrize(
    "text",
    ["", "# only a remark\n", "stamp,joint_1,force_x,force_y,force_z\n0,0,nan,0,0\n0.004,0,0,0,0\n",
     "stamp,joint_1,force_x,force_y,force_z\n0,0,0,0\n", "stamp,joint_1,force_x,force_y,force_z\n0,0,0,0,0\n0,0,0,0,0\n"],
)  # fmt: skip
def test_a_table_that_is_no_profile_is_refused_with_its_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "profile.csv"
    path.write_text(text)
    with pytest.raises(SettingsError, match=r"profile\.csv"):
        read_profile(path, ["joint_1"])


def test_a_profile_that_is_a_device_is_refused() -> None:
    with pytest.raises(SettingsError, match="a regular file is needed"):
        read_profile("/dev/zero", ["joint_1"])


def test_a_designed_filter_takes_the_place_of_the_low_pass() -> None:
    stages = make_filters(FilterSettings(cutoff=30.0, taps=(1.5, -0.5)))
    assert [s.name for s in stages] == ["designed filter"] and stages[0].delay < 0.0
