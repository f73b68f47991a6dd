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
    least_of_instrument: float = threshold(
        0.5, "of what the session states", "smallest noise of tracker and settling that a marker is taken to have",
        "the stated noise is known within a factor of two",
    )  # fmt: skip
    least_left: float = threshold(
        0.1, "share of the noise's variance", "that a fit is taken to leave at least, where the residual tells the noise",
        "a fit that takes up more tells nothing",
    )  # fmt: skip
    better: float = threshold(
        0.97, "of the misfit of reported angles", "below which commanded ones are used", "chosen: less could be chance",
    )  # fmt: skip
    largest_lag: float = threshold(
        0.02, "rad, m", "between reported and commanded angles that were read before the arm had settled", "chosen",
    )  # fmt: skip
    left_of_lag: float = threshold(
        0.2, "share of squares", "that a share of the step before must leave of that difference to be what it is", "chosen",
    )  # fmt: skip
    source_poses: int = threshold(300, "poses", "that tell which angles are used", "run time")
    thinned_to: int = threshold(1000, "poses", "that models are compared on at most", "more make a comparison no better")
    thinned_rows: int = threshold(
        2000, "rows", "of all markers together that models are compared on at most",
        "run time; markers of one pose see the same errors of the robot",
    )  # fmt: skip


@dataclass(frozen=True)
class OutlierThresholds(Thresholds):
    """When rows are called wrong. Robust standard deviations are of the norm of three coordinates."""

    least: float = threshold(
        7.0, "robust standard deviations", "below which nothing is called wrong", "normal noise: one row in a billion",
    )  # fmt: skip
    tail: float = threshold(
        8.0, "distances of median and upper quartile", "beyond the upper quartile from which a row is an accident",
        "chosen: heavy tails are no accident",
    )  # fmt: skip
    least_step: float = threshold(5.0, "robust standard deviations", "`least` of a step within a pose", "only an accident steps")
    tail_step: float = threshold(6.0, "distances of median and upper quartile", "`tail` of such a step", "only an accident steps")
    explained: float = threshold(0.6, "share of squares", "of a pose's residual that an accident must explain", "chosen: most")
    most: float = threshold(0.2, "share of rows", "where more seem wrong, they are weighted only", "chosen")
    rounds: int = threshold(8, "rounds", "of leaving rows out and looking again at most", "run time")
    smallest_weight: float = threshold(1e-12, "weight", "of a row in the robust fits before anything is decided", "rounding")
    certain: float = threshold(
        25.0, "robust standard deviations", "from which a row of a loaded session is wrong whatever effect is missing",
        "chosen: above what single effects of the catalogue do in one row",
    )  # fmt: skip
    certain_step: float = threshold(
        150.0, "robust standard deviations", "the same for rows that moved together",
        "chosen: a station that was bumped is an effect of the catalogue",
    )  # fmt: skip
    shown_again: float = threshold(
        0.4, "of the larger", "two readings of one load case of a pose, in two repeats, are moved differently at most",
        "chosen: what bends them is bent by the rest of the model, too",
    )  # fmt: skip
    worst_first: float = threshold(
        1e-4, "of the largest squared residual of a pose", "less waits for the next round", "what is far worse bends the fit",
    )  # fmt: skip
    starts: int = threshold(6, "robust fits", "before anything is decided, at most", "run time")
    redescends: float = threshold(8.0, "robust standard deviations", "beyond which a row hardly counts in them", "as `least`")
    fewest_blocks: int = threshold(6, "poses", "with fewer nothing is called wrong by its neighbours", "chosen")
    common: float = threshold(
        0.9, "share of squares", "of displacements along one axis that makes flagged rows a common cause", "chosen: nearly all",
    )  # fmt: skip
    common_size: float = threshold(30.0, "robust standard deviations", "up to which a common cause is thought of", "chosen")
    common_poses: int = threshold(3, "poses", "in which a common cause shows at least", "two alike may be chance")
    down_weighted: float = threshold(
        0.35, "weight by Student's t", "below which a row is down-weighted; above, it counts in full", "chosen",
    )  # fmt: skip
    tails_at_most: float = threshold(0.04, "share of rows", "that may be down-weighted", "more are structure")
    sparse: float = threshold(
        0.25, "share of rows", "in which play of an axis shows at most to be told from an effect that bends many poses", "chosen",
    )  # fmt: skip
    along: float = threshold(0.97, "cosine", "of a displacement with what play does there", "14 degrees")
    force_factor: float = threshold(30.0, "times", "between the force of a row and that of its load case elsewhere", "chosen")
    elsewhere_rad: float = threshold(
        0.1, "rad", "of joint angles from those of their pose at least", "near a singularity a wrist turns by 0.02 within a pose",
    )  # fmt: skip
    elsewhere_usual: float = threshold(20.0, "times what is usual", "of joint angles from those of their pose at least", "chosen")
    not_there_usual: float = threshold(
        20.0, "times what is usual", "of the TCP or the marker of a pose from where its joint angles put it", "chosen",
    )  # fmt: skip
    seen_there: float = threshold(
        0.5, "of the way", "that joint angles say a marker moved within a pose, by which it may have been seen elsewhere",
        "chosen: a wrong row is off by all of it",
    )  # fmt: skip
    seen_there_m: float = threshold(5e-3, "m", "the same at least", "more than a robot gives way between two load cases")
    elsewhere_sigmas: float = threshold(
        6.0, "robust standard deviations", "from the usual distance of a load case, where that is far from the pose's other rows",
        "a tool that is aligned as it comes to rest stands otherwise in all references",
    )  # fmt: skip
    same_joints_rad: float = threshold(2e-3, "rad", "within which joint angles are taken for those of another pose", "chosen")
    nest_m: float = threshold(0.02, "m", "further off, another nest is likelier than a knock", "chosen: the size of a reflector")


@dataclass(frozen=True)
class ForceThresholds(Thresholds):
    """What the scatter of force readings within a load case is taken for."""

    fewest: int = threshold(5, "poses", "of a load case, for its readings to have a usual value", "a median of fewer is any")
    outside: float = threshold(6.0, "robust standard deviations", "beyond which a reading is no scatter", "an accident, or meant")
    believed: float = threshold(
        0.5, "share of the scatter", "standard deviation of the share that is noise, about what the session states",
        "stated within a factor of two",
    )  # fmt: skip
    factor: float = threshold(2.0, "times", "the stated noise that readings have at most", "stated within a factor of two")
    least: float = threshold(0.2, "share of the scatter", "that may be noise, below which none is left out", "it is little")
    rounds: int = threshold(4, "rounds", "of finding that share, and the rows that have other causes", "it settles in three")


@dataclass(frozen=True)
class ReadingsThresholds(Thresholds):
    """What readings at the references, where nothing touches the tool, are held against."""

    mass_kg: float = threshold(
        5.0, "kg", "standard deviation of a wrong tool mass before it is looked at", "chosen: a gripper or a spindle more or less"
    )
    bias_n: float = threshold(20.0, "N", "standard deviation of a bias of the sensor", "chosen: drift since it was zeroed")
    fewest: int = threshold(3, "references", "with fewer a bias is not told from a mass", "three components of a bias")


IDENTIFIABILITY = IdentifiabilityThresholds()
ABSOLUTE = AbsoluteThresholds()
OUTLIERS = OutlierThresholds()
READINGS = ReadingsThresholds()
FORCES = ForceThresholds()
