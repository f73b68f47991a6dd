# SPDX-License-Identifier: Apache-2.0
"""Mass, centre of mass and bias from readings without contact."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import SolveError
from irec_calibration.sensors.tool_load import ToolLoad, identify_tool_load, standing
from scipy.spatial.transform import Rotation

G = np.array([0.0, 0.0, -9.81])
TRUE = ToolLoad(120.0, (0.01, -0.02, 0.21), (18.0, -11.0, 25.0), (1.2, -0.8, 0.5))


def readings(load: ToolLoad, R: np.ndarray, force_noise: float = 0.0, torque_noise: float = 0.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = np.zeros((len(R), 6))
    noise[:, :3], noise[:, 3:] = rng.normal(0, force_noise, (len(R), 3)), rng.normal(0, torque_noise, (len(R), 3))
    return np.array([load.reading(r, G) for r in R]) + noise


def orientations(n: int, seed: int = 1) -> np.ndarray:
    return Rotation.random(n, random_state=seed).as_matrix()


def test_reading_is_bias_and_weight_in_the_sensor_and_its_moment():
    load = ToolLoad(10.0, (0.0, 0.0, 0.2), (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    on_its_side = Rotation.from_euler("x", 90, degrees=True).as_matrix()  # sensor y points up
    np.testing.assert_allclose(load.reading(on_its_side, G), [1.0, 2.0 - 98.1, 3.0, 0.1 + 0.2 * 98.1, 0.2, 0.3], atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(mass=st.floats(1.0, 300.0), com=st.tuples(*(st.floats(-0.4, 0.4) for _ in range(3))), seed=st.integers(0, 1000))
def test_noise_free_readings_give_back_the_load(mass, com, seed):
    load = ToolLoad(mass, com, (5.0, -3.0, 2.0), (0.3, 0.1, -0.2))
    R = orientations(30, seed)  # ten at random are too much alike once in a thousand times
    fit = identify_tool_load(readings(load, R), R)
    assert fit.load.mass == pytest.approx(mass, rel=1e-6)
    np.testing.assert_allclose(fit.load.com, com, atol=1e-6)
    np.testing.assert_allclose(fit.load.bias_force, load.bias_force, atol=1e-5)


def test_standard_errors_cover_the_truth_as_often_as_they_say():
    hits = []
    R = orientations(8)
    for seed in range(100):
        fit = identify_tool_load(readings(TRUE, R, 0.5, 0.1, seed), R)
        for name in ("mass", "com", "bias_force", "bias_torque"):
            value, true, se = (np.atleast_1d(x) for x in (getattr(fit.load, name), getattr(TRUE, name), fit.se[name]))
            hits += list(np.abs(value - true) < 1.96 * se)
    assert 0.90 <= np.mean(hits) <= 0.99


def test_a_sensor_that_is_mounted_turned_is_found():
    turned = ToolLoad(120.0, TRUE.com, TRUE.bias_force, TRUE.bias_torque, (0.0, 0.01, 0.06))
    R = orientations(12)
    fit = identify_tool_load(readings(turned, R, 0.3, 0.05), R, alignment=True)
    np.testing.assert_allclose(fit.load.alignment, turned.alignment, atol=2e-3)
    plain = identify_tool_load(readings(turned, R, 0.3, 0.05), R)
    assert plain.residual_force > 5 * fit.residual_force


def test_a_wrench_is_brought_from_the_true_sensor_to_the_stated_frame():
    turned = ToolLoad(alignment=(0.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(turned.aligned(np.array([1.0, 0, 0, 0, 0, 2.0])), [0, 1.0, 0, 0, 0, 2.0], atol=1e-12)


def test_too_few_orientations_are_refused():
    R = orientations(3)
    with pytest.raises(SolveError, match="3 orientations.*at least 4"):
        identify_tool_load(readings(TRUE, R), R)


def test_orientations_that_turn_about_one_axis_only_are_refused():
    R = Rotation.from_euler("x", np.linspace(0, 3, 9)[:, None]).as_matrix()
    with pytest.raises(SolveError, match="too much alike"):
        identify_tool_load(readings(TRUE, R), R)


def test_an_orientation_in_contact_is_named_as_the_one_that_fits_worst():
    R = orientations(10)
    w = readings(TRUE, R, 0.3, 0.05)
    w[6, 2] -= 60.0
    assert identify_tool_load(w, R).worst[0] == 6


def test_wrench_of_the_wrong_sign_is_said():
    R = orientations(10)
    with pytest.raises(SolveError, match="sign or frame"):
        identify_tool_load(-readings(TRUE, R), R)


def test_only_times_of_standing_still_are_averaged():
    t = np.arange(0, 10, 0.01)
    q = np.zeros((len(t), 2))
    q[:, 0] = np.interp(t, [0, 3, 5, 10], [0.0, 0.0, 0.8, 0.8])
    w = np.zeros((len(t), 6))
    w[:, 0] = np.where(t < 3.005, 1.0, np.where(t > 4.995, 2.0, 99.0))
    found = standing(t, q, t, w)
    np.testing.assert_allclose(found.readings[:, 0], [1.0, 2.0])
    np.testing.assert_allclose(found.q[:, 0], [0.0, 0.8], atol=1e-3)


def test_command_reads_a_recording_and_writes_parameters(tmp_path):
    from irec_calibration.cli import main
    from tool_load_bag import write_bag

    bag = write_bag(tmp_path / "turns.mcap", TRUE)
    assert main(["tool-load", str(bag), "-o", str(tmp_path / "tool_load.yaml")]) == 0
    text = (tmp_path / "tool_load.yaml").read_text()
    assert "&" not in text, "the parser of ROS refuses aliases"
    tree = yaml.safe_load(text)
    for node in ("correction_node", "rsi_bridge"):
        assert tree[f"/**/{node}"]["ros__parameters"] == {"raw_wrench": True}
    written = tree["/**"]["ros__parameters"]
    assert list(written) == ["tool_load"], "what goes for every node is known to a driver too"
    assert written["tool_load"]["mass"] == pytest.approx(120.0, abs=0.5)
    np.testing.assert_allclose(written["tool_load"]["com"], TRUE.com, atol=2e-3)


def test_command_says_what_a_recording_lacks(tmp_path, capsys):
    from irec_calibration.cli import main
    from tool_load_bag import write_bag

    bag = write_bag(tmp_path / "turns.mcap", TRUE)
    assert main(["tool-load", str(bag), "--wrench", "somewhere"]) == 2
    assert "no message on 'somewhere'" in capsys.readouterr().err
