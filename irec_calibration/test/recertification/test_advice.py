# SPDX-License-Identifier: Apache-2.0
"""What to do now, put at the end of a text and taken off again."""

from __future__ import annotations

from irec_calibration.recertification.advice import RESUME, apart, asks_to_resume, with_advice


def test_what_was_put_together_comes_apart_again():
    assert apart(with_advice("The base is loose. ", " tighten its bolts.")) == ("The base is loose.", "tighten its bolts.")
    assert apart("Nothing is wrong.") == ("Nothing is wrong.", "")


def test_going_on_with_a_run_is_recognised_in_every_text_that_asks_for_it():
    from irec_calibration.recertification.flow import GO_ON

    assert asks_to_resume(GO_ON) and asks_to_resume(apart(with_advice("It was cancelled.", f"to go on, {RESUME}."))[1])
    assert not asks_to_resume("start without resume")
