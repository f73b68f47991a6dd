# SPDX-License-Identifier: Apache-2.0
"""The standing arm shaken, axis by axis, and what the tracker sees: by a swept force, as somebody with a shaker makes it, or by a
swept offset on the correction's own channel."""

from __future__ import annotations

import numpy as np

from ..cellfile import CellFile
from ..kinematics import Array, forward
from .hard import Hard
from .process import Force
from .runner import Controller, Drive, _Run
from .ways import PERIOD, Ways

LOWEST, HIGHEST = 3.0, 35.0  # Hz
PRELOAD = 300.0  # N, along each axis, so that no gear play is open
GENTLE = 0.5  # m/s^2, largest acceleration of a swept offset


def tap(
    cell: CellFile, hard: Hard, q: Array, rail: float, seconds: float = 24.0, size: float = 120.0, seed: int = 0
) -> tuple[Array, Array]:  # fmt: skip
    """Sweep a force about a preload along each axis of base_link in turn.

    Args:
        q: posture, (n,), rad; size: amplitude, N.

    Returns:
        force (k, 3), N, and the TCP's displacement (k, 3), m, in base_link at 250 Hz, both as measured.
    """
    swept, _ = _sweep(seconds)
    drive = _standing(cell, hard, q, rail, PRELOAD + size * swept, None, seed)
    return drive.reading[:, 0] @ drive.ways.R_tool[0, 0].T, drive.measured[:, 0]


def shake(
    cell: CellFile, hard: Hard, q: Array, rail: float, seconds: float = 24.0, size: float = 1.5e-4, seed: int = 0
) -> tuple[Array, Array]:  # fmt: skip
    """Sweep an offset without contact: offset as sent (k, 3) and the TCP's displacement as measured (k, 3), m, in base_link.

    Args:
        q: posture, (n,), rad; size: largest amplitude, m; less where its acceleration would be above GENTLE.
    """
    swept, hertz = _sweep(seconds)
    sent = swept * np.minimum(size, GENTLE / (2.0 * np.pi * hertz) ** 2)[:, None]
    drive = _standing(cell, hard, q, rail, np.zeros_like(sent), _Swept(sent), seed)
    return drive.sent[:, 0], drive.measured[:, 0]


class _Swept:
    """A controller that sends what was written down."""

    def __init__(self, sent: Array) -> None:
        self._sent = sent

    def step(self, now: float, wrench: Array, q: Array, rail: Array) -> Array:
        """As `Controller`."""
        return self._sent[round(now / PERIOD)][None]


def _sweep(seconds: float) -> tuple[Array, Array]:
    """Unit sweep along each axis in turn, (k, 3), and its frequency, (k,), Hz."""
    t, part = _times(int(seconds / PERIOD)), seconds / 3.0
    u = (t % part) / part
    phase = 2.0 * np.pi * part * (LOWEST * u + 0.5 * (HIGHEST - LOWEST) * u * u)
    out = np.zeros((len(t), 3))
    out[np.arange(len(t)), np.minimum((t / part).astype(int), 2)] = np.sin(phase)
    return out, LOWEST + (HIGHEST - LOWEST) * u


def _times(steps: int) -> Array:
    return np.arange(steps, dtype=np.float64) * PERIOD


def _standing(
    cell: CellFile, hard: Hard, q: Array, rail: float, force: Array, controller: Controller | None, seed: int
) -> Drive:  # fmt: skip
    """Record of an arm that stands at q under a force (k, 3), N, in base_link."""
    steps = len(force)
    eye = np.broadcast_to(np.eye(3), (steps, 1, 3, 3)).copy()
    R = forward(cell.chain, q[None]).R_tool
    ways = Ways(
        np.tile(q, (steps, 1, 1)), np.array([rail]), _times(steps)[:, None], np.array([1.0]), eye,
        eye[:, :, :, 2].copy(), np.tile(R, (steps, 1, 1, 1)), np.ones((steps, 1), dtype=bool), np.zeros((steps, 1, 3)), 1.0,
        ("T_1",),
    )  # fmt: skip
    given = force[:, None]
    made = Force(given, np.zeros_like(given), np.zeros((steps, 1)), 0.0, 0, 0.0, np.ones((steps, 1), dtype=bool))
    run = _Run(cell, hard, ways, made, seed)
    for k in range(steps):
        run.step(k, controller)
    return run.record()
