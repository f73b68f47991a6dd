# SPDX-License-Identifier: Apache-2.0
"""Every threshold of the diagnosis in one place: unit, meaning, how it was derived. Printed into diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from ..identification.validation import FEWEST_POSES
from ..typing import Json


def _setting(value: float, unit: str, meaning: str, derived: str) -> float:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "derived": derived})  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Settings:
    """Thresholds of a diagnosis; `nats` are natural logarithms of odds."""

    noise_dof: float = _setting(
        4.0, "equations", "how much the stated noise level counts",
        "the level is known within a factor of two at two standard deviations: 1 / sqrt(2 dof) = 0.35",
    )  # fmt: skip
    nats_to_name: float = _setting(
        6.5, "nats", "evidence that a name needs over every model without it, unnamed structures included",
        "odds of 600, so that 25 effects give a wrong name in less than 5 % of clean sessions",
    )  # fmt: skip
    nats_in_one_pose: float = _setting(
        20.0, "nats", "evidence that a name needs which shows in the differences of one pose of a loaded session only",
        "a bad pose is far more common than a bumped station; the absolute readings of later poses count with it",
    )  # fmt: skip
    nats_to_separate: float = _setting(
        5.0, "nats", "explanations closer than this are not told apart", "odds of 150",
    )  # fmt: skip
    nats_to_prefer: float = _setting(
        2.3, "nats", "a name needs over every other effect in its place", "odds of 10; closer ones are given as one of several",
    )  # fmt: skip
    nats_to_refit: float = _setting(
        15.0, "nats", "effects this much worse than the best are not fitted exactly", "three times what is told apart",
    )  # fmt: skip
    share_to_name: float = _setting(
        0.02, "share of squares", "of everything explained that a name must bring by itself",
        "an effect whose form is not quite right leaves 1 % of its square to be explained by another",
    )  # fmt: skip
    nats_per_bad_row: float = _setting(
        1.0, "nats", "more evidence that a name needs for each row, reference or pose that stands out",
        "where rows stand out, tails are heavy, and evidence that counts on normal noise is too large",
    )  # fmt: skip
    share_of_form: float = _setting(
        0.03, "share of evidence", "of the unnamed structures that a name replaces, that it must bring more than they do",
        "polynomials of the generic family lose that much where they stand for a cause of another form",
    )  # fmt: skip
    nats_for_structure: float = _setting(
        6.5, "nats", "evidence of the strongest unnamed structure, the number tried taken off, that makes a session unexplained",
        "odds of 600: four kinds of structures are tried, so that noise passes for one in less than 1 % of clean sessions",
    )  # fmt: skip
    nats_for_wander: float = _setting(
        5.0, "nats", "likelihood that noise correlated in time must gain over independent noise",
        "two parameters are fitted: by chance twice the gain is chi squared of two, above 10 in less than 1 % of sessions",
    )  # fmt: skip
    held_out_sigmas: float = _setting(
        1.5, "standard errors over poses", "by which the held-out loss must fall with a name",
        "one-sided 7 %, beside the evidence",
    )  # fmt: skip
    most_names: int = field(
        default=8,
        metadata={"unit": "effects", "meaning": "names at most", "derived": "measured robots show five to ten causes"},
    )
    most_structures: int = field(
        default=8,
        metadata={"unit": "structures", "meaning": "parts of an unnamed remainder at most", "derived": "run time"},
    )
    refits: int = field(
        default=3,
        metadata={"unit": "effects", "meaning": "candidates fitted exactly at each step", "derived": "run time"},
    )
    repeats_p: float = _setting(
        1e-4, "probability", "below which repeats say that the model does not fit", "one false alarm in 10 000 sessions",
    )  # fmt: skip
    flexible_sigmas: float = _setting(
        4.0, "standard errors over poses", "by which a flexible regression must gain on held-out poses",
        "heavy tails allowed for",
    )  # fmt: skip
    fewest_poses: int = field(
        default=FEWEST_POSES,
        metadata={"unit": "poses", "meaning": "with fewer nothing is named", "derived": "nothing can be tested on other poses"},
    )

    nats_to_prove_part: float = _setting(
        6.5, "nats", "evidence of its own that an axis or direction needs to be named", "odds of 600, as the name of an effect",
    )  # fmt: skip
    nats_within_reach: float = _setting(
        5.0, "nats", "sets of parts that explain the session this much worse than the best are not told from it", "odds of 150",
    )  # fmt: skip
    share_to_prove_part: float = _setting(
        0.02, "share of squares", "of what the effect explains that a part must bring to be named",
        "a smaller part may make up for an effect's form that is not quite right",
    )  # fmt: skip
    weigh_again_below: float = _setting(
        0.7, "of the noise assumed", "noise that is left below which everything is weighed again",
        "evidence goes with the square: twice as much at 0.7",
    )  # fmt: skip
    fewest_repeats: int = field(
        default=6,
        metadata={"unit": "degrees of freedom", "meaning": "with fewer, repeats say nothing by themselves",
                  "derived": "a level from 6 is known within 30 %"},
    )  # fmt: skip
    stated_p: float = _setting(
        1e-3, "probability", "below which repeats are said to disagree with the noise that is stated",
        "one false remark in 1000 sessions",
    )  # fmt: skip
    quieter_than_stated: float = _setting(
        0.5, "of the stated variance", "below which the residual is said to be smaller than the stated noise allows",
        "a standard deviation 30 % smaller",
    )  # fmt: skip
    where_p: float = _setting(
        0.05, "probability", "corrected for all places, below which a place where the residual is, is told", "one in 20 sessions",
    )  # fmt: skip
    where_share: float = _setting(
        0.01, "share of squares", "of the residual that such a place must hold", "less helps nobody to find a cause",
    )  # fmt: skip
    where_poses: int = field(
        default=5,
        metadata={"unit": "poses", "meaning": "with fewer no place is told", "derived": "5 poses have 32 sets of signs"},
    )

    def to_json(self) -> Json:
        """Name -> value, unit, meaning, derivation."""
        return {f.name: {"value": getattr(self, f.name), **f.metadata} for f in fields(self)}


SETTINGS = Settings()
