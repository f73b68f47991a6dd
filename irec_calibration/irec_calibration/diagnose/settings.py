# SPDX-License-Identifier: Apache-2.0
"""Every threshold of the diagnosis in one place: unit, meaning, how it was derived. Printed into diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass

from ..declared import Thresholds, threshold
from ..identification.settings import (
    ABSOLUTE,
    FORCES,
    IDENTIFIABILITY,
    OUTLIERS,
    READINGS,
    AbsoluteThresholds,
    ForceThresholds,
    IdentifiabilityThresholds,
    OutlierThresholds,
    ReadingsThresholds,
)  # fmt: skip
from ..identification.validation import FEWEST_POSES


@dataclass(frozen=True)
class LastingThresholds(Thresholds):
    """What absolute readings have beyond the controller's positions, where it is asked whether a step lasts: standard deviations.

    Derived from what robots after geometric calibration leave.
    """

    place_m: float = threshold(3e-4, "m", "place of the station, and of the marker on the tool", "prior")
    angle_rad: float = threshold(3e-4, "rad", "of the station, joint zeros, and tilts of axes", "prior")
    elsewhere_m: float = threshold(0.1, "m", "place of the marker on the tool, stated wrongly", "prior: any on the tool")
    drifts_m: float = threshold(3e-4, "m", "drift over the session, and how it bends, that may be a cause", "prior: a warm-up")
    turned_rad: float = threshold(0.03, "rad", "of the station, stated wrongly", "prior: two degrees")
    tilt_rad: float = threshold(1e-3, "rad", "of a station that was bumped", "prior: a millimetre at the foot of a tripod")
    periodic_rad: float = threshold(1e-4, "rad", "of joint angles, with the angle", "prior")
    soft: float = threshold(1e-7, "rad/(N m)", "of axes under gravity", "prior")
    course_m: float = threshold(3e-5, "m", "drift over the session", "prior")
    pose_m: float = threshold(1e-4, "m", "of a pose by itself, the same each time", "prior; none, a third and three times too")
    level_m: float = threshold(
        2e-5, "m", "least scatter of a pose's mean that is tried", "a tracker's noise; twelve more, each twice the one before",
    )  # fmt: skip
    fewest: int = threshold(3, "poses", "before and after a step; with fewer it is not asked", "with two, one bad pose decides")
    farthest: float = threshold(
        5.0, "standard errors", "between a value that readings show and that of differences, beyond which it is another cause's",
        "other causes bend differences; at five not even these make them one",
    )  # fmt: skip


@dataclass(frozen=True)
class FlexibleThresholds(Thresholds):
    """The flexible regression that says how much any smooth cause could still remove."""

    fewest_poses: int = threshold(12, "poses", "with fewer it is not tried", "two in each fold")
    folds: int = threshold(6, "folds", "of poses", "five sixths train, one sixth judges")
    most_rows: int = threshold(900, "rows", "used at most", "run time; more make it no better")
    length: float = threshold(
        1.5, "standard deviations of a variable", "length of the kernel, times the square root of their number", "chosen: smooth",
    )  # fmt: skip


@dataclass(frozen=True)
class ProposalThresholds(Thresholds):
    """Measurements that are proposed."""

    sigmas_to_tell: float = threshold(
        3.0, "standard deviations", "by which a sample must differ to tell two explanations apart", "odds of 90 on one sample",
    )  # fmt: skip
    most_repeats: int = threshold(20, "repeats", "of one sample at most, else it is not proposed", "nobody would take more")
    poses_to_tell: int = threshold(4, "poses", "that are proposed to be measured twice to learn the noise",
                                   "with three load cases 36 degrees of freedom: a level within 12 %")  # fmt: skip
    new_poses: int = threshold(2, "per measured pose", "new poses that are tried", "run time")
    spread_rad: float = threshold(0.35, "rad", "how far new poses lie from measured ones", "20 degrees: near, so reached")
    at_most: int = threshold(5, "measurements", "proposed", "what fits on a page")


@dataclass(frozen=True)
class LawThresholds(Thresholds):
    """Laws that stand in for what has no name."""

    most: int = threshold(5, "laws", "in a model", "each has evidence of its own; more help nobody to find a cause")
    refitted: int = threshold(3, "laws", "of the likeliest that hold in regions, refitted each time", "run time")
    of_a_length: int = threshold(
        3, "laws", "of one number of terms that are tried", "a long one may go wrong where a short one holds",
    )  # fmt: skip
    least_apart: float = threshold(
        1e-4, "of the square of a law", "that no other term and no spring makes up for",
        "with less, large terms cancel: on an outside simulator such a law doubled the error under other loads",
    )  # fmt: skip
    poses_per_angle: float = threshold(
        6.0, "poses", "for each function of joint angles that a law has",
        "a pose says one value of it; on an outside simulator laws of two joints described 14 poses and no others",
    )  # fmt: skip
    worth: float = threshold(0.01, "of the error on held-out poses", "by which it has to fall", "less helps no correction")
    most_often: float = threshold(
        3.0, "per turn", "of an axis that turns by its own angle where nothing presses",
        "a single order of a ripple, found on one series of a measured UR10, did harm on the others",
    )  # fmt: skip
    beside_course: float = threshold(
        0.5, "of the evidence", "of a structure that follows time or a temperature that a law needs that follows neither",
        "less, and it describes by chance what passes with time",
    )  # fmt: skip
    far_off: float = threshold(
        3.0, "times the median region", "that a region may gain or lose by a law, beyond which it counts no more",
        "a region beyond all others is extrapolated to, which the envelope of a model never is",
    )  # fmt: skip
    most_of_deflection: float = threshold(
        0.5, "of the deflection", "that a law may move", "one that moves more undoes springs, and is far off under other loads",
    )  # fmt: skip


@dataclass(frozen=True)
class Settings(Thresholds):
    """Thresholds of a diagnosis; `nats` are natural logarithms of odds."""

    noise_dof: float = threshold(
        4.0, "equations", "how much the stated noise level counts",
        "the level is known within a factor of two at two standard deviations: 1 / sqrt(2 dof) = 0.35",
    )  # fmt: skip
    nats_to_name: float = threshold(
        6.5, "nats", "evidence that a name needs over every model without it",
        "odds of 600, so that 25 effects give a wrong name in less than 5 % of clean sessions",
    )  # fmt: skip
    nats_over_structure: float = threshold(
        4.0, "nats", "evidence that a name needs over nonparametric structures in its place",
        "odds of 50, against the best of some 500 whose number is taken off; that something is there is asked before",
    )  # fmt: skip
    nats_plainly: float = threshold(
        25.0, "nats", "by which the linear problem needs an effect that is not taken out to see what a refit makes of it",
        "chosen: four times what a name needs",
    )  # fmt: skip
    nats_to_stand_in: float = threshold(
        2.3, "nats", "evidence that an effect needs to be part of an improved model without a name, where no structure is left",
        "odds of 10: likelier there than not, even if before the session it was as rare as one in eleven",
    )  # fmt: skip
    nats_for_sag: float = threshold(
        2.3, "nats", "log odds at which the arm is taken to sag otherwise on its way than the masses of its description say",
        "odds of 10; the share has a prior about 1, within a factor of two",
    )  # fmt: skip
    nats_in_one_pose: float = threshold(
        20.0, "nats", "evidence that a name needs which shows in the differences of one pose of a loaded session only",
        "a bad pose is far more common than a bumped station; the absolute readings of later poses count with it",
    )  # fmt: skip
    nats_for_two: float = threshold(
        50.0, "nats", "evidence of structure that has no name, and of an effect by itself, to try two together",
        "far beyond any threshold for names: what is left then is no matter of form",
    )  # fmt: skip
    nats_to_separate: float = threshold(
        5.0, "nats", "explanations closer than this are not told apart", "odds of 150",
    )  # fmt: skip
    nats_to_prefer: float = threshold(
        2.3, "nats", "by which one of two values or readings is preferred", "odds of 10",
    )  # fmt: skip
    nats_over_rival: float = threshold(
        5.0, "nats", "a name needs over every other effect in its place; closer ones are given as one of several",
        "what is told apart; of 8 names in 286 sessions that were preferred by 2.3 to 5, 2 were wrong",
    )  # fmt: skip
    nats_for_form: float = threshold(
        4.6, "nats", "evidence against what completes the form of springs (`bending_place`), above which a model is without it",
        "prior odds of 100: every robot has it to some extent",
    )  # fmt: skip
    share_of_rival: float = threshold(
        0.5, "share of evidence", "of the name, that a rival must bring by itself, without what has no name beside it",
        "less than half, and it is nonparametric structure that stands in the name's place",
    )  # fmt: skip
    share_of_own: float = threshold(
        0.5, "share of evidence", "of a rival in a name's place, that it brings beside the name where it has a cause of its own",
        "as much as `share_of_rival`",
    )  # fmt: skip
    nats_to_refit: float = threshold(
        15.0, "nats", "effects this much worse than the best are not fitted exactly", "three times what is told apart",
    )  # fmt: skip
    share_to_name: float = threshold(
        0.02, "share of squares",
        "of what another name explains, below which a name must stand beside any deviation of that one's form",
        "an effect whose form is not quite right leaves 1 % of its square to be explained by another",
    )  # fmt: skip
    share_of_second_law: float = threshold(
        0.1, "share of evidence",
        "of play or stiffening of an axis without the other, that the other of the same axis must bring to be named beside it;"
        " and of friction in gears, that creep and a hose beside it must bring more",
        "a form that is a third off: gears follow neither exactly, and the second may only mend the first",
    )  # fmt: skip
    form_error: float = threshold(
        0.1, "share of displacement",
        "by which an effect may deviate from its form along any smooth function of a session's variables",
        "1 % of its square",
    )  # fmt: skip
    nats_per_bad_row: float = threshold(
        1.0, "nats", "more evidence that a name needs for each row, reference or pose that stands out",
        "where rows stand out, tails are heavy, and evidence that counts on normal noise is too large",
    )  # fmt: skip
    most_put_aside: float = threshold(
        0.1, "share of readings", "that stand out and count for nothing, above which something systematic is behind them",
        "more than the tails of an instrument: one reading in ten beyond them is a second instrument, or a cause",
    )  # fmt: skip
    most_poses_aside: float = threshold(
        0.15, "share of poses", "that stand out as a whole or by their references, above which they are hardly accidents",
        "chosen: a base whose bolts lift had 0.18 on an outside simulator, four poses of 31 may be knocked",
    )  # fmt: skip
    most_of_gain: float = threshold(
        0.3, "share of the reading", "by which the gain of a force sensor may change up to its largest load, in what has no name",
        "data sheets say 0.01; a sensor that is worse by thirty times is broken, and would pass for one that is mounted turned",
    )  # fmt: skip
    several: int = threshold(
        3, "rows, references or poses", "that stand out at least, before their share says anything",
        "one or two are bad luck in a session of any length",
    )  # fmt: skip
    several_as_a_whole: int = threshold(
        2, "poses", "that stand out in all load cases, each by itself, which are hardly accidents",
        "of 9 sessions of three outside simulators with two such poses, 8 had a cause outside of the catalogue, one a bumped"
        " station",
    )  # fmt: skip
    nats_of_accident: float = threshold(
        40.0, "nats", "evidence that a row or a reference stands out, from which it is an accident before causes are weighed",
        "chosen: twice what a name needs that one pose shows",
    )  # fmt: skip
    accident_size: float = threshold(
        3.0, "times the largest other residual", "from which such a row is one",
        "causes that are missing bend more than one reading",
    )  # fmt: skip
    share_of_form: float = threshold(
        0.03, "share of evidence", "of the nonparametric structures that a name replaces, that it must bring more than they do",
        "polynomials of the generic family lose that much where they stand for a cause of another form",
    )  # fmt: skip
    share_between_laws: float = threshold(
        0.05, "share of evidence", "of a law of an axis' torque, that it must bring more than another such law in its place",
        "chosen on three simulators: the wrong one of play and stiffening was never preferred by this and 5 nats",
    )  # fmt: skip
    share_beside: float = threshold(
        0.25, "share of evidence", "that a base or links bring more than the gears (`Effect.beside`) to be named without them",
        "chosen; a base was named on a measured robot whose gears explain as much",
    )  # fmt: skip
    share_feigned: float = threshold(
        0.05, "share of evidence", "of a structure that has no name, that it may lend to any name, however unlike",
        "chosen above `share_of_form`; without it play was named on a measured robot of which most has no name",
    )  # fmt: skip
    share_beside_friction: float = threshold(
        0.5, "share of evidence", "of creep or a hose beside friction that may deviate from its form, that counts for its name",
        "chosen; where both were there, evidence of 20 to 240 was left, in sessions with friction alone 2",
    )  # fmt: skip
    share_of_same_course: float = threshold(
        0.33, "share of evidence", "of a drift, above which structure with the load and what the drift follows leaves no drift",
        "chosen; gears that soften as they warm up were called thermal drift on an outside simulator, at 0.65",
    )  # fmt: skip
    share_of_same_form: float = threshold(
        0.05, "share of evidence", "of a compliance that goes with its axis' angle, above which more of it beside leaves no name",
        "chosen; a gear whose compliance ripples was called a counterbalance on an outside simulator, at 0.09",
    )  # fmt: skip
    nats_for_structure: float = threshold(
        6.5, "nats", "evidence of the strongest such structure, the number tried taken off, that makes a session unexplained",
        "odds of 600: four kinds of structures are tried, so that noise passes for one in less than 1 % of clean sessions",
    )  # fmt: skip
    usual_structure: float = threshold(
        0.013, "1", "of the deflection: structure that gears of every robot leave, and no cause, in a loaded session",
        "chosen; sound gears of an outside simulator (friction, creep, a soft range) left 0.6 to 1.27 %, causes 1.6 and more",
    )  # fmt: skip
    usual_beside_noise: float = threshold(
        1 / 3, "1", "of the noise, beyond which it is no longer that", "chosen; there 0.24 to 0.27, causes 0.4 and more",
    )  # fmt: skip
    nats_for_wander: float = threshold(
        5.0, "nats", "likelihood that noise correlated in time must gain over independent noise",
        "two parameters are fitted: by chance twice the gain is chi squared of two, above 10 in less than 1 % of sessions",
    )  # fmt: skip
    most_wandering: float = threshold(
        3.0, "times the stated noise", "RMS of what wanders in a loaded session, above which something moves",
        "the level is known within a factor of two; of 300 sessions without such a cause none wandered by more than 1.8",
    )  # fmt: skip
    misplaced_m: float = threshold(
        2e-3, "m", "from where a known station is stated to where it is found, beyond which it is said",
        "three times what links of calibrated robots are off by",
    )  # fmt: skip
    wander_to_doubt: float = threshold(
        0.5, "share of variance", "of noise that wanders, above which a model is built without it too",
        "chosen: 0.85 or 0.95 where a step or a drift had been taken for such noise; run time",
    )  # fmt: skip
    held_out_sigmas: float = threshold(
        1.5, "standard errors over poses", "by which the held-out loss must fall with a name of least evidence",
        "one-sided 7 %, beside the evidence",
    )  # fmt: skip
    most_names: int = threshold(
        8, "effects", "names at most", "measured robots show five to ten causes",
    )  # fmt: skip
    most_structures: int = threshold(
        8, "structures", "parts of a nonparametric remainder at most", "run time",
    )  # fmt: skip
    refits: int = threshold(
        3, "effects", "candidates fitted exactly at each step", "run time",
    )  # fmt: skip
    repeats_p: float = threshold(
        1e-4, "probability", "below which repeats say that the model does not fit", "one false alarm in 10 000 sessions",
    )  # fmt: skip
    flexible_sigmas: float = threshold(
        4.0, "standard errors over poses", "by which a flexible regression must gain on held-out poses",
        "heavy tails allowed for",
    )  # fmt: skip
    fewest_poses: int = threshold(
        FEWEST_POSES, "poses", "with fewer nothing is named", "nothing can be tested on other poses",
    )  # fmt: skip

    nats_to_prove_part: float = threshold(
        6.5, "nats", "evidence of its own that an axis or direction needs to be named", "odds of 600, as the name of an effect",
    )  # fmt: skip
    nats_within_reach: float = threshold(
        5.0, "nats", "sets of parts that explain the session this much worse than the best are not told from it", "odds of 150",
    )  # fmt: skip
    share_to_prove_part: float = threshold(
        0.02, "share of squares", "of what the effect explains that a part must bring to be named",
        "a smaller part may make up for an effect's form that is not quite right",
    )  # fmt: skip
    times_to_outweigh: float = threshold(
        3.0, "times the evidence needed", "evidence of a name that larger structure which has none does not outweigh",
        "beside larger structure that has no name right names had 2.1 and 4 to 9 times what they need, wrong ones 1.1 to 2.1",
    )  # fmt: skip
    weigh_again_below: float = threshold(
        0.7, "of the noise assumed", "noise that is left below which everything is weighed again",
        "evidence goes with the square: twice as much at 0.7",
    )  # fmt: skip
    fewest_repeats: int = threshold(
        6, "degrees of freedom", "with fewer, repeats say nothing by themselves", "a level from 6 is known within 30 %",
    )  # fmt: skip
    stated_p: float = threshold(
        1e-3, "probability", "below which repeats are said to disagree with the noise that is stated",
        "one false remark in 1000 sessions",
    )  # fmt: skip
    quieter_than_stated: float = threshold(
        0.5, "of the stated variance", "below which the residual is said to be smaller than the stated noise allows",
        "a standard deviation 30 % smaller",
    )  # fmt: skip
    where_p: float = threshold(
        0.05, "probability", "corrected for all places, below which a place where the residual is, is told", "one in 20 sessions",
    )  # fmt: skip
    where_share: float = threshold(
        0.01, "share of squares", "of the residual that such a place must hold", "less helps nobody to find a cause",
    )  # fmt: skip
    where_poses: int = threshold(
        5, "poses", "with fewer no place is told", "5 poses have 32 sets of signs",
    )  # fmt: skip

    absolute_gain: float = threshold(
        0.01, "of the error on held-out poses", "by which it has to fall with a name none of whose parts is proven (absolute)",
        "on an outside simulator a hose, none of ten parts of which was proven, described the teeth of a gear and gained 0.2 %",
    )  # fmt: skip
    unproven_beside: float = threshold(
        3.0, "times the structure left", "that a name none of whose parts is proven has to explain on held-out poses (loaded)",
        "a tenth of its squares is what is left then; friction of 136 um, of which no axis was sure, was no name beside 12 um",
    )  # fmt: skip

    nats_to_take_in: float = threshold(
        3.0, "nats", "that a structure needs, the number tried taken off, to be taken into a nonparametric remainder",
        "odds of 20: a remainder is no claim, and names must hold against it",
    )  # fmt: skip
    nats_to_depend: float = threshold(
        3.0, "nats", "structures this close to the strongest one name what a residual depends on too", "odds of 20",
    )  # fmt: skip
    most_depended_on: int = threshold(4, "variables", "that a residual is said to depend on", "more help nobody to find a cause")
    forms_of_cause: int = threshold(
        6, "parts", "that are no axes, with more of which an effect of a loaded session is left out where none is proven",
        "chosen: what was no hose had each of 15",
    )  # fmt: skip
    share_of_guess: float = threshold(
        0.33, "of what all names explain", "of which an effect that would be left out so explains no more",
        "on outside simulators hoses in many forms explained 0.5 to 1 of it, and what was none 0.04",
    )  # fmt: skip
    nats_of_guess: float = threshold(
        100.0, "nats", "of which it explains no more, in any case", "those hoses explained 350 and more; chosen",
    )  # fmt: skip
    parameters_of_pose: int = threshold(
        3, "parameters", "for each pose of a loaded session, with more of which an effect without a proven part is left out",
        "they describe any displacement that a pose has by itself",
    )  # fmt: skip
    where_typical: float = threshold(
        3.0, "times the typical residual", "of a pose or load case that is said to stand out", "three standard deviations",
    )  # fmt: skip

    readings: ReadingsThresholds = READINGS
    forces: ForceThresholds = FORCES
    lasting: LastingThresholds = LastingThresholds()
    flexible: FlexibleThresholds = FlexibleThresholds()
    proposed: ProposalThresholds = ProposalThresholds()
    laws: LawThresholds = LawThresholds()
    absolute: AbsoluteThresholds = ABSOLUTE
    identifiability: IdentifiabilityThresholds = IDENTIFIABILITY
    outliers: OutlierThresholds = OUTLIERS


SETTINGS = Settings()
