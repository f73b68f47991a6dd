# SPDX-License-Identifier: Apache-2.0
"""Section `dynamics` of a truth file: what a plant has beyond statics, and how each cause of it is switched off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from ..cellfile import CellFile
from ..errors import SimError
from ..files import read_yaml
from ..truth import Truth, read_truth


@dataclass(frozen=True)
class Modes:
    """Structural modes of arm and head.

    Attributes:
        damping: of each mode from the lowest on, share of critical; the last one holds for all further ones.
        highest: Hz, modes above it answer at once.
        gyration: m, radii of gyration of each link and then of the tool about the axes of its own frame (of the mount for the
            tool) through its centre of mass, (joints + 1, 3).
    """

    damping: tuple[float, ...] = (0.05,)
    highest: float = 45.0
    gyration: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class Channel:
    """Way of an offset from the computer to the motors.

    Attributes:
        delay: s, of the transport; jitter: s, largest further delay of a packet, drawn evenly; cycle: s, in which the controller
            takes offsets; servo, servo_damping: of the position servo as a second-order system, Hz and share of critical.
    """

    delay: float = 0.008
    jitter: float = 0.004
    cycle: float = 0.004
    servo: float = 14.0
    servo_damping: float = 0.9


@dataclass(frozen=True)
class ForceSensor:
    """Dynamics of the force sensor; crosstalk and alignment are effects of the truth.

    Attributes:
        bandwidth: Hz, first order; delay: s, of its transport; noise: N per sample and axis; drift: N, of the bias since it was
            zeroed, one standard deviation per axis; folds: whether what lies above half its rate shows in its samples.
    """

    bandwidth: float = 73.0
    delay: float = 0.004
    noise: float = 1.5
    drift: float = 4.0
    folds: bool = True


@dataclass(frozen=True)
class DynamicTracker:
    """How the moving tool is measured: noise: m per sample and axis; slow: m, of air and the target's frame over seconds;
    rate: Hz, at which the part is judged."""

    noise: float = 15e-6
    slow: float = 10e-6
    rate: float = 250.0


@dataclass(frozen=True)
class Warm:
    """How much warmer than in calibration production runs, K: gears, gas of the counterbalance."""

    gears: float = 0.0
    gas: float = 0.0


@dataclass(frozen=True)
class Hard:
    """A truth with dynamics.

    Attributes:
        modes, channel, sensor, tracker: None: without (no modes, an offset that acts at once, an ideal sensor, no noise).
        process: what the process does, as `process.py` reads it.
        ripple: share of the process's unsteady force that is left, 0 .. 1.
    """

    truth: Truth
    modes: Modes | None
    channel: Channel | None
    sensor: ForceSensor | None
    tracker: DynamicTracker | None
    warm: Warm
    process: dict[str, Any] = field(default_factory=dict)
    ripple: float = 1.0


def read_hard(path: str | Path, cell: CellFile, seed: int = 0) -> Hard:
    """Read a truth file with a section `dynamics`.

    Raises:
        SimError: not a truth file, no such section, or a key that is not known.
    """
    truth = read_truth(path, cell.name, seed, cell.chain.effort)
    section = read_yaml(path, "truth file").get("dynamics")
    if not isinstance(section, dict):
        raise SimError(f"{path}: no section 'dynamics'; config/truths/case_afp.yaml has one")
    parts: dict[str, Any] = {}
    kinds = {"modes": Modes, "channel": Channel, "sensor": ForceSensor, "tracker": DynamicTracker, "warm": Warm}
    unknown = set(section) - set(kinds) - {"process"}
    if unknown:
        raise SimError(f"{path}: dynamics: '{sorted(unknown)[0]}' is not known; there are {', '.join(kinds)}, process")
    for name, kind in kinds.items():
        given = section.get(name) or {}
        known = {f.name for f in fields(kind)}
        if not isinstance(given, dict) or set(given) - known:
            raise SimError(f"{path}: dynamics: {name} has {sorted(given)}, it takes {', '.join(sorted(known))}")
        parts[name] = kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})
    return Hard(truth, process=dict(section.get("process") or {}), **parts)


def _without(*effects: str) -> Callable[[Hard], Hard]:
    return lambda hard: replace(hard, truth=hard.truth.without(*effects))


def _no_friction(hard: Hard) -> Hard:
    return replace(hard, truth=replace(hard.truth.without("joint_hysteresis"), friction=0.0))


# what can be switched off, by the name under which it is told: everything that makes a plant hard
CAUSES: dict[str, Callable[[Hard], Hard]] = {
    "gear friction": _no_friction,
    "gear play": _without("joint_backlash", "bearing_play", "flange_gap"),
    "gear curve": _without("joint_stiffening"),
    "creep": _without("creep"),
    "soft head": _without("tool_compliance"),
    "base and rail": _without("base_compliance", "rail_compliance"),
    "counterbalance": _without("counterbalance"),
    "gears that couple": _without("joint_coupling", "torque_product"),
    "warmth of production": lambda hard: replace(hard, warm=Warm(), truth=hard.truth.without("gear_heat", "thermal_drift")),
    "frame errors": _without("geometry_error", "station_registration", "marker_offset", "encoder_harmonics"),
    "hose pull": _without("external_force"),
    "sensor crosstalk and drift": lambda hard: replace(
        hard, truth=hard.truth.without("sensor_gain", "sensor_alignment", "tool_weight"),
        sensor=replace(hard.sensor, drift=0.0) if hard.sensor else None,
    ),
    "sensor noise and bandwidth": lambda hard: replace(
        hard, sensor=replace(hard.sensor, noise=0.0, delay=0.0, bandwidth=1e5, folds=False) if hard.sensor else None
    ),
    "latency and servo": lambda hard: replace(hard, channel=None),
    "structural modes": lambda hard: replace(hard, modes=None),
    "unsteady process force": lambda hard: replace(hard, ripple=0.0),
    "tracker noise in motion": lambda hard: replace(
        hard, tracker=replace(hard.tracker, noise=0.0, slow=0.0) if hard.tracker else None
    ),
}  # fmt: skip


def without(hard: Hard, *causes: str) -> Hard:
    """The same plant with some causes switched off.

    Raises:
        SimError: a cause that is not known.
    """
    for cause in causes:
        if cause not in CAUSES:
            raise SimError(f"cause '{cause}' is not known; there are {', '.join(CAUSES)}")
        hard = CAUSES[cause](hard)
    return hard
