# SPDX-License-Identifier: Apache-2.0
"""A session shows that one of several effects is missing and not which: neither verdict nor ladder passes one off as named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from irec_calibration.diagnose import Ladder, improve, start_terms
from irec_calibration.diagnose.assessment import assess
from irec_calibration.diagnose.build import build
from irec_calibration.diagnose.study import prepare
from test_diagnose import session
from test_diagnose_axes import axis_4_softer_in_two_steps

EITHER = ("joint_backlash", "joint_stiffening")


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    found = improve(session(axis_4_softer_in_two_steps))
    assert found.before.verdict.one_of == (EITHER,), "the session is no example of two effects that are not told apart any more"
    return found


def test_a_verdict_that_gives_one_of_several_says_what_shows_it_and_what_it_depends_on(ladder):
    verdict = ladder.before.verdict
    assert (verdict.status, verdict.effects) == ("unexplained", ())
    assert verdict.evidence == ("held_out_structure",)
    assert verdict.depends_on[0] == "tau_4"
    assert "depends on tau_4" in verdict.text and "no effect of the catalogue explains" not in verdict.text


def test_the_rung_of_one_of_several_names_them_all(ladder):
    rung = next(r for r in ladder.rungs if r.one_of)
    assert (rung.added, rung.named, rung.one_of) == ("joint_backlash", False, EITHER)
    step = next(s for s in ladder.to_json()["steps"] if s["one_of"])
    assert (step["named"], step["one_of"]) == (False, list(EITHER))


def test_neither_terminal_nor_report_says_which_of_several_it_is(ladder, tmp_path):
    from irec_calibration.commands.improve import in_words
    from irec_calibration.report.ladder import write_ladder_report

    said = in_words(ladder)
    assert "+ joint_backlash or joint_stiffening" in said and "do not tell which" in said and "(no name)" not in said
    page = write_ladder_report(ladder, session(axis_4_softer_in_two_steps), tmp_path)[0].read_text(encoding="utf-8")
    assert "do not tell which it is, joint backlash or joint stiffening" in page


def test_a_name_with_a_rival_that_lacks_little_is_one_of_the_two_and_no_name() -> None:
    measured = session(axis_4_softer_in_two_steps)
    study = prepare(measured, start_terms(measured)).to_weigh
    built = build(study)
    alone = assess(study, replace(built, rivals={}), None)
    beside = assess(study, replace(built, rivals={"joint_backlash": (("creep", 6.0),)}), None)
    assert alone.names == ("joint_backlash",) and alone.one_of == ()
    assert beside.names == () and beside.one_of == (("joint_backlash", "creep"),)
