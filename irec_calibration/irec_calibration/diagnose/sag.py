# SPDX-License-Identifier: Apache-2.0
"""How much a session shows of what the arm sags more on the way from the reference to where it presses.

The masses of the robot description say how much that is (`model.sag_of`). But they may be rough, balancers carry a part, and a
controller that corrects for its own elasticity commands the sag away. Then what is taken off the measurement is an error of its
own, which passes for `geometry_error`. So the share of it that is seen is an unknown beside model and nonparametric remainder,
normal about 1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..identification.observe import Observation
from ..model import MOST_SAG, sag_of
from .ground import Ground
from .remainder import Remainder
from .settings import SETTINGS, Settings
from .study import Study

WIDTH = 0.5  # of the share, one standard deviation about 1
NOTE = "what the arm sags more under its own weight on the way from the reference to the contact"


def with_sag_as_seen(study: Study, remainder: Remainder, settings: Settings = SETTINGS) -> Observation | None:
    """The observation with the share of the sag that a model and its remainder leave room for; None where the one in use is as
    likely, and in sessions that don't see any."""
    observation = study.observation
    sag = sag_of(study.terms, observation.scene)
    if sag is None:
        return None
    share = observation.scene.view.sags
    found, log_odds = _share(study, remainder, observation.whiten(observation.of(sag)).reshape(-1, 1), share)
    if log_odds <= settings.nats_for_sag:
        return None
    size = float(np.sqrt((observation.of(sag) ** 2).sum(axis=1).mean()))
    return _seeing(observation, found, size)


def _share(study: Study, remainder: Remainder, sag: np.ndarray, share: float) -> tuple[float, float]:
    """The likeliest share, and its log odds against the one in use.

    Args:
        sag: all of it, whitened, (3m, 1).
    """
    ground = Ground(study.bench, remainder.block)
    V, u = ground.reduce(sag)
    noise = study.bench.noise
    variance = (ground.loss + noise.dof * noise.scale**2) / (len(study.bench.b) + noise.dof)
    seen = (float(sag[:, 0] @ sag[:, 0]) - float(V[:, 0] @ V[:, 0])) / variance
    precision = seen + WIDTH**-2.0
    # the equations have `share` of it taken off already, and 1 is expected
    likeliest = share + (float(u[0]) / variance + (1.0 - share) * WIDTH**-2.0) / precision
    found = float(np.clip(likeliest, 0.0, MOST_SAG))
    return found, 0.5 * precision * ((share - likeliest) ** 2 - (found - likeliest) ** 2)


def _seeing(observation: Observation, share: float, size: float) -> Observation:
    """An observation that sees a share of the sag, with a note; size: RMS of all of it, m."""
    session = observation.session
    note = (
        f"{NOTE}, {1e6 * size:.1f} um by the masses of the robot description, shows by {100.0 * share:.0f} %: those masses are"
        " wrong, a balancer carries the rest, or the controller corrects for it"
    )
    notes = (*(n for n in session.notes if not n.startswith(NOTE)), note)
    return replace(observation.seeing(share), session=replace(session, notes=notes))
