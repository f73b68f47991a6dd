# SPDX-License-Identifier: Apache-2.0
"""The correction of irec_correction, one chain per course, as the controller of a simulated production run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell
from irec_calibration.typing import Array
from irec_correction.conditioning import Conditioner, FilterSettings, make_filters
from irec_correction.correction import Correction, CorrectionSettings
from irec_correction.deflection import Deflection
from irec_correction.nodes.model_checks import Mounted, read_checked
from irec_correction.state import State

GRAVITY = (0.0, 0.0, -9.81)
BEFORE = 0.7  # s that the correction is in force before a course begins


@dataclass(frozen=True)
class Setup:
    """A configuration of the correction: model file, settings, filters; zeroed: the force sensor is zeroed in the air before each
    course (service `~/bias` of can_ft_node)."""

    model: Path
    settings: CorrectionSettings = field(default_factory=CorrectionSettings)
    filters: FilterSettings = field(default_factory=FilterSettings)
    zeroed: bool = False


class Corrected:
    """Offsets of all courses; every limit and watchdog of the correction is in force.

    Attributes:
        states: ticks spent in each state; findings: by what the watchdog found; limited: ticks with a limit active.
    """

    def __init__(self, cell: Cell, setup: Setup, until: Array) -> None:
        """Read and check the model as correction_node does.

        Args:
            until: s, when each course ends, (rows,); from then on its offset stands.

        Raises:
            IrecError: the model is refused.
        """
        rows = len(until)
        settings = replace(setup.settings, need_envelope=True)
        mounted = Mounted(cell.robot, cell.serial, "", GRAVITY, cell.payload, settings.period)
        checked = read_checked(setup.model, mounted)
        self.left_out = dict(checked.deflection.left_out)
        self.chains = []
        for _ in range(rows):
            chain = Correction(settings, cell.robot, Conditioner(make_filters(setup.filters)))
            chain.put_in_force(checked.model, 0.0, Deflection(checked.model, cell.robot, GRAVITY, cell.payload))
            self.chains.append(chain)
        self.states: Counter[State] = Counter()
        self._until, self._out = until, np.zeros((rows, 3))
        self._started = False
        self._zeroed, self._bias = setup.zeroed, np.zeros((rows, 6))

    def zero(self, reading: Array) -> None:
        """As `irec_sim.production.runner.Zeroes`."""
        if self._zeroed:
            self._bias[:, :3] = reading

    def step(self, now: float, wrench: Array, q: Array, rail: Array) -> Array:
        """As `irec_sim.production.runner.Controller`."""
        under_way = np.flatnonzero(self._until > now)
        now += 10.0
        wrench = wrench - self._bias
        if not self._started:
            self._begin(now, wrench, q, rail)
        for i in under_way:
            chain = self.chains[i]
            chain.take_joints(now, now, q[i], float(rail[i]))
            chain.take_wrench(now, now, "", wrench[i])
            tick = chain.tick(now)
            self._out[i] = tick.translation
            self.states[tick.state] += 1
        return self._out.copy()

    def take_links(self, now: float, windup: Array) -> None:
        """As `irec_sim.production.runner.ReadsLinks`; chains without secondary encoders don't look."""
        for chain, one in zip(self.chains, windup, strict=True):
            if chain.links is not None:
                chain.take_links(now + 10.0, one)

    def _begin(self, now: float, wrench: Array, q: Array, rail: Array) -> None:
        """In force before the course, as in production: ramped in, filters settled."""
        for i, chain in enumerate(self.chains):
            period = chain.settings.period
            chain.start(now - BEFORE)
            for k in range(int(BEFORE / period) - 1, 0, -1):
                t = now - k * period
                chain.take_joints(t, t, q[i], float(rail[i]))
                chain.take_wrench(t, t, "", wrench[i] + 1e-6 * (k % 7))
                chain.take_links(t, np.zeros(q.shape[1]))  # no process yet
                chain.tick(t)
        self._started = True

    def told(self) -> dict[str, float]:
        """Share of ticks: active, limited; and how often the watchdog found something."""
        ticks = max(1, sum(self.states.values()))
        return {
            "active_share": self.states[State.ACTIVE] / ticks,
            "limited_share": sum(c.counts.limited for c in self.chains) / ticks,
            "findings": float(sum(sum(c.watchdog.counters.values()) for c in self.chains)),
        }
