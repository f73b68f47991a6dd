# SPDX-License-Identifier: Apache-2.0
"""Whether the stamps of a session can be times of its rows, and what they are taken for where they can't.

Nothing is refused here: a session whose stamps are wrong tells as much of springs as another. What needs times or an order is not
judged on stamps that have none (`clock: order` or `none`), and that is said.
"""

from __future__ import annotations

import numpy as np

from ..typing import Array, BoolArray, IntArray

LATEST_BEGIN = 3600.0  # s; stamps that begin later are not counted from the begin of the session (times of day, of a controller)
LONGEST_ROW = 1800.0  # s; usual (median) time from one row to the next
LONGEST_GAP = 365 * 86400.0  # s; pauses overnight and over a shutdown are usual
FEWEST = 6  # rows by which an order is told
MOST_RESTARTS = 5  # jumps back in a file in the order of measurement; one that is sorted has one at each pose or load case


def trusted(
    clock: str, stamp: Array, pose: IntArray, repeat: IntArray, load_case: IntArray, loaded: bool
) -> tuple[str, Array, list[str]]:
    """What stamps can be taken for.

    Args:
        clock: as stated: `time`, `order` or `none`.
        stamp: s, shape (n,), in the order of the file.
        pose, repeat, load_case: shape (n,).
        loaded: the session has reference rows.

    Returns:
        clock, stamps (counted from the first row where they begin late, numbers of rows where only the order of the file is
        left), and notes.
    """
    if clock == "none" or len(stamp) < 2:
        return clock, stamp, []
    if np.ptp(stamp) == 0.0:
        note = f"stamp is {stamp[0]:.10g} s in all {len(stamp)} rows: read as clock: none, nothing is judged on time or order"
        return "none", stamp, [note]
    group = np.unique(np.stack([pose, repeat], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    rows = np.arange(len(stamp), dtype=float)
    if loaded and (why := _of_other_clocks(stamp, group, load_case)):
        return "order", rows, [f"{why}; read as clock: order, in the order of the rows: nothing is judged on time"]
    if loaded and (why := _backwards(stamp, group, load_case)):
        return "none", stamp, [f"{why}; read as clock: none, nothing is judged on time or order"]
    if why := _restarted(stamp, group):
        return "order", rows, [f"{why}; read as clock: order, in the order of the rows: nothing is judged on time"]
    if clock != "time":
        return clock, stamp, []
    if why := _too_long(stamp):
        return "order", stamp, [f"{why}; read as clock: order: nothing is judged on time"]
    if stamp.min() > LATEST_BEGIN:
        # what changes with time since the session began (a warm-up) would be over long before
        note = f"stamps begin at {stamp.min():.10g} s, not with the session: counted from the first row"
        return clock, stamp - stamp.min(), [note]
    return clock, stamp, []


def _of_other_clocks(stamp: Array, group: IntArray, load_case: IntArray) -> str:
    """Whether loaded rows are in the order of the file and references alone are not: stamped by another clock."""
    reference = load_case == 0
    if (~reference).sum() < FEWEST or (np.diff(stamp[~reference]) < 0.0).any():
        return ""
    first = _first_rows(group)
    begins = first[reference[first]]  # a file in which references come first
    if len(begins) < 2 or len(begins) < 0.9 * len(first):
        return ""
    following = np.minimum(begins + 1, len(stamp) - 1)
    late = stamp[begins] > stamp[following]
    if late.mean() < 0.5 or _measured_last(stamp, group, reference, begins[late]) > 0.5:
        return ""
    by = float(np.median((stamp[begins] - stamp[following])[late]))
    return (
        f"references are stamped later than the load cases that follow them in {int(late.sum())} of {len(begins)} poses "
        f"(by {by:.4g} s, median): stamps of two clocks"
    )


def _measured_last(stamp: Array, group: IntArray, reference: BoolArray, begins: IntArray) -> float:
    """Share of references that one clock may have stamped after their load cases and before those of the next pose."""
    loaded = np.flatnonzero(~reference)
    order = loaded[np.argsort(stamp[loaded], kind="stable")]
    last = np.full(int(group.max()) + 1, -1)
    last[group[order]] = np.arange(len(order))  # place of the last load case of each pose, by stamp
    at = last[group[begins]]
    after = np.where(at + 1 < len(order), stamp[order[np.minimum(at + 1, len(order) - 1)]], np.inf)
    end = np.where(at + 1 < len(order), after, stamp[order[-1]] + LONGEST_ROW)
    between = (at >= 0) & (stamp[begins] >= stamp[order[at]]) & (stamp[begins] <= end)
    return float(between.mean())


def _backwards(stamp: Array, group: IntArray, load_case: IntArray) -> str:
    """Whether stamps fall from row to row, and references, which come first in the file, would be the last by them."""
    if len(stamp) < FEWEST or (np.diff(stamp) > 0.0).any():
        return ""
    first = _first_rows(group)
    if (load_case[first] == 0).mean() < 0.9:
        return ""
    return "stamps fall from row to row, by which each reference would come after its load cases"


def _restarted(stamp: Array, group: IntArray) -> str:
    """Whether stamps restart within the file, so that poses would be measured at the same time."""
    back = np.flatnonzero(np.diff(stamp) < 0.0)
    if not 0 < len(back) <= MOST_RESTARTS or len(stamp) < FEWEST:
        return ""
    blocks = 1 + int((np.diff(group) != 0).sum())
    if blocks > len(np.unique(group)):  # sorted in another way: poses do not hang together in the file either
        return ""
    by_stamp = group[np.argsort(stamp, kind="stable")]
    changes = 1 + int((np.diff(by_stamp) != 0).sum())
    if changes <= 1.5 * blocks:  # the second part lies before the first as a whole
        return ""
    return f"stamps restart {len(back)} time(s) (first at row {int(back[0]) + 2}), and poses would be measured at the same time"


def _too_long(stamp: Array) -> str:
    step = np.diff(np.sort(stamp))
    usual = float(np.median(step))
    if usual > LONGEST_ROW:
        unit = "ns" if usual > 1e8 else "us" if usual > 1e5 * 60 else "ms"
        return f"stamps go on by {usual:.4g} s from row to row (median), at most {LONGEST_ROW:g} s is expected ({unit} for s?)"
    if step.max() > LONGEST_GAP:
        days = step.max() / 86400.0
        return f"stamps have a gap of {step.max():.4g} s ({days:.0f} days), at most {LONGEST_GAP / 86400.0:.0f} days is expected"
    return ""


def _first_rows(group: IntArray) -> IntArray:
    """The first row of each pose and repeat in the order of the file."""
    return np.asarray(np.unique(group, return_index=True)[1])
