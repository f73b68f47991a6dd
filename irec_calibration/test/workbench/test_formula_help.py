# SPDX-License-Identifier: Apache-2.0
"""While a formula is typed: completion, errors with their place, and names that somebody has to declare."""

from __future__ import annotations

import pytest
from irec_calibration.errors import EffectError
from irec_calibration.workbench.formula import check, complete, completed, undeclared

VARIABLES = ("tau", "tau_1", "tau_2", "q_1", "x", "f_x", "temp_gear")


def test_a_formula_that_can_be_read_names_its_parameters():
    found = check("axis 3: c * tau**3 + d", VARIABLES)
    assert found.error == "" and found.parameters == ("c", "d") and found.doubtful == ()


def test_a_typing_error_is_not_taken_for_a_parameter():
    assert check("axis 3: c * taw**3", VARIABLES).doubtful == (("taw", "tau"),)


def test_a_declared_name_is_a_parameter():
    assert check("axis 3: slope * tau", VARIABLES, {"slope"}).doubtful == ()


def test_a_variable_without_its_underscore_is_asked_about():
    assert check("axis 3: c * q1", VARIABLES).doubtful == (("q1", "q_1"),)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("axis 3: c * * tau", "axis 3: c * "),
        ("axis 3: c * temp_oil", "axis 3: c * "),
        ("base x: c * sin(tau", "base x: c * sin"),
        ("base x: c * tau", "base x: c * "),
        ("name = axis 3: c * foo(tau)", "name = axis 3: c * "),
    ],
)
def test_an_error_says_where_it_is(text, place):
    found = check(text, VARIABLES)
    assert found.error and found.at == len(place)


def test_a_formula_without_a_target_is_told_how_to_begin():
    assert "axis 3:" in check("c * tau").error


def test_completion_offers_what_this_session_has():
    assert complete("axis 3: c * te", 14, VARIABLES) == ["temp_gear"]
    assert complete("axis 3: c * ta", 14, VARIABLES)[:3] == ["tau", "tau_1", "tau_2"]
    assert complete("to", 2) == ["tool x: ", "tool y: ", "tool z: "]


def test_a_choice_takes_the_place_of_the_word_that_was_begun():
    assert completed("axis 3: c * ta + 1", 14, "tau") == "axis 3: c * tau + 1"
    assert completed("to", 2, "tool z: ") == "tool z: "


def test_a_declared_parameter_that_does_not_occur_is_refused():
    with pytest.raises(EffectError, match="'slope' that was declared does not occur"):
        undeclared("axis 3: c * tau", ["slope"], VARIABLES)


def test_a_message_says_at_which_character_the_error_is():
    with pytest.raises(EffectError, match="is not in this session, at character 13: 'temp_oil'"):
        undeclared("axis 3: c * temp_oil", [], VARIABLES)


@pytest.mark.parametrize("name", ["temp_gear_3", "ext_rail"])
def test_what_only_a_session_names_is_accepted_where_no_session_is_given(name):
    assert undeclared(f"axis 3: tau * (a * {name} + b * {name}**2)", []) == ()
