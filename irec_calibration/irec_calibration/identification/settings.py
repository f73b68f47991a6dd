# SPDX-License-Identifier: Apache-2.0
"""Thresholds of the identification: unit, meaning, how each was derived. A diagnosis records them in diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass

from ..declared import Thresholds, threshold


@dataclass(frozen=True)
class IdentifiabilityThresholds(Thresholds):
    """What counts as known."""

    structural: float = threshold(
        1e-7, "of the largest singular value", "below which a direction is not observed at all",
        "far above rounding, far below what noise lets a session tell",
    )  # fmt: skip
    invisible: float = threshold(
        1e-3, "standard deviations", "that all samples together see of a parameter of typical size; below, it is not visible",
        "a session would have to be repeated a million times",
    )  # fmt: skip
    alone: float = threshold(
        1e-3, "share of a parameter", "along unobserved directions below which it is known by itself",
        "what is missing then is far below its standard error",
    )  # fmt: skip


@dataclass(frozen=True)
class AbsoluteThresholds(Thresholds):
    """What absolute sessions determine, and how their rows are weighted and compared."""

    determined: float = threshold(
        2.0, "parameter scales", "a geometric parameter with a larger standard error is not determined",
        "2 mm and 2 mrad: not better known than before the session",
    )  # fmt: skip
    structural: float = threshold(
        1e-6, "share of a column", "that must be left when what is chosen already is taken out", "well above rounding",
    )  # fmt: skip
    near: float = threshold(
        0.02, "rad", "in every joint: poses this close should have the same error",
        "an error that follows the angle hardly changes over 1 degree",
    )  # fmt: skip
    near_m: float = threshold(0.01, "m", "the same of external axes and sliding joints", "as 0.02 rad at half a metre")
    fewest_pairs: int = threshold(
        10, "pairs", "of close poses; fewer do not tell the noise", "a level from 10: within 25 %"
    )
    in_pairs: int = threshold(
        4, "poses", "of the poses that models are compared on, one in so many may be kept for having a neighbour",
        "the rest stays spread over the session",
    )  # fmt: skip
    repeating: float = threshold(
        0.6, "of the residual", "difference within pairs of close poses below which the residual repeats with the pose",
        "independent errors would differ by 1.4 times their size",
    )  # fmt: skip
    fewest_of_marker: int = threshold(
        20, "rows", "fewer do not tell how well a marker fits", "a level from 20: within 20 %"
    )
    better: float = threshold(
        0.97, "of the misfit of reported angles", "below which commanded ones are used", "chosen: less could be chance",
    )  # fmt: skip
    source_poses: int = threshold(300, "poses", "that tell which angles are used", "run time")
    thinned_to: int = threshold(1000, "poses", "that models are compared on at most", "more make a comparison no better")
    thinned_rows: int = threshold(
        2000, "rows", "of all markers together that models are compared on at most",
        "run time; markers of one pose see the same errors of the robot",
    )  # fmt: skip


IDENTIFIABILITY = IdentifiabilityThresholds()
ABSOLUTE = AbsoluteThresholds()
