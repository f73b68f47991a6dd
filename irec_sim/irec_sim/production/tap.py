# SPDX-License-Identifier: Apache-2.0
"""A swept force on the standing arm, axis by axis, as somebody with a shaker or a soft hammer makes it; and what the
tracker sees."""

from __future__ import annotations

import numpy as np

from ..cellfile import CellFile
from ..kinematics import Array, forward
from .hard import Hard
from .process import Force
from .runner import _Run
from .ways import PERIOD, Ways


def tap(
    cell: CellFile, hard: Hard, q: Array, rail: float, seconds: float = 15.0, size: float = 120.0, seed: int = 0
) -> tuple[Array, Array]:  # fmt: skip
    """Sweep from 3 to 35 Hz about a preload of 300 N along each axis of base_link in turn.

    Args:
        q: posture, (n,), rad; size: amplitude, N.

    Returns:
        force (k, 3), N, and the TCP's displacement (k, 3), m, in base_link at 250 Hz, both as measured.
    """
    steps = int(seconds / PERIOD)
    t = np.arange(steps, dtype=np.float64) * PERIOD
    eye = np.broadcast_to(np.eye(3), (steps, 1, 3, 3)).copy()
    R = forward(cell.chain, q[None]).R_tool
    ways = Ways(
        np.tile(q, (steps, 1, 1)), np.array([rail]), t[:, None].astype(np.float64), np.array([1.0]), eye, eye[:, :, :, 2].copy(),
        np.tile(R, (steps, 1, 1, 1)), np.ones((steps, 1), dtype=bool), np.zeros((steps, 1, 3)), 1.0, ("T_1",),
    )  # fmt: skip
    part = seconds / 3.0
    u = (t % part) / part
    phase = 2.0 * np.pi * part * (3.0 * u + 0.5 * (35.0 - 3.0) * u * u)
    force = np.full((steps, 1, 3), 300.0)
    force[np.arange(steps), 0, np.minimum((t / part).astype(int), 2)] += size * np.sin(phase)
    made = Force(force, np.zeros_like(force), np.zeros((steps, 1)), 0.0, 0, 0.0, np.ones((steps, 1), dtype=bool))
    run = _Run(cell, hard, ways, made, seed)
    for k in range(steps):
        run.step(k, None)
    drive = run.record()
    return (R[0] @ drive.reading[:, 0].T).T, drive.measured[:, 0]
