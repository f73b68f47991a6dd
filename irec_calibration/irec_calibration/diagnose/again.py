# SPDX-License-Identifier: Apache-2.0
"""What is named now was taken for something else before: where a built model asks to see the session otherwise, without plainly
wrong readings, with the sag or at the noise that it leaves, everything is weighed again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..identification.identify import observe_with_force_noise
from ..identification.observe import Observation
from .build import Built, Look, build
from .explanation import Explanation, in_one_pose
from .family import Family, family_of
from .guessed import guessed
from .knocked import without_knocked
from .level import at_level_beside, log_evidence_beside, noise_left
from .remainder import grow
from .sag import with_sag_as_seen
from .settings import SETTINGS
from .study import Study, study_of


def without_later_accidents(one: Explanation) -> Observation | None:
    """The observation without rows that are plainly wrong beside a built model and were not before, at the noise that is left
    without them; None where there are none.

    Two load cases that were swapped, say, don't stand out of a millimetre that an effect explains later; what is weighed beside
    them rests on a fit that they bend.
    """
    observation = one.study.observation
    if observation.session.kind != "loaded" or not one.added or not one.remainder.bad_rows:
        return None
    if any(in_one_pose(one, i) for i in one.ids):  # what is plainly wrong beside it may be what it is read off
        return None
    later = observe_with_force_noise(observation.session, one.study.terms)
    keep = np.isin(observation.rows, later.rows)
    if keep.all():
        return None
    less = replace(observation.only(keep), bad=later.bad, session=later.session)
    beside = study_of(less, one.study.terms)
    family = family_of(beside)
    return noise_left(beside, grow(beside.bench, family, beside.base), family) or less


SEEN: dict[str, Look] = {
    "without what is plainly wrong beside them": lambda one, _: without_later_accidents(one),
    "without a pose in which something was knocked": lambda one, _: without_knocked(one),
    "with what the arm sags on its way as it shows": lambda one, _: with_sag_as_seen(one.study, one.remainder),
    "at the noise that is left": lambda one, family: noise_left(one.study, one.remainder, family),
}


def built_either_way(
    asked: Study, study: Study, check: Callable[[], None], say: Callable[[str], None]
) -> tuple[Study, Study, Built]:  # fmt: skip
    """As `built_again`; what passes with time and noise that wanders for minutes are told apart by building beside each.

    Beside what a start leaves, that of an absolute session without springs above all, noise that wanders may describe a step, a
    drift or several causes at once as well as anything, and then no evidence is left for them. A loaded session is asked where
    nothing was found beside such noise.
    """
    found = built_again(asked, study, check, say)
    wander = found[1].observation.whiten.wander
    if wander is None or wander.share <= SETTINGS.wander_to_doubt:
        return found
    if study.session.kind == "loaded" and found[2].final.added:
        return found
    say("building without noise that wanders")
    plain = at_level_beside(replace(study.observation, whiten=replace(study.observation.whiten, wander=None)), asked.terms)
    asked, study = replace(study_of(plain, asked.terms), apart=asked.apart), study_of(plain, study.terms)
    return max(found, built_again(asked, study, check, say), key=lambda one: _log_odds(one[2].final))


def _log_odds(one: Explanation) -> float:
    """Log evidence of a model, its remainder and its noise, comparable between noises."""
    observation = one.study.observation
    odds = -SETTINGS.nats_to_name * len(one.added) - SETTINGS.nats_for_wander * (observation.whiten.wander is not None)
    return odds + log_evidence_beside(observation, one.study.terms)


def built_again(asked: Study, study: Study, check: Callable[[], None], say: Callable[[str], None]) -> tuple[Study, Study, Built]:
    """A model built from the effects of the catalogue; where it asks to see the session otherwise, everything is weighed again.

    Each way to see it otherwise (SEEN) is followed once. Effects that are `guessed` are left out then.

    Args:
        asked: the model that was asked for; study: with what completes its springs.
        check: raises where the work was cancelled; say: is told why everything is weighed again.

    Returns:
        the same two on the session as it is seen at last, and what was built on the second.
    """
    open_ = dict(SEEN)
    found = ""
    without: dict[str, str] = {}

    def look(one: Explanation, family: Family) -> Observation | None:
        nonlocal found
        for words, see in open_.items():
            seen = see(one, family)
            if seen is not None:
                found = words
                return seen
        return None

    while True:
        built = build(study, check, look, without=without)
        if built.seen is None:
            guesses = guessed(built)
            if not guesses:
                return asked, study, built
            say(f"weighing the effects again without {', '.join(guesses)}")
            without |= guesses
            continue
        say(f"weighing the effects again {found}")
        del open_[found]
        asked = replace(study_of(built.seen, asked.terms), apart=asked.apart)
        study = study_of(built.seen, study.terms)
