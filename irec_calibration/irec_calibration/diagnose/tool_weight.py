# SPDX-License-Identifier: Apache-2.0
"""Evidence for a wrong tool weight: what the force sensor reads at the references, where nothing touches the tool.

In the difference to the reference a wrong weight cancels, so displacements say nothing about it. The reference rows' own
readings do: R^T g dm turns with the flange, a bias of the sensor does not, and a right removal leaves noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..effects import CATALOGUE, Evidence
from ..effects.scene import Scene
from ..identification.settings import READINGS
from ..identification.tool_weight import at_references, reference_rows
from ..identification.validation import rms
from ..typing import Array
from .evidence import Bench, Block, Posterior
from .settings import SETTINGS

READ_AT_REFERENCES = next(e() for e in CATALOGUE if e.evidence is Evidence.REFERENCE_READINGS)
FACTORS = np.array([0.1, 1.0, 10.0])


@dataclass(frozen=True)
class Readings:
    """What the reference readings say.

    Attributes:
        mass, mass_se: wrong mass left in the readings, kg; sign as in the effect: reading = R^T g dm.
        log_evidence: for a wrong mass over noise and over a constant bias, whichever is more likely.
        rms_before, rms_after: of the readings, N; bias: constant part in tool0, N.
    """

    mass: float
    mass_se: float
    log_evidence: float
    rms_before: float
    rms_after: float
    bias: tuple[float, float, float]
    log_evidence_bias: float


def reference_readings(scene: Scene, force_noise: float) -> Readings | None:
    """Test the readings at the references of a loaded session; None where there are too few of them, or nothing weighs."""
    found = at_references(scene, force_noise)
    if found is None:
        return None
    bench = Bench((found.force / force_noise).ravel(), np.repeat(scene.pose[found.rows], 3))
    mass = _block(found.per_kg.ravel()[:, None], force_noise, READINGS.mass_kg)
    bias = _block(np.tile(np.eye(3), (len(found.rows), 1)), force_noise, READINGS.bias_n)
    nothing = _nothing(bench)
    by_mass = bench.posterior(mass, FACTORS, slice(0, 1))
    by_bias = bench.posterior(bias, FACTORS, slice(0, 3))
    by_both = bench.posterior(bias + mass, FACTORS, slice(0, 4))
    with_mass = max((by_mass, by_both), key=lambda p: p.log_evidence)
    after = float(np.sqrt(with_mass.chi2 / len(found.rows)) * force_noise)
    b = by_bias.x * READINGS.bias_n
    return Readings(
        found.mass, found.mass_se, with_mass.log_evidence - max(by_bias.log_evidence, nothing), rms(found.force), after,
        (float(b[0]), float(b[1]), float(b[2])), by_bias.log_evidence - nothing,
    )  # fmt: skip


def odds_at_references(scene: Scene, force_noise: float, mass: float, mass_se: float) -> float:
    """Log odds that the readings at the references hold a wrong mass of this value and error, kg, over that they hold noise or a
    constant bias only, or, where that is far from it, the mass that they show; 0 where there are too few of them."""
    rows = reference_rows(scene)
    if len(rows) < READINGS.fewest or force_noise <= 0.0:
        return 0.0
    weight = np.einsum("nji,j->ni", scene.kin.R_tool[rows], scene.gravity_in_base).ravel()
    read, pose = scene.force_in_tool[rows].ravel(), np.repeat(scene.pose[rows], 3)
    bench, left = (Bench(f / force_noise, pose) for f in (read, read - mass * weight))
    bias = _block(np.tile(np.eye(3), (len(rows), 1)), force_noise, READINGS.bias_n)
    off = _block(weight[:, None], force_noise, max(mass_se, 1e-12))
    with_it = max((left.posterior(b) for b in (off, off + bias)), key=lambda p: p.log_evidence)
    odds = with_it.log_evidence - max(bench.posterior(bias).log_evidence, _nothing(bench))
    far = abs(float(with_it.x[0]))  # standard errors
    return min(odds, -0.5 * far**2) if far > SETTINGS.lasting.farthest else odds


def _block(A: Array, sigma: float, width: float) -> Block:
    free = np.full(A.shape[1], np.inf)
    return Block(A * width / sigma, -free, free, np.ones(A.shape[1]))


def _nothing(bench: Bench) -> float:
    """Log evidence of noise alone: a column that moves nothing."""
    idle: Posterior = bench.posterior(_block(np.zeros((len(bench.b), 1)), 1.0, 1.0))
    return idle.log_evidence
