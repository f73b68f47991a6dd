# SPDX-License-Identifier: Apache-2.0
"""Torsional stiffness of a joint from motor encoder, link encoder and motor torque over time, or that the data can't tell it.

What the two encoders disagree by is not elastic to begin with: channels that are logged with a delay between them disagree in
proportion to velocity. So that comes first. Then

    motor - link = offset + skew * velocity + c * torque (+ a * acceleration + s * sign(velocity)) (+ periodic encoder errors)

with c the compliance, acceleration for the motor's own inertia that the motor torque carries, sign for backlash and
friction. Samples of one trajectory share whatever is wrong with it, so trajectories are the units of statistics; and the
compliance counts as identified only where every variant of the nuisances in brackets gives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter
from scipy.special import chdtrc, stdtrit

from ..errors import SolveError
from ..typing import Array, BoolArray

BLOCKS = 6  # units that a single trajectory is cut into
CONFIDENCE = 0.95
SLOW = 0.01  # rad/s; below it the sign of the velocity is not sharp
WINDOW = 11  # samples of the smoothing differentiator
FEWEST_SAMPLES = 100
VARIANTS = {
    "plain": (),
    "inertia": ("acceleration",),
    "inertia, friction": ("acceleration", "sign"),
    "inertia, friction, encoder": ("acceleration", "sign", "sin", "cos"),
}


@dataclass(frozen=True)
class Trajectory:
    """One recording; n samples at equal steps, k axes.

    Attributes:
        step: s between samples.
        motor, link: joint angle by the motor's and by the link's encoder, (n, k), rad.
        torque: motor torque carried to the link side of the gear, (n, k), N m.
    """

    name: str
    step: float
    motor: Array
    link: Array
    torque: Array


@dataclass(frozen=True)
class Known:
    """A value with its standard error over units."""

    value: float
    se: float


@dataclass(frozen=True)
class Axis:
    """What the recordings say about one axis.

    Attributes:
        skew_s: delay of the link channel behind the motor channel; by_unit: of each unit.
        compliance: rad/(N m) for each variant of the nuisances.
        identified: whether the compliance is known at all; why_not: in words otherwise.
        stiffness, stiffness_low, stiffness_high: N m/rad, from all variants; NaN where not identified.
        reversal_rad: half-width of what follows the sign of the velocity.
        residual_rad: RMS that no part of the fullest variant explains; spread_rad: RMS of the disagreement to begin with.
        torque: smallest and largest torque, N m.
    """

    number: int
    skew_s: Known
    skew_by_unit: tuple[float, ...]
    compliance: dict[str, Known]
    identified: bool
    why_not: str
    stiffness: float
    stiffness_low: float
    stiffness_high: float
    reversal_rad: Known
    spread_rad: float
    residual_rad: float
    skew_share: float
    torque: tuple[float, float]


@dataclass(frozen=True)
class JointStiffness:
    """All axes; axes without a link encoder are named in `silent`.

    Attributes:
        units: what the standard errors are taken over.
        common_skew_s, same_skew_p: weighted mean over the axes, and the probability of their scatter if the skew is the same
        on all.
    """

    axes: tuple[Axis, ...]
    silent: tuple[int, ...]
    units: tuple[str, ...]
    common_skew_s: Known
    same_skew_p: float
    notes: tuple[str, ...]


def joint_stiffness(trajectories: Sequence[Trajectory]) -> JointStiffness:
    """Skew and stiffness of every axis.

    Raises:
        SolveError: no axis has a link encoder that moves, or recordings are too short.
    """
    if not trajectories:
        raise SolveError("no recording is given")
    for t in trajectories:
        if len(t.motor) < FEWEST_SAMPLES:
            raise SolveError(f"{t.name}: {len(t.motor)} samples, at least {FEWEST_SAMPLES} are needed")
    k = trajectories[0].motor.shape[1]
    moves = [all(np.ptp(t.link[:, a]) > 1e-6 and np.ptp(t.motor[:, a]) > 1e-6 for t in trajectories) for a in range(k)]
    if not any(moves):
        raise SolveError("no axis has a link encoder that moves: nothing to compare the motor encoders with")
    notes = []
    if len(trajectories) == 1:
        units = [f"{trajectories[0].name} part {i + 1}" for i in range(BLOCKS)]
        notes.append(
            f"one recording only: its {BLOCKS} parts stand for independent trajectories, "
            "errors are too small rather than too large"
        )
    else:
        units = [t.name for t in trajectories]
    axes = tuple(_axis(trajectories, a) for a in range(k) if moves[a])
    w = np.array([1.0 / max(a.skew_s.se, 1e-9) ** 2 for a in axes])
    s = np.array([a.skew_s.value for a in axes])
    mean = float((w * s).sum() / w.sum())
    p = float(chdtrc(len(axes) - 1, (w * (s - mean) ** 2).sum())) if len(axes) > 1 else float("nan")
    # between axes rather than within one: their errors over few units are themselves uncertain
    se = float(s.std(ddof=1) / np.sqrt(len(s))) if len(s) > 1 else axes[0].skew_s.se
    silent = tuple(a + 1 for a in range(k) if not moves[a])
    return JointStiffness(axes, silent, tuple(units), Known(mean, se), p, tuple(notes))


def _axis(trajectories: Sequence[Trajectory], a: int) -> Axis:
    signals = [_signals(t, a) for t in trajectories]
    pieces = [(s, np.ones(len(s["d"]), dtype=bool)) for s in signals]
    if len(pieces) == 1:
        part = np.minimum(np.arange(len(signals[0]["d"])) * BLOCKS // len(signals[0]["d"]), BLOCKS - 1)
        pieces = [(signals[0], part == i) for i in range(BLOCKS)]
    found = {name: np.array([_fit(s, rows, extra) for s, rows in pieces]) for name, extra in VARIANTS.items()}
    compliance = {name: _over_units(f[:, 1]) for name, f in found.items()}
    fullest = found["inertia, friction, encoder"]
    skew = _over_units(fullest[:, 0])
    limit = float(stdtrit(len(pieces) - 1, 0.5 + 0.5 * CONFIDENCE))
    weak = [name for name, c in compliance.items() if not c.value > limit * c.se]
    means, errors = np.array([c.value for c in compliance.values()]), np.array([c.se for c in compliance.values()])
    middle = float(means.mean())
    total = float(np.hypot(0.5 * np.ptp(means), errors.mean()))
    why = ""
    if weak:
        scatter = ", ".join(f"{1e8 * v:.1f}" for v in found[weak[-1]][:, 1])
        why = (
            f"with {weak[-1]} taken out, the recordings give {scatter} x 1e-8 rad/(N m): no value different from zero at"
            f" {100 * CONFIDENCE:.0f} % (needs {limit:.1f} standard errors, "
            f"there are {abs(compliance[weak[-1]].value) / compliance[weak[-1]].se:.1f})"
        )
    elif total >= middle:
        why = "the variants of the nuisances disagree by as much as the value itself"
    identified = not why
    spread = float(np.sqrt(np.mean([np.var(s["d"][r]) for s, r in pieces])))
    return Axis(
        number=a + 1,
        skew_s=skew,
        skew_by_unit=tuple(float(v) for v in fullest[:, 0]),
        compliance=compliance,
        identified=identified,
        why_not=why,
        stiffness=1.0 / middle if identified else float("nan"),
        stiffness_low=1.0 / (middle + total) if identified else float("nan"),
        stiffness_high=1.0 / (middle - total) if identified else float("nan"),
        reversal_rad=_over_units(found["inertia, friction"][:, 2]),
        spread_rad=spread,
        residual_rad=float(np.sqrt((fullest[:, 3] ** 2).mean())),
        skew_share=float(fullest[:, 4].mean()),
        torque=(float(min(s["torque"].min() for s in signals)), float(max(s["torque"].max() for s in signals))),
    )


def _signals(t: Trajectory, a: int) -> dict[str, Array]:
    """Columns of one axis in one recording; derivatives from the motor encoder, smoothed alike."""
    q = t.motor[:, a]
    velocity = savgol_filter(q, WINDOW, 3, 1, t.step)
    return {
        "d": q - t.link[:, a],
        "velocity": velocity,
        "torque": savgol_filter(t.torque[:, a], WINDOW, 1),
        "acceleration": savgol_filter(q, 2 * WINDOW - 1, 3, 2, t.step),
        "sign": np.tanh(velocity / SLOW),
        "sin": np.sin(q),
        "cos": np.cos(q),
    }


def _fit(s: dict[str, Array], rows: BoolArray, extra: tuple[str, ...]) -> tuple[float, float, float, float, float]:
    """Skew (s), compliance (rad/(N m)), reversal (rad), residual RMS (rad), share of the variance that the skew explains."""
    names = ["velocity", "torque", *extra]
    d = s["d"][rows] - s["d"][rows].mean()
    A = np.column_stack([s[n][rows] - s[n][rows].mean() for n in names])
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-30)
    x = np.linalg.lstsq(A / size, d, rcond=1e-10)[0] / size
    alone = float(A[:, 0] @ d) ** 2 / float(size[0] ** 2 * (d @ d)) if d @ d > 0 else 0.0
    reversal = float(x[names.index("sign")]) if "sign" in names else float("nan")
    return float(x[0]), float(x[1]), reversal, float(np.std(d - A @ x)), alone


def _over_units(values: Array) -> Known:
    return Known(float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))))
