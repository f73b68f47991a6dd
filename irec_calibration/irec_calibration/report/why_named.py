# SPDX-License-Identifier: Apache-2.0
"""Why a verdict names another effect than the one with the smallest bar."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..diagnose.result import Candidate
from ..lengths import length

CERTAIN_NATS = 14.0  # a factor of a million
LEAST_NATS = 0.5  # below it one effect has no more evidence than the other


def contradiction(shown: Sequence[Candidate], named: Sequence[str], one_of: Sequence[Sequence[str]] = ()) -> list[str]:
    """Why the verdict names another effect than the one with the smallest bar, where it does.

    Args:
        shown: candidates whose bars are shown; named: effects that the verdict names; one_of: sets of which it says that one is
            missing.
    """
    chosen = [c for c in shown if c.effect in named]
    if not chosen or not shown:
        return []
    best = min(shown, key=lambda c: c.cv_rms_m)
    lead = min(chosen, key=lambda c: c.cv_rms_m)
    if best.effect in named or best.cv_rms_m >= lead.cv_rms_m:
        return []
    apart = abs(best.cv_rms_m - lead.cv_rms_m)
    error = float(np.hypot(best.cv_rms_se_m, lead.cv_rms_se_m))
    begin = (
        f"Why {lead.effect} is named although {best.effect} has the smaller bar: the bars differ by {length(apart)} (standard"
        f" error {length(error)})"
    )
    mine = next((s for s in one_of if best.effect in s), ())
    if mine:
        return [
            f"{begin}, and each bar is of one effect alone. {lead.effect} is needed beside all others of the model; beside it one"
            f" of {', '.join(mine)} is needed too, but these data do not tell which."
        ]
    nats = lead.log_evidence - best.log_evidence
    if nats > LEAST_NATS:
        return [
            f"{begin}, while the evidence weighs every sample, and in how many ways each effect was tried: it favours"
            f" {lead.effect} by a factor of {_odds(nats)}."
        ]
    much = "more" if nats < -LEAST_NATS else "as much"
    return [
        f"{begin}. They and the log odds in this table are of one effect alone, and alone {best.effect} has {much} evidence."
        f" {lead.effect} is named because it is needed beside all others of the model that was built, where {best.effect} is not"
        " needed any more, or is refused as a cause."
    ]


def _odds(nats: float) -> str:
    if nats > CERTAIN_NATS:
        return "over a million"
    return f"{np.exp(nats):,.0f}" if nats > 2.3 else f"{np.exp(nats):.1f}"
