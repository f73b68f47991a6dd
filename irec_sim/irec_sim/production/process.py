# SPDX-License-Identifier: Apache-2.0
"""Forces of the process on the tool along every course, in the path's own directions: along, across, out of the surface.

Lay-down: a roller that touches down while driving, its cylinder's force loop, the tape that is started, pulled, cut and dropped.
Roughing: cutting forces that follow the engagement, and tooth passing as the force sensor sees it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import SimError
from ..kinematics import Array, BoolArray
from .ways import PERIOD, Ways


@dataclass(frozen=True)
class Force:
    """Forces of the environment on the robot at all steps of all courses.

    Attributes:
        steady: what the course's program brings about, (steps, k, 3), N; unsteady: the rest, (steps, k, 3), N.
        tooth: amplitude of the force at tooth passing, (steps, k), N; spindle: 1/s of the spindle, teeth: of the cutter.
        stiffness: N/m by which the force out of the surface grows as the tool goes in.
        counted: samples at which the process makes the part, (steps, k).
    """

    steady: Array
    unsteady: Array
    tooth: Array
    spindle: float
    teeth: int
    stiffness: float
    counted: BoolArray


def make_force(process: dict[str, Any], ways: Ways, seed: int, ripple: float = 1.0) -> Force:
    """Forces of the process of a truth file; what is unsteady is drawn per course and scaled by `ripple`.

    Raises:
        SimError: a key is missing.
    """
    try:
        made = _lay_down(process, ways, seed) if process["kind"] == "lay-down" else _roughing(process, ways, seed)
    except (KeyError, TypeError) as error:
        raise SimError(f"process of the truth lacks or has a wrong {error}; see config/truths/case_afp.yaml") from error
    return Force(made.steady, ripple * made.unsteady, made.tooth, made.spindle, made.teeth, made.stiffness, made.counted)


def _generators(seed: int, ways: Ways, kind: int) -> list[np.random.Generator]:
    """One per course, so that a course is the same whichever others are driven."""
    return [np.random.default_rng([seed, kind, int(name[2:])]) for name in ways.names]


def band_noise(rng: np.random.Generator, steps: int, highest: float, size: int = 3) -> Array:
    """Noise of unit standard deviation below a frequency (Hz), second-order low-pass, (steps, size)."""
    from scipy import signal

    sos = signal.butter(2, highest, fs=1.0 / PERIOD, output="sos")
    x = signal.sosfilt(sos, rng.standard_normal((steps + 500, size)), axis=0)[500:]
    gain = math.sqrt(2.0 * highest * PERIOD * 1.11)  # equivalent noise bandwidth of this low-pass
    return np.asarray(x / gain)


def _ripple_along(rng: np.random.Generator, ways: Ways, row: int, length: float) -> Array:
    """Slow change along the way, unit standard deviation, (steps, 3); `length`: m of its waves."""
    out = np.zeros((len(ways.way), 3))
    for _ in range(4):
        wave = rng.uniform(0.7, 2.0, 3) / length
        out += np.sin(2.0 * math.pi * ways.way[:, row, None] * wave + rng.uniform(0.0, 2.0 * math.pi, 3)) / math.sqrt(2.0)
    return out


def _lay_down(p: dict[str, Any], ways: Ways, seed: int) -> Force:
    steps, k = ways.way.shape
    steady, unsteady = np.zeros((steps, k, 3)), np.zeros((steps, k, 3))
    counted = np.zeros((steps, k), dtype=bool)
    t = np.arange(steps) * PERIOD
    mean, slow, noise = (np.array(p[key], dtype=float) for key in ("force", "slow", "noise"))
    for row, rng in enumerate(_generators(seed, ways, 1)):
        end = float(ways.driving[:, row].sum()) * PERIOD
        late = p["touch_down_spread"] * rng.uniform(-1.0, 1.0)  # the mould is not exactly where it should be
        down = _force_loop(t - p["touch_down_at"] - late, p["touch_down"], p["overshoot"])
        up = 1.0 - _force_loop(t - (end - p["lift_off"] - 0.05), p["lift_off"], 0.0)
        pressed = down * up
        tape = _step(t - p["touch_down_at"] - 0.10, 0.04) * (1.0 - _step(t - (end - p["lift_off"] - 0.30), 0.02))
        steady[:, row, 2] = mean[2] * pressed
        steady[:, row, :2] = mean[:2] * pressed[:, None]
        steady[:, row, 0] += p["tape_tension"] * tape
        for at in (p["touch_down_at"] + 0.12, end - p["lift_off"] - 0.30):  # tape started, tape cut and dropped
            steady[:, row] += np.array(p["pulse"]) * np.exp(-0.5 * ((t - at) / 0.04) ** 2)[:, None]
        unsteady[:, row] = (slow * _ripple_along(rng, ways, row, 0.5) + noise * band_noise(rng, steps, p["noise_to"])) * pressed[
            :, None
        ]
        turns = ways.way[:, row] / (math.pi * p["roller"]) + rng.random()
        unsteady[:, row, 2] += p["run_out"] * np.sin(2.0 * math.pi * turns) * pressed
        # tape lies under the roller from half the force of the touch-down on; where the roller lifts, its tail has passed
        counted[:, row] = (down > 0.5) & (t < end - p["lift_off"] - 0.05)
    return Force(steady, unsteady, np.zeros((steps, k)), 0.0, 0, float(p["stiffness"]), counted)


def _force_loop(t: Array, rise: float, overshoot: float) -> Array:
    """From 0 to 1 as a force-controlled cylinder answers: within `rise` s, overshooting by a share."""
    zeta = 1.0 if overshoot <= 0.0 else -math.log(overshoot) / math.hypot(math.pi, math.log(overshoot))
    w = 2.5 / rise
    x = np.maximum(t, 0.0) * w
    if zeta >= 1.0:
        return np.where(t > 0.0, 1.0 - np.exp(-2.0 * x) * (1.0 + 2.0 * x), 0.0)
    d = math.sqrt(1.0 - zeta * zeta)
    return np.where(t > 0.0, 1.0 - np.exp(-zeta * x) * (np.cos(d * x) + zeta / d * np.sin(d * x)), 0.0)


def _step(t: Array, time: float) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(t / (0.25 * time), -50.0, 50.0))))


def _roughing(p: dict[str, Any], ways: Ways, seed: int) -> Force:
    steps, k = ways.way.shape
    steady, unsteady = np.zeros((steps, k, 3)), np.zeros((steps, k, 3))
    tooth, counted = np.zeros((steps, k)), np.zeros((steps, k), dtype=bool)
    mean, slow, noise = (np.array(p[key], dtype=float) for key in ("force", "slow", "noise"))
    t = np.arange(steps) * PERIOD
    for row, rng in enumerate(_generators(seed, ways, 2)):
        end = float(ways.driving[:, row].sum()) * PERIOD
        way, length = ways.way[:, row], ways.length[row]
        enter = _step(t - 0.15 - 0.5 * p["entry"], p["entry"]) * (1.0 - _step(t - (end - 0.15 - 0.5 * p["entry"]), p["entry"]))
        # more material in the corners of the raw block; at the entry the cutter goes through the full width, once per level
        corner = 0.5 - 0.5 * np.cos(4.0 * 2.0 * math.pi * way / length)
        slot = np.exp(-0.5 * ((way - 0.04 - p["slot_at"] * length) / p["slot_length"]) ** 2)
        engaged = enter * (p["least"] + (1.0 - p["least"]) * corner + p["slot"] * slot)
        plunge = np.array(p["plunge"]) * np.exp(-0.5 * ((t - 0.15 - p["entry"]) / p["plunge_time"]) ** 2)[:, None]
        steady[:, row] = mean * engaged[:, None] + plunge * enter[:, None]
        unsteady[:, row] = np.sqrt(engaged)[:, None] * (
            slow * _ripple_along(rng, ways, row, 0.4) + noise * band_noise(rng, steps, p["noise_to"])
        )
        tooth[:, row] = p["tooth"] * engaged
        counted[:, row] = enter > 0.5
    return Force(steady, unsteady, tooth, float(p["spindle"]), int(p["teeth"]), float(p["stiffness"]), counted)
