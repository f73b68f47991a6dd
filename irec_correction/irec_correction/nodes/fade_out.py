# SPDX-License-Identifier: Apache-2.0
"""How a node whose offset is not at zero is kept from ending, and brought to zero where it can't be kept."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..correction import Correction, Output
from ..state import State

REST_MARGIN = 1.0  # s beyond the fade within which the offset is at zero


def not_at_zero(state: State) -> str:
    """Why a node can't be cleaned up: a stream that ends before its offset is at zero makes a step."""
    return f"the offset is in {state.name}, not at zero yet; ask again when it is INACTIVE or FAULT"


def fade_out_now(correction: Correction, now: float, publish: Callable[[float, Output], None]) -> None:
    """Fade the offset out here and now, without inputs, for a node that nobody calls any more; at most the fade and a second.

    Args:
        now: time of the chain, s. publish: called with that time and what each tick gave.
    """
    begun, passed = time.monotonic(), 0.0
    correction.stop(now, "the node is shut down")
    while not correction.at_rest and passed < correction.settings.times.fade + REST_MARGIN:
        time.sleep(correction.settings.period)
        passed = time.monotonic() - begun
        publish(now + passed, correction.tick(now + passed))
