# SPDX-License-Identifier: Apache-2.0
"""The live correction computes what `model.predict` computes: every effect, every kind of formula, whole load sequences."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.effects import CATALOGUE, Cause, Effect, Parameter
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.production import at, production_scene
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.robot import Payload
from irec_calibration.session import Marker, Noise, Session, Station
from irec_correction.deflection import Deflection
from test_deflection import ROBOT, angles, model_of

SPRINGS = ("joint_torsion", "link_bending")
SENSOR = ("tool_weight", "sensor_gain", "sensor_alignment")
RAIL = 0.7
FORMULAS = ("axis 3: c * tau**3", "axis 2: a * tanh(tau / b) + c * tau_g * tau", "tool z: c * abs(f_z)", "base x: c * b_y * x",
            "axis 1: c * tau_2 * ext_rail", "axis 5: c * q * f_x", "axis 4: c * sin(q)", "base z: v * t",
            "axis 3: tau_5 * (a + b * cos(q_4)) + c * tau * tau_5 / load",
            "axis 2: a * tanh(200 / abs(tau_3)) + b * tau", "link 2b: c * tau * tau_2 / load",
            "axis 5: abs(f_x) * (a + b * clip(q, -0.5, 0.5)) * sign(tau_2) / min(load, 800)",
            "link 4a: a * load * (tanh((900 * tau / load + tau_g) / 200) - tanh(tau_g / 200)) + b * abs(tau)")  # fmt: skip
NO_GRAVITY, DOWN, TILTED = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (0.0, 6.9, -6.9)

forces = st.tuples(*(st.sampled_from([-1500.0, -300.0, -1.0, 0.0, 280.0, 1100.0]) | st.floats(-1500, 1500) for _ in range(3)))
torques = st.tuples(*(st.just(0.0) | st.floats(-100, 100) for _ in range(3)))


@st.composite
def load_sequences(draw):
    """Loads (force, torque, dwell): new ones, the one before turned round, the same once more after a pause, none at all."""
    out = []
    for _ in range(draw(st.integers(1, 7))):
        kind = draw(st.sampled_from(["new", "reversed", "pause", "released"] if out else ["new"]))
        force, torque = (np.array(draw(s)) for s in (forces, torques)) if kind == "new" else out[-1][:2]
        if kind in ("reversed", "released"):
            force, torque = (-force, -torque) if kind == "reversed" else (0.0 * force, 0.0 * torque)
        out.append((force, torque, draw(st.sampled_from([0.004, 0.1, 3.0, 200.0]))))
    return out


def read_by_sensor(model: Model, R_tool: np.ndarray, gravity: np.ndarray, force: np.ndarray, torque: np.ndarray):
    """What the sensor reads where this force acts: the model's sensor effects undone, written out."""
    value = {(t.effect.id, n): e.value for t in model.terms for n, e in t.estimates.items()}
    for effect in reversed([t.effect.id for t in model.terms]):
        if effect == "sensor_alignment":
            w = np.array([value[effect, f"w_{a}"] for a in "xyz"])
            angle = np.linalg.norm(w)
            x, y, z = w / angle
            K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
            force, torque = R.T @ force, R.T @ torque
        elif effect == "sensor_gain":
            e = {n[2:]: v for (t, n), v in value.items() if t == effect}
            G = np.array([[1 + e["xx"], e["xy"], e["xz"]], [e["yx"], 1 + e["yy"], e["yz"]],
                          [e["zx"], e["zy"], 1 - e["xx"] - e["yy"]]])  # fmt: skip
            force = np.linalg.solve(G, force)
        elif effect == "tool_weight":
            force = force + value[effect, "dm"] * (R_tool.T @ gravity)
    return force, torque


def compare(model: Model, q: np.ndarray, loads: list, gravity=DOWN, payload: Payload | None = None) -> None:
    """The offset of each tick that ends a row, against the prediction for that row."""
    n, R = len(loads) + 1, model.standing(at(production_scene(ROBOT, np.array(gravity)), q, RAIL)).kin.R_tool[0]
    read = [read_by_sensor(model, R, np.array(gravity), f, m) for f, m, _ in [(np.zeros(3), np.zeros(3), 0.0), *loads]]
    one = np.zeros(n, dtype=np.int64)
    kin = ROBOT.kinematics(np.tile(q, (n, 1)))
    session = Session(
        name="loads", kind="loaded", robot=ROBOT, serial="", pose=one + 1, load_case=np.arange(n), repeat=one,
        stamp=np.cumsum([5.0, *(dwell for _, _, dwell in loads)]), q=np.tile(q, (n, 1)), p_tcp_in_base=kin.p_tcp,
        p_marker_in_station=np.full((n, 3), np.nan), station=one, stations=(Station("A"),), marker=one,
        markers=(Marker("M"),), force_in_tool=np.array([f for f, _ in read]), torque_in_tool=np.array([m for _, m in read]),
        noise=Noise(1e-5), ext={"rail": np.full(n, RAIL)}, temperature={"spindle": np.linspace(20, 25, n)},
        gravity_in_base=gravity, payload=payload,
    )  # fmt: skip
    expected = model.predict(scene_of(session, observe="tcp"))
    live = Deflection(model, ROBOT, gravity, payload)
    for i, (_, _, dwell) in enumerate(loads, 1):
        for _ in range(3):
            u, _ = live(q, *read[i], dwell / 3, RAIL)
        np.testing.assert_allclose(u, expected[i], rtol=1e-7, atol=1e-11, err_msg=f"row {i}")


@pytest.mark.parametrize("effect", [cls.id for cls in CATALOGUE] + list(FORMULAS))
@settings(max_examples=12, deadline=None)
@given(q=angles, loads=load_sequences(), gravity=st.sampled_from([NO_GRAVITY, DOWN, TILTED]), seed=st.integers(0, 9))
def test_every_effect_moves_the_tool_live_as_it_does_in_a_prediction(effect, q, loads, gravity, seed):
    company = [e for e in SPRINGS if e != effect]
    compare(model_of(*company, effect, seed=seed), np.array(q), loads, gravity)


@settings(max_examples=25, deadline=None)
@given(q=angles, loads=load_sequences(), seed=st.integers(0, 99), order=st.permutations(SENSOR))
def test_the_whole_catalogue_at_once_moves_the_tool_live_as_it_does_in_a_prediction(q, loads, seed, order):
    others = [cls.id for cls in CATALOGUE if cls.id not in SENSOR]
    compare(model_of(*others, *order, FORMULAS[1], seed=seed), np.array(q), loads, payload=Payload(40.0, (0.0, 0.1, 0.2)))


class Follower(Effect):
    """A user's effect that builds on the springs of the model."""

    id = label = physics = "follower"
    needs_elastic = True

    def parameters(self, scene):
        return (Parameter("s", "1", 0.1),)

    def regressor(self, scene, theta):
        turned = np.cross(scene.elastic.rotation, scene.kin.R_tool[:, :, 2])
        pushed = scene.elastic.compliance[:, :, 2] * 100.0
        return (scene.elastic.displacement + turned + pushed)[:, :, None]


@settings(max_examples=12, deadline=None)
@given(q=angles, loads=load_sequences())
def test_an_effect_of_the_user_reads_the_springs_of_the_model_live_too(q, loads):
    terms = model_of(*SPRINGS, "base_compliance", "tool_compliance").terms
    u = Term(Follower(), {"s": model_of("creep").terms[0].estimates["share"]})
    compare(Model((*terms, u)), np.array(q), loads)


class Worn(Effect):
    """A user's law of all that a gear carries."""

    id = label = physics = "worn"

    def parameters(self, scene):
        return (Parameter("c", "rad/(N m)^3", 1e-13),)

    def regressor(self, scene, theta):
        return np.einsum("nik,nk->ni", scene.J, scene.tau_acting**3)[:, :, None]


@settings(max_examples=12, deadline=None)
@given(q=angles, loads=load_sequences())
def test_an_effect_of_the_user_reads_what_hoses_pull_live_too(q, loads):
    terms = model_of(*SPRINGS, "external_force").terms
    compare(Model((*terms, Term(Worn(), {"c": Estimate(1e-15)}))), np.array(q), loads)


@settings(max_examples=12, deadline=None)
@given(q=angles)
def test_beside_a_geometry_error_the_tool_is_where_the_controller_believes_it(q):
    """Springs turn about the true joints; the frame in which a controller takes an offset is its own."""
    live = Deflection(model_of(*SPRINGS, "geometry_error"), ROBOT)
    live(np.array(q), np.array([0.0, 0.0, -1000.0]), np.zeros(3), 0.004)
    np.testing.assert_allclose(live.R_tool, ROBOT.kinematics(np.array(q)).R_tool[0], atol=1e-12)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda cls: cls.id)
def test_an_effect_that_the_process_force_does_not_cause_says_why_it_has_no_part(effect):
    left_out = Deflection(model_of(*SPRINGS, effect.id), ROBOT).left_out
    assert (effect.id in left_out) == (effect.cause is not Cause.LOAD)


def test_the_real_time_form_of_the_guide_is_that_of_its_effect():
    guide = (Path(__file__).parents[2] / "docs/adding-an-effect.md").read_text(encoding="utf-8")
    space: dict = {}
    for code in re.findall(r"<!-- tested: .*?my_effects.py -->\s*```python\n(.*?)```", guide, re.S):
        exec(code, space)  # our own document
    cls = space["CubicHardening"]
    q, wrench = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), (np.array([100.0, -50.0, -900.0]), np.ones(3))
    model = Model((Term(cls(), {f"c_{k}": Estimate(1e-13 * k) for k in range(1, 7)}),))
    slow = Deflection(model, ROBOT)(q, *wrench, 0.004)[0]
    cls.live = space["live"]
    np.testing.assert_allclose(Deflection(model, ROBOT)(q, *wrench, 0.004)[0], slow, atol=1e-12)
    assert np.linalg.norm(slow) > 1e-6
