# SPDX-License-Identifier: Apache-2.0
"""Joint stiffness from two encoders: the skew is found first, and a compliance that can't be told is not told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_calibration.errors import SessionError, SolveError
from irec_calibration.sensors.joint_recording import read_recordings
from irec_calibration.sensors.joint_stiffness import Trajectory, joint_stiffness

STEP, SKEW, STIFFNESS = 0.004, 0.003, 5e6


def trajectory(seed: int, compliance: float = 1.0 / STIFFNESS, noise: float = 1e-6, axes: int = 2) -> Trajectory:
    """Gravity-like torque, motor inertia and friction; the link encoder lags and has an eccentric disc."""
    rng = np.random.default_rng(seed)
    t = np.arange(2500) * STEP
    f, phase = rng.uniform(0.1, 0.4, (3, axes)), rng.uniform(0, 6, (3, axes))

    def q(at: np.ndarray) -> np.ndarray:
        return sum(0.3 * np.sin(2 * np.pi * f[i] * at[:, None] + phase[i]) for i in range(3))

    v, a = (q(t + 1e-4) - q(t - 1e-4)) / 2e-4, (q(t + 1e-3) - 2 * q(t) + q(t - 1e-3)) / 1e-6
    gear_torque = 3000 * np.cos(q(t)) * np.sin(2.0 * q(t) + 0.5) + 1500 * np.sin(0.9 * t)[:, None]
    motor = q(t) + compliance * gear_torque
    late = q(t - SKEW) + 2e-5 * np.sin(q(t))
    torque = gear_torque + 600 * a + 300 * np.tanh(v / 0.005)
    return Trajectory(f"t{seed}", STEP, motor, late + rng.normal(size=late.shape) * noise, torque)


def test_skew_and_stiffness_are_recovered():
    r = joint_stiffness([trajectory(s) for s in range(3)])
    for axis in r.axes:
        assert axis.skew_s.value == pytest.approx(SKEW, abs=1e-4)
        assert axis.identified
        assert axis.stiffness_low < STIFFNESS < axis.stiffness_high
    assert r.common_skew_s.value == pytest.approx(SKEW, abs=1e-4)


def test_a_stiff_joint_with_a_skew_alone_is_not_called_elastic():
    r = joint_stiffness([trajectory(s, compliance=0.0, noise=3e-5) for s in range(3)])
    assert not any(a.identified for a in r.axes)
    assert all("no value different from zero" in a.why_not or "disagree" in a.why_not for a in r.axes)
    assert all(a.skew_s.value == pytest.approx(SKEW, abs=1e-4) for a in r.axes)


def test_trajectories_that_contradict_each_other_do_not_tell_a_stiffness():
    r = joint_stiffness([trajectory(0), trajectory(1, compliance=-1.0 / STIFFNESS), trajectory(2, compliance=0.0)])
    assert not any(a.identified for a in r.axes)


def test_axes_without_a_link_encoder_are_named():
    recordings = [trajectory(s, axes=3) for s in range(3)]
    silent = [replace(t, link=np.where(np.arange(3) == 1, 0.0, t.link)) for t in recordings]
    r = joint_stiffness(silent)
    assert r.silent == (2,) and [a.number for a in r.axes] == [1, 3]


def test_nothing_to_compare_is_an_error():
    t = trajectory(0)
    with pytest.raises(SolveError, match="no axis has a link encoder"):
        joint_stiffness([replace(t, link=np.zeros_like(t.link))])


def test_one_recording_is_cut_into_parts_and_that_is_said():
    r = joint_stiffness([trajectory(0)])
    assert len(r.units) == 6 and "one recording only" in r.notes[0]


def table(path, t: Trajectory) -> None:
    k = t.motor.shape[1]
    names = ["time", *(f"{c}_{a + 1}" for c in ("motor", "link", "torque") for a in range(k))]
    values = np.column_stack([np.arange(len(t.motor)) * t.step, t.motor, t.link, t.torque])
    path.write_text(",".join(names) + "\n" + "\n".join(",".join(repr(float(v)) for v in row) for row in values))


def test_tables_are_read_and_the_command_answers(tmp_path, capsys):
    for s in range(3):
        table(tmp_path / f"{s}.csv", trajectory(s))
    assert main(["joint-stiffness", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "axis 1: stiffness" in out and "timing skew 3.0" in out


def test_matlab_files_are_read_by_a_profile(tmp_path):
    from scipy.io import savemat

    t = trajectory(0)
    rec = {
        "time": np.arange(len(t.motor)) * STEP,
        "m": np.rad2deg(t.motor.T),
        "l": np.rad2deg(t.link.T),
        "tq": t.torque.T / 250.0,
    }
    savemat(tmp_path / "a.mat", {"rec": rec})
    (tmp_path / "p.yaml").write_text(
        "format: irec-joints/1\ntime: {field: rec.time}\nmotor: {field: rec.m, unit: deg}\nlink: {field: rec.l, unit: deg}\n"
        "torque: {field: rec.tq, gear: [250, 250]}\n"
    )
    (read,) = read_recordings(tmp_path / "a.mat", tmp_path / "p.yaml")
    np.testing.assert_allclose(read.torque, t.torque)
    assert read.step == pytest.approx(STEP)


def test_a_missing_field_is_named(tmp_path):
    table(tmp_path / "a.csv", trajectory(0))
    (tmp_path / "p.yaml").write_text(
        "format: irec-joints/1\nstep: 0.004\nmotor: {columns: [m1]}\nlink: {columns: [link_1]}\ntorque: {columns: [torque_1]}\n"
    )
    with pytest.raises(SessionError, match="no column 'm1'"):
        read_recordings(tmp_path / "a.csv", tmp_path / "p.yaml")


@pytest.mark.parametrize(("step", "said"), [("soon", "step is 'soon'"), ("0", "step is 0 s, must be above 0")])
def test_a_step_that_is_no_time_is_refused(tmp_path, step, said):
    table(tmp_path / "a.csv", trajectory(0))
    channels = "".join(f"{c}: {{columns: [{c}_1]}}\n" for c in ("motor", "link", "torque"))
    (tmp_path / "p.yaml").write_text(f"format: irec-joints/1\nstep: {step}\n{channels}")
    with pytest.raises(SessionError, match=said):
        read_recordings(tmp_path / "a.csv", tmp_path / "p.yaml")


def test_a_matlab_channel_without_a_field_is_refused(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"m": trajectory(0).motor})
    (tmp_path / "p.yaml").write_text(
        "format: irec-joints/1\nstep: 0.004\nmotor: {columns: [m]}\nlink: {field: m}\ntorque: {field: m}\n"
    )
    with pytest.raises(SessionError, match="no 'field'"):
        read_recordings(tmp_path / "a.mat", tmp_path / "p.yaml")
