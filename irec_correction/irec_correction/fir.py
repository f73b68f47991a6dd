# SPDX-License-Identifier: Apache-2.0
"""A designed filter of the wrench: weighted sums of the last samples, the same everywhere or other ones at each posture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.files import check_replaceable, write_file
from irec_calibration.files.outputs import TAPS
from irec_calibration.files.regular import TABLE_LIMIT, read_text
from irec_calibration.sensors.look_ahead import LONGEST
from irec_calibration.typing import Array

from .errors import SettingsError

LOUDEST = 190.0  # sum of the sizes of the taps; what they may do to the offset is for its limits
MOST = 30  # postures
_CLOSE = 0.05  # rad, within which one posture is taken as reached
_AXES = ("force_x", "force_y", "force_z")
_CROSSED = tuple(f"{a}_from_{b}" for a in "xyz" for b in "xyz" if a != b)


def nearness(postures: Array, q: Array) -> Array:
    """Weight of each posture (m, n), rad, at joint angles q (k, n): by the distance to the fourth power, (k, m); sums to one."""
    away = np.maximum(np.linalg.norm(q[:, None] - postures[None], axis=2), _CLOSE) ** -4.0
    return np.asarray(away / away.sum(axis=1, keepdims=True))


class Fir:
    """Weighted sum of the last samples, newest first; gain one at zero frequency. `delay` is negative where it looks ahead."""

    def __init__(self, taps: Array, rate: float, postures: Array | None = None, name: str = "designed filter") -> None:
        """Make it ready; with postures it is that of the first one until it is told where the robot is.

        Args:
            taps: (n,), newest sample first, or (n, 3) for the axes of the force; torques then pass through their mean. With
                postures: (m, n, 3), or (m, n, 3, 3) for each axis from each axis. rate: Hz.
            postures: (m, joints), rad.

        Raises:
            SettingsError: not such taps, or a constant force would not pass unchanged.
        """
        given = np.asarray(taps, dtype=float)
        each = np.tile(given[:, None], 3) if given.ndim == 1 else given
        each = each[None] if each.ndim == 2 else each
        each = each[..., None] * np.eye(3) if each.ndim == 3 and each.shape[2] == 3 else each
        where = np.zeros((1, 0)) if postures is None else np.asarray(postures, dtype=float)
        if each.ndim != 4 or each.shape[2:] != (3, 3) or not 1 <= each.shape[1] <= LONGEST:
            raise SettingsError(f"a designed filter has 1 to {LONGEST} taps, or as many for each axis, not {given.shape}")
        if where.ndim != 2 or not 1 <= len(where) <= MOST or len(where) != len(each):
            raise SettingsError(
                f"a designed filter has taps for {len(each)} postures, and {np.shape(where)} joint angles of them"
            )
        if not (np.isfinite(each).all() and np.isfinite(where).all()):
            raise SettingsError("a designed filter holds values that are not finite")
        off = float(np.abs(each.sum(axis=1) - np.eye(3)).max())
        if off > 1e-6:
            raise SettingsError(
                f"the taps of a designed filter sum to 1, or 0 from another axis, but for {off:.6f};"
                " a constant force must pass unchanged"
            )
        largest = float(np.abs(each).sum(axis=1).max())
        if largest > LOUDEST:
            raise SettingsError(f"the taps of a designed filter sum to {largest:.0f} in size; {LOUDEST:g} is allowed")
        self.taps, self.name, self._where = given, name, where
        own = np.trace(each, axis1=2, axis2=3) / 3.0  # (m, n)
        self.delay = float(own.mean(axis=0) @ np.arange(each.shape[1]) / rate)
        # one flat row for each posture: each axis of the force from all samples of all axes, then the taps of torques
        self._n = each.shape[1]
        self._all = np.concatenate([each.transpose(0, 2, 1, 3).reshape(len(each), -1), own], axis=1)
        self._weights = self._all[0]
        self._past: Array | None = None
        self._at = 0

    def place(self, q: Array) -> None:
        """The robot is at joint angles q (joints,), rad."""
        if len(self._where) > 1 and len(q) == self._where.shape[1]:
            self._weights = nearness(self._where, q[None])[0] @ self._all

    def reset(self) -> None:
        """Begin anew: the next sample is taken as having stood for ever."""
        self._past = None

    def step(self, sample: Array) -> Array:
        """One sample (6,)."""
        n = self._n
        if self._past is None:
            self._past = np.tile(sample, (2 * n, 1))
        self._at = (self._at - 1) % n
        self._past[self._at] = self._past[self._at + n] = sample  # twice, so that the last n lie in one piece
        past, weights = self._past[self._at : self._at + n], self._weights
        out = np.empty(6)
        out[:3] = weights[: 9 * n].reshape(3, 3 * n) @ past[:, :3].ravel()
        out[3:] = weights[9 * n :] @ past[:, 3:]
        return out


@dataclass(frozen=True)
class TapTable:
    """Taps (m, n, 3), or (m, n, 3, 3) for each axis from each axis, at postures (m, joints), rad, of these joints; without joints
    one posture."""

    taps: Array
    postures: Array
    joints: tuple[str, ...]


def write_taps(path: str | Path, table: TapTable) -> None:
    """A table (CSV): the joint angles of a posture and force_x, force_y, force_z of each of its taps, newest sample first; where
    axes answer one another, x_from_y to z_from_y too."""
    other, numbers = ~np.eye(3, dtype=bool), table.taps
    if numbers.ndim == 4:
        numbers = np.diagonal(table.taps, axis1=2, axis2=3)
        numbers = np.concatenate([numbers, table.taps[:, :, other]], axis=2) if table.taps[:, :, other].any() else numbers
    rows = [",".join([*table.joints, *(*_AXES, *_CROSSED)[: numbers.shape[2]]])]
    for posture, taps in zip(table.postures, numbers, strict=True):
        rows += [",".join(f"{x:.10g}" for x in (*posture, *tap)) for tap in taps]
    check_replaceable(path, "a table of a filter", TAPS, SettingsError)
    write_file(path, "\n".join(rows) + "\n", error=SettingsError)


def read_taps(path: str | Path, joint_names: Sequence[str] = ()) -> TapTable:
    """Taps from a table as `write_taps` writes it; columns of joints are optional (without them there is one posture), and so are
    those of axes that answer one another.

    Args:
        joint_names: of the robot; where the table has columns of joints, it has these.

    Raises:
        SettingsError: not such a table.
    """
    text = read_text(path, "designed filter", SettingsError, TABLE_LIMIT)
    try:
        if not text.strip():
            raise ValueError("it is empty")
        table = np.genfromtxt(io.StringIO(text), delimiter=",", names=True, dtype=float)
    except (ValueError, IndexError) as error:
        raise SettingsError(f"{path}: not a table of taps that can be read: {error}") from error
    names = table.dtype.names or ()
    crossed = any(n in _CROSSED for n in names)
    columns = (*_AXES, *_CROSSED) if crossed else _AXES
    joints = tuple(n for n in names if n not in columns)
    missing = [c for c in (*columns, *(joint_names if joints else ())) if c not in names]
    if missing or table.size < 1:
        raise SettingsError(f"{path}: a designed filter has columns {', '.join(columns)}, and a row or more; missing: {missing}")
    joints = tuple(joint_names) if joints else ()
    taps = np.stack([np.atleast_1d(table[c]) for c in _AXES], axis=1)
    if crossed:
        whole = taps[:, :, None] * np.eye(3)
        whole[:, ~np.eye(3, dtype=bool)] = np.stack([np.atleast_1d(table[c]) for c in _CROSSED], axis=1)
        taps = whole
    if not joints:
        return TapTable(taps[None], np.zeros((1, 0)), ())
    q = np.stack([np.atleast_1d(table[c]) for c in joints], axis=1)
    begins = np.flatnonzero(np.r_[True, np.any(np.diff(q, axis=0) != 0.0, axis=1)])
    n = len(q) // len(begins)
    if len(q) != n * len(begins) or not np.array_equal(begins, n * np.arange(len(begins))):
        raise SettingsError(f"{path}: {len(begins)} postures and {len(q)} rows; each posture has as many taps")
    return TapTable(taps.reshape(len(begins), n, *taps.shape[1:]), q[begins], joints)
