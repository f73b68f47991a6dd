# SPDX-License-Identifier: Apache-2.0
"""Effects that users add: a formula, a class in a file, and the worked example of docs/adding-an-effect.md."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.effects import find_effect
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.live import LeftOut, Refused
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.user import effect_from_text, register_file
from irec_calibration.errors import EffectError, ModelError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, Term, blank_model
from irec_calibration.model.file import load_model, save_model
from synthetic import session

GUIDE = Path(__file__).parents[3] / "docs" / "adding-an-effect.md"
HARDENING = -4e-14


def hardened(seed: int = 7):
    return session(31, seed=seed, extra=lambda s: s.J[:, :, 2] * (HARDENING * s.tau[:, 2] ** 3)[:, None])


def test_a_formula_is_identified_like_any_effect():
    fit = identify(hardened(), [*blank_model(EIGHTEEN_DOF), Term(FormulaEffect("h", "axis 3: c * tau**3"))])
    c = fit.terms[-1].estimates["c"]
    assert abs(c.value - HARDENING) < 4.0 * c.se and c.se < 0.2 * abs(HARDENING)


def test_the_worked_example_of_the_guide_finds_the_hardening(tmp_path):
    code = re.search(r"<!-- tested: my_effects.py -->\s*```python\n(.*?)```", GUIDE.read_text(), re.S)
    (tmp_path / "my_effects.py").write_text(code[1])
    (effect,) = register_file(tmp_path / "my_effects.py")
    fit = identify(hardened(), [*blank_model(EIGHTEEN_DOF), Term(effect)])
    c = fit.terms[-1].estimates["c_3"]
    assert abs(c.value - HARDENING) < 4.0 * c.se
    assert find_effect("cubic_hardening") is effect


def test_a_model_with_a_formula_survives_its_file(tmp_path):
    fit = identify(hardened(), [*blank_model(EIGHTEEN_DOF), Term(effect_from_text("hardening = axis 3: c * tau**3"))])
    model = model_of(fit)
    again = load_model(save_model(model, tmp_path / "model.yaml"))
    scene = scene_of(fit.observation.session, observe="tcp")
    np.testing.assert_allclose(again.predict(scene), model.predict(scene), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("formula", "complaint"),
    [
        ("c * tau", "must begin with"),
        ("axis 3: c * __import__('os').system('true')", "is not a function"),
        ("axis 3: c * tau.real", "is not allowed"),
        ("axis 3: c * (lambda: 1)()", "is not a function"),
        ("axis 3: c * tau ** 99", "exponent 99"),
        ("axis 3: [c for c in q]", "is not allowed"),
        ("axis 3: c if tau > 0 else 1", "is not allowed"),
        ("axis 3: tau", "no parameter"),
        ("axis 3: c *", "not an expression"),
        ("axis 3: c * sin(q, q)", "takes 1 argument"),
        ("axis 3: c * True", "is not a number"),
        ("axis 3: c * min(tau, q) + min", "'min' is a function"),
        ("axis 3: c * (tau.real " + "".join(" + 1" for _ in range(110)) + ")", "inside one another"),
        ("axis 3: " + 450 * "-" + "c", "inside one another"),
    ],
)
def test_a_formula_that_is_no_plain_expression_is_refused(formula, complaint):
    with pytest.raises(EffectError, match=re.escape(complaint)):
        FormulaEffect("x", formula)


@given(st.text(max_size=60))
def test_no_text_whatever_crashes_the_formula_reader(text):
    try:
        FormulaEffect("x", "axis 1: " + text)
    except EffectError:
        pass


def test_a_formula_with_an_axis_or_column_that_is_not_there_says_so():
    scene = scene_of(session(3))
    with pytest.raises(EffectError, match="the robot has 6 axes"):
        FormulaEffect("x", "axis 9: c").displacement(scene, np.array([1.0]))
    with pytest.raises(EffectError, match="'temp_gear' is not in this session"):
        FormulaEffect("x", "base x: c * temp_gear").parameters(scene)


def test_a_formula_that_is_not_finite_names_the_row():
    with pytest.raises(EffectError, match="not a finite number in row 1"):
        FormulaEffect("x", "base x: c * log(-1)").displacement(scene_of(session(3)), np.array([1.0]))


def test_a_file_without_effects_is_refused(tmp_path):
    (tmp_path / "nothing.py").write_text("x = 1\n")
    with pytest.raises(EffectError, match="no class in it is an Effect"):
        register_file(tmp_path / "nothing.py")


def test_a_file_that_fails_is_named_with_its_error(tmp_path):
    (tmp_path / "broken.py").write_text("1 / 0\n")
    with pytest.raises(EffectError, match="broken.py: ZeroDivisionError"):
        register_file(tmp_path / "broken.py")


def test_an_id_of_the_catalogue_can_not_be_taken(tmp_path):
    (tmp_path / "thief.py").write_text(
        "from irec_calibration.effects import Effect\n"
        "class Thief(Effect):\n"
        "    id = 'joint_torsion'\n    label = 'x'\n    physics = 'x'\n"
        "    def parameters(self, scene):\n        return ()\n"
    )
    with pytest.raises(EffectError, match="is taken already"):
        register_file(tmp_path / "thief.py")


def test_a_file_that_was_changed_is_read_again_and_another_file_can_not_take_its_id(tmp_path):
    text = (
        "from irec_calibration.effects import Effect\n"
        "class Own(Effect):\n"
        "    id = 'read_again'\n    label = 'FIRST'\n    physics = 'x'\n"
        "    def parameters(self, scene):\n        return ()\n"
    )
    (tmp_path / "own.py").write_text(text)
    (tmp_path / "other.py").write_text(text)
    register_file(tmp_path / "own.py")
    (tmp_path / "own.py").write_text(text.replace("FIRST", "second"))
    register_file(tmp_path / "own.py")
    assert find_effect("read_again").label == "second"
    with pytest.raises(EffectError, match=r"taken already by .*own\.py"):
        register_file(tmp_path / "other.py")


def test_a_model_file_names_the_field_that_is_wrong(tmp_path):
    (tmp_path / "m.yaml").write_text(
        "format: irec-model/1\neffects:\n- effect: joint_torsion\n  parameters: {c_1: {value: -1.0, lower: 0.0}}\n"
    )
    with pytest.raises(ModelError, match=r"m.yaml:4: effects\[0\].parameters.c_1.value is -1, outside its bounds"):
        load_model(tmp_path / "m.yaml")


def test_a_model_of_a_later_format_is_refused(tmp_path):
    (tmp_path / "m.yaml").write_text("format: irec-model/2\neffects: []\n")
    with pytest.raises(ModelError, match="this program reads irec-model/1"):
        load_model(tmp_path / "m.yaml")

def test_an_effect_from_a_file_gets_parts_priors_and_a_place_in_the_diagnosis(tmp_path):
    from irec_calibration.diagnose.candidates import try_effect
    from irec_calibration.diagnose.study import prepare

    code = re.search(r"<!-- tested: my_effects.py -->\s*```python\n(.*?)```", GUIDE.read_text(), re.S)
    (tmp_path / "mine.py").write_text(code[1].replace("cubic_hardening", "own_hardening"))
    (effect,) = register_file(tmp_path / "mine.py")
    trial = try_effect(prepare(hardened(), blank_model(EIGHTEEN_DOF)), effect)
    assert "axis 3" in trial.best.groups and trial.log_evidence > 6.5


@pytest.mark.parametrize("formula", ["axis 3: tau * a * (temp_gear_3 - 30.2)", "tool z: f_z * (temp_x - 20) * (a + b * q_1)"])
def test_a_correction_leaves_out_what_is_counted_from_the_temperature_of_the_calibration(formula):
    form = FormulaEffect("law", formula).no_live_form()
    assert isinstance(form, LeftOut) and "which a correction does not read" in form.why


@pytest.mark.parametrize(
    "formula",
    [
        "axis 3: tau * a * temp_gear_3",
        "axis 3: tau * a * (temp_gear_3 - 30.2) + tau * b",
        "axis 3: tau * (a * (temp_gear_3 - 30.2) + temp_oil)",
        "axis 3: tau * a * (temp_gear_3 - 30.2) * dwell",
    ],
)
def test_a_correction_refuses_what_would_be_missing_without_the_temperature(formula):
    assert isinstance(FormulaEffect("law", formula).no_live_form(), Refused)
