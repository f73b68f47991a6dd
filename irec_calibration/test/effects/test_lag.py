# SPDX-License-Identifier: Apache-2.0
"""Creep that is summed up at once is that of one row after the other."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.effects import creep, find_effect, known_effects, parameters_of
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.state import ElasticResponse
from synthetic import session


@settings(max_examples=60, deadline=None)
@given(
    gaps=st.lists(st.sampled_from([0.0, 1e-3, 0.3, 2.0, 40.0, 290.0, 900.0, 1e6]), min_size=1, max_size=30),
    seed=st.integers(0, 2**16),
)
def test_a_lag_over_a_session_is_that_of_one_step_after_the_other(gaps: list[float], seed: int) -> None:
    t = 5.0 + np.cumsum(np.concatenate([[0.0], gaps]))
    x = np.random.default_rng(seed).normal(size=(len(t), 2))
    expected = x.copy()
    for i in range(1, len(t)):
        expected[i] += np.exp(t[i - 1] - t[i]) * (expected[i - 1] - x[i])
    np.testing.assert_allclose(creep._lagged(x, t), expected, rtol=1e-9, atol=1e-12)


def test_the_clock_of_creep_without_memory_goes_on_where_the_load_stays() -> None:
    scene = scene_of(session(4, seed=3))
    u = np.zeros((len(scene), 3))
    first, second, third = (np.flatnonzero(scene.load_case == c) for c in (1, 2, 3))
    u[first], u[second], u[third] = (1e-3, 0.0, 0.0), (1.01e-3, 0.0, 0.0), (1.1e-3, 0.0, 0.0)
    scene = scene.loaded_otherwise(elastic=ElasticResponse(u, 0.0 * u, np.zeros((len(scene), 3, 6))))
    since = creep._same_load_since(scene)
    np.testing.assert_array_equal(since[first], scene.load_since[first])
    np.testing.assert_array_equal(since[second], scene.load_since[first])
    np.testing.assert_array_equal(since[third], scene.load_since[third])


def test_no_effect_has_other_parameters_under_another_load() -> None:
    scene = scene_of(session(4, seed=3))
    other = scene_of(session(4, seed=3)).with_wrench(-3.0 * scene.force_in_tool, scene.torque_in_tool + 7.0)
    for effect in known_effects().values():
        assert effect.parameters(other) == effect.parameters(scene), effect.id
    torsion = find_effect("joint_torsion")
    assert parameters_of(torsion, scene.with_wrench(scene.force_in_tool, scene.torque_in_tool)) is parameters_of(torsion, scene)
