# SPDX-License-Identifier: Apache-2.0
"""Fits of models that are not linear in their parameters: where they end, and what they cost."""

from __future__ import annotations

from dataclasses import replace

import irec_calibration.identification.gauss_newton as gauss_newton
import numpy as np
import pytest
from irec_calibration.identification.gauss_newton import fitted
from irec_calibration.identification.identify import observe_with_force_noise
from irec_calibration.identification.system import linearise, solve
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from synthetic import session

TURNED = 0.4  # rad, of the force sensor about the tool: far from where the derivative at no angle holds
MODEL = blank_model((*EIGHTEEN_DOF, "sensor_alignment"))


@pytest.fixture(scope="module")
def observation():
    measured = session(20, seed=4)
    c, s = np.cos(TURNED), np.sin(TURNED)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    read = replace(measured, force_in_tool=measured.force_in_tool @ turn, torque_in_tool=measured.torque_in_tool @ turn)
    return observe_with_force_noise(read, MODEL)


@pytest.fixture
def derivatives(monkeypatch):
    """How often the derivative was computed, and the displacement."""
    counted = {"linearise": 0, "total_displacement": 0}

    def count(name, asked):
        def counting(*args):
            counted[name] += 1
            return asked(*args)

        monkeypatch.setattr(gauss_newton, name, counting)

    for name in counted:
        count(name, getattr(gauss_newton, name))
    return counted


def test_a_fit_ends_where_a_new_derivative_promises_nothing(observation):
    found = fitted(MODEL, observation)
    system = linearise(found.terms, observation)
    at = [e.value for t in found.terms for e in t.estimates.values()]
    now = np.array(at) / system.scale - system.centre
    loss = [((system.b - system.A @ x) ** 2).sum() for x in (now, solve(system))]
    assert found.converged and loss[0] - loss[1] <= 1e-6 * loss[0]


def test_an_angle_far_from_the_start_is_found(observation):
    turned = next(t for t in fitted(MODEL, observation).terms if t.effect.id == "sensor_alignment")
    assert turned.estimates["w_z"].value == pytest.approx(TURNED, abs=0.02)


def test_a_derivative_that_nearly_holds_is_used_for_several_steps(derivatives, monkeypatch):
    """The weight bends springs too, which is no part of the derivative by the process force."""
    terms = blank_model(EIGHTEEN_DOF)
    observation = observe_with_force_noise(session(20, seed=4), terms)
    asked = []
    for trusted in (gauss_newton.TRUSTED, np.inf):
        monkeypatch.setattr(gauss_newton, "TRUSTED", trusted)
        derivatives.update(linearise=0)
        fitted(terms, observation)
        asked.append(derivatives["linearise"])
    assert asked[0] < asked[1]


def test_a_fit_that_begins_where_another_ended_computes_nothing(observation, derivatives):
    found = fitted(MODEL, observation)
    found = replace(found, system=found.linearised(observation))
    derivatives.update(linearise=0, total_displacement=0)
    assert fitted(MODEL, observation, start=found).terms == found.terms
    assert derivatives == {"linearise": 0, "total_displacement": 0}
