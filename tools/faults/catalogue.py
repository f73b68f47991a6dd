# SPDX-License-Identifier: Apache-2.0
"""The faults, the phases in which they begin, and what is expected of each."""

from __future__ import annotations

from dataclasses import dataclass

DRIVER, OUTSIDE = "driver", "outside"  # where a fault is made: in the simulated driver, or to processes


@dataclass(frozen=True)
class Fault:
    """One fault of the procedure's side.

    Attributes:
        cause: pattern that a diagnostic, a status or the verdict has to contain.
        holds: the robot may go on pressing in place, under control, while the fault lasts.
        harmless: the run may go on as if nothing had happened.
        persists: stays until the run has ended; it acts only later where the phase is an early one.
        from_phase: index of the first phase in which it can be noticed at all; earlier it may pass or act later.
    """

    name: str
    where: str
    cause: str
    holds: bool = False
    harmless: bool = False
    persists: bool = False
    silent: bool = False  # the process that fails can't say so: nobody hears of it any more


PHASES: dict[str, tuple[str, ...]] = {
    "approach": ("home", "approach"),
    "reference": ("reference",),
    "contact": ("contact",),
    "pressing": ("settle",),
    "retract": ("retract",),
    "between poses": ("home", "approach"),
}

FAULTS = (
    Fault("tracker beam", DRIVER, r"marker|tracker|line of sight", holds=True, harmless=True),
    Fault("tracker jump", DRIVER, r"marker|tracker|slipped", holds=True, harmless=True),
    Fault("tracker frozen", DRIVER, r"tracker/point: .*repeated to the last bit|does the tracker repeat a held point"),
    Fault("force saturated", DRIVER, r"limit 1600 N|its range is|wrench"),
    Fault("force biased", DRIVER,
          r"(before|out of) contact the wrench reads|wrench reads wrongly|left its set point|wrong sign|off its set point"
          r"|does not follow",
          harmless=True, persists=True),
    Fault("force NaN", DRIVER, r"wrench: the force is \(nan"),
    Fault("force silent", DRIVER, r"no force readings|wrench is silent", persists=True),
    Fault("force late", DRIVER, r"wrench is late|wrench: the stamp|no force readings", harmless=True, persists=True),
    Fault("force frozen", DRIVER, r"wrench: .*repeated to the last bit"),
    Fault("joints gap", DRIVER, r"no joints readings|joint_states is silent", persists=True),
    Fault("joints length", DRIVER, r"joint_states: 7 names with 3 positions"),
    Fault("joints names", DRIVER, r"joint_states: there is no 'joint_1'"),
    Fault("rail elsewhere", DRIVER, r"joint_states: ext_rail has moved"),
    Fault("slip", DRIVER, r"slip|force|contact", holds=True, harmless=True, persists=True),
    Fault("contact missed", DRIVER, r"no contact|left its set point|moves away|force", harmless=True, persists=True),
    Fault("mode refused", DRIVER, r"mode selector", harmless=True, persists=True),
    Fault("e-stop", DRIVER, r"fault"),
    Fault("clock forward", DRIVER, r"clock"),
    Fault("clock back", DRIVER, r"clock"),
    Fault("partition", DRIVER, r"silent|stands still|no .* readings|gone", persists=True),
    Fault("SIGKILL procedure", OUTSIDE, r"no force set point came", silent=True),
    Fault("SIGSTOP procedure", OUTSIDE, r"no force set point came|silent|held up|stands|was set", harmless=True, silent=True),
    Fault("SIGKILL driver", OUTSIDE, r"silent|no .* readings|stands still", persists=True),
    Fault("SIGSTOP driver", OUTSIDE, r"silent|no .* readings|stands still"),
    Fault("SIGKILL calibration", OUTSIDE, "", harmless=True, silent=True, holds=True),
    Fault("SIGSTOP calibration", OUTSIDE, "", harmless=True, silent=True, holds=True),
    Fault("recorder dead", OUTSIDE, "", harmless=True, silent=True, holds=True),
    Fault("disk full", OUTSIDE, r"recording has failed", persists=True),
    Fault("two procedures", OUTSIDE, r"another procedure may be driving", harmless=True, holds=True),
)  # fmt: skip


@dataclass(frozen=True)
class CorrectionFault:
    """One fault of the correction's side.

    Attributes:
        cause: pattern that state or diagnostics have to contain. ends: states that are right in the end.
    """

    name: str
    cause: str
    ends: tuple[int, ...] = (5,)
    silent: bool = False


INACTIVE, RAMP_IN, ACTIVE, HOLD, FADE, FAULT = range(6)
CORRECTION_PHASES = {"ramp in": RAMP_IN, "active": ACTIVE, "hold": HOLD, "fade": FADE}
CORRECTION_FAULTS = (
    CorrectionFault("force silent", "no wrench|wrench_stale", (FAULT,)),
    CorrectionFault("force frozen", "repeats one reading|wrench_frozen", (FAULT,)),
    CorrectionFault("force NaN", "NaN|wrench_not_finite", (FAULT,)),
    CorrectionFault("force saturated", "beyond the sensor's range|wrench_range", (FAULT,)),
    CorrectionFault("force jump", "jumped|identified up to|wrench_jump", (ACTIVE, RAMP_IN, FAULT, FADE)),
    CorrectionFault("force late", "wrench is stamped|wrench_clock", (FAULT,)),
    CorrectionFault("force frame", "frame 'base_link'|wrench_frame", (FAULT,)),
    CorrectionFault("joints gap", "no joint state|joints_stale", (FAULT,)),
    CorrectionFault("joints length", "joint angles came in|joints_names", (FAULT,)),
    CorrectionFault("joints names", "joint angles came in|joints_names|joints_jump", (FAULT,)),
    CorrectionFault("joints NaN", "joint angles hold NaN|joints_not_finite", (FAULT,)),
    CorrectionFault("joints jump", "jumped|identified for|joints_jump", (FAULT, FADE, ACTIVE, RAMP_IN)),
    CorrectionFault("joints outside", "identified for|outside_joints|joints_jump", (FADE, FAULT)),
    CorrectionFault("rail NaN", "rail is nan|joints_not_finite", (FAULT,)),
    CorrectionFault("rail elsewhere", "the rail is at|rail_range", (FAULT,)),
    CorrectionFault("other sender", "publishers of|fault.other_sender", (FAULT,)),
    CorrectionFault("robot changed", "robot_description|robot_changed", (FAULT,)),
    CorrectionFault("clock forward", "stamped|_clock", (FAULT,)),
    CorrectionFault("clock back", "stamped|_clock", (FAULT,)),
    CorrectionFault("partition", "no wrench|no joint state|_stale", (FAULT,)),
    CorrectionFault("model refused", "serial|belongs|identified", (ACTIVE, RAMP_IN, FAULT)),
    CorrectionFault("model file changed", "changed after it was put in force", (ACTIVE, RAMP_IN, FAULT)),
    CorrectionFault("SIGSTOP correction", "stale|no wrench|no joint state|stamped|_clock|held_up|no tick for",
                    (ACTIVE, FAULT, RAMP_IN, HOLD, FADE), silent=True),
    CorrectionFault("SIGKILL correction", "", (INACTIVE,), silent=True),
)  # fmt: skip

# while calibration_node solves, or is asked to; the robot stands retracted
SOLVE_FAULTS = (
    "path not writable", "disk full", "session gone", "session altered", "session damaged", "SIGKILL calibration",
    "SIGSTOP calibration", "SIGKILL procedure",
)  # fmt: skip
