# SPDX-License-Identifier: Apache-2.0
"""Compliances that would be a source of energy are of no spring."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from irec_calibration.effects import find_effect
from irec_calibration.effects.passive import why_no_spring

COUPLED = {"c_xy": ("c_x", "c_y")}


def values(c_x, c_y, c_xy, se=0.0):
    return {"c_x": (c_x, se), "c_y": (c_y, se), "c_xy": (c_xy, se)}


@given(arrays(float, (2, 2), elements=st.integers(-100, 100)))
def test_no_spring_is_refused(root):
    """Whatever its matrix: a root times its transpose is one of a spring."""
    matrix = root @ root.T
    assert why_no_spring(values(matrix[0, 0], matrix[1, 1], (1.0 - 1e-9) * matrix[0, 1]), COUPLED) == ""


@given(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0), st.floats(1.01, 10.0), st.sampled_from([-1.0, 1.0]))
def test_what_would_gain_energy_is_refused(c_x, c_y, times, sign):
    between = sign * times * math.sqrt(c_x * c_y)
    assert np.linalg.eigvalsh([[c_x, between], [between, c_y]])[0] < 0.0
    assert "no spring" in why_no_spring(values(c_x, c_y, between), COUPLED)


def test_what_may_be_a_spring_within_the_errors_is_none_of_our_business():
    assert why_no_spring(values(1.0, 0.0, 0.5), COUPLED) != ""
    assert why_no_spring(values(1.0, 0.0, 0.5, se=0.2), COUPLED) == ""


def test_nothing_is_said_where_an_error_is_not_known():
    assert why_no_spring(values(1.0, 0.0, 0.5, se=math.nan), COUPLED) == ""
    assert why_no_spring({"c_xy": (0.5, 0.0), "c_x": (1.0, 0.0)}, COUPLED) == ""


@pytest.mark.parametrize(
    ("effect", "of_no_spring"),
    [
        ("base_compliance", {"t_z": (0.0, 1e-10), "r_y": (1e-7, 1e-9), "tr_zy": (5e-8, 1e-9)}),
        ("base_compliance", {"r_x": (1e-8, 1e-10), "r_y": (1e-7, 1e-9), "r_xy": (5e-8, 1e-9)}),
        ("tool_compliance", {"c_x": (1e-8, 1e-10), "c_z": (1e-8, 1e-10), "c_xz": (2e-8, 1e-10)}),
    ],
)
def test_a_base_and_a_tool_are_springs(effect, of_no_spring):
    assert "no spring" in find_effect(effect).why_impossible(of_no_spring, {}, None)
    softer = {n: (100.0 * v + 1e-6 if "_" in n and len(n.split("_")[1]) == 1 else v, se) for n, (v, se) in of_no_spring.items()}
    assert find_effect(effect).why_impossible(softer, {}, None) == ""
