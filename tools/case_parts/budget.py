# SPDX-License-Identifier: Apache-2.0
"""Error budget: what is left after the paper's own correction, and how much of it goes with each group of causes.

Groups are switched off one after the other, and in the opposite order; each bar is the mean of what went in both. So the bars and
what is left in the end add up exactly. With every group of static causes the cell is calibrated again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .costs import few_courses, model_without
from .jobs import Case, Job, load
from .table import figures

GROUPS: dict[str, tuple[str, ...]] = {
    "force sensor": ("sensor crosstalk and drift", "sensor noise and bandwidth"),
    "delay and servo": ("latency and servo",),
    "structural modes": ("structural modes",),
    "friction, play, creep": ("gear friction", "gear play", "creep"),
    "springs not in the model": (
        "gear curve",
        "soft head",
        "base and rail",
        "counterbalance",
        "gears that couple",
        "warmth of production",
        "frame errors",
        "hose pull",
    ),
    "tracker": ("tracker noise in motion",),
}
REST = "what is left with all of them off"


@dataclass(frozen=True)
class Budget:
    """parts: group -> mm of the mean and of the maximum error; total: of both, mm. They add up."""

    parts: dict[str, tuple[float, float]]
    total: tuple[float, float]


@dataclass(frozen=True)
class Plan:
    forward: tuple[Job, ...]
    backward: tuple[Job, ...]

    @property
    def jobs(self) -> list[Job]:
        return list({j.name: j for j in (*self.forward, *self.backward)}.values())

    def of(self, case: Case, tolerance: float) -> Budget:
        """The budget from the drives."""

        def values(jobs: tuple[Job, ...]) -> list[tuple[float, float]]:
            found = [figures(load(case, j)[0], tolerance) for j in jobs]
            return [(f.mean, f.max) for f in found]

        names = list(GROUPS)
        forward, backward = values(self.forward), values(self.backward)
        parts = {}
        for i, name in enumerate(names):
            back = len(names) - 1 - i
            parts[name] = tuple(
                0.5 * (forward[i][k] - forward[i + 1][k] + backward[back][k] - backward[back + 1][k]) for k in (0, 1)
            )
        parts[REST] = forward[-1]
        return Budget(parts, forward[0])  # type: ignore[arg-type]


def budget_jobs(case: Case, say: Callable[[str], None]) -> Plan:
    """Drives of a few courses with more and more groups switched off, in both orders; calibrated for each."""
    rows = few_courses(case, 3)

    def chain(order: list[str], word: str) -> tuple[Job, ...]:
        out: list[Job] = []
        off: tuple[str, ...] = ()
        for i in range(len(order) + 1):
            whole = i in (0, len(order))  # both orders begin and end alike
            name = f"budget_{'both' if whole else word}_{i}"
            out.append(
                Job(name, rows, model_without(case, tuple(sorted(_static(off)))), off=off if not whole else tuple(sorted(off)))
            )
            if i < len(order):
                off = (*off, *GROUPS[order[i]])
        return tuple(out)

    names = list(GROUPS)
    say("calibrating the variants of the error budget")
    return Plan(chain(names, "forward"), chain(names[::-1], "backward"))


def _static(off: tuple[str, ...]) -> tuple[str, ...]:
    """Causes that calibration sees."""
    moving = {*GROUPS["delay and servo"], *GROUPS["structural modes"], *GROUPS["tracker"], "sensor noise and bandwidth"}
    return tuple(c for c in off if c not in moving)
