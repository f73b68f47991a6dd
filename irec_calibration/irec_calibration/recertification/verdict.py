# SPDX-License-Identifier: Apache-2.0
"""The verdicts of a recertification: `pass`, `recalibrated`, `investigate: what` or `failed: why`."""

from __future__ import annotations

from enum import StrEnum


class Kind(StrEnum):
    """What stands before the colon of a verdict."""

    PASS = "pass"
    RECALIBRATED = "recalibrated"
    INVESTIGATE = "investigate"
    FAILED = "failed"


def kind_of(verdict: str) -> Kind:
    """The kind of a verdict; FAILED where it is none that is known."""
    word = verdict.partition(":")[0]
    return Kind(word) if word in tuple(Kind) else Kind.FAILED
