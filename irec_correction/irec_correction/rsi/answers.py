# SPDX-License-Identifier: Apache-2.0
"""Answers to a controller: what to do with a packet, what an answer holds, and how far two of them may be apart."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from irec_calibration.typing import Array

from ..limits import OffsetLimits
from .delay_count import LAG


class Action(Enum):
    """What to do with a packet."""

    NEXT = "go on from the answer before"
    HOLD = "cycles went wrong: send what the controller may hold, go on from rest"
    START = "a new session, which holds no correction"
    SILENT = "any answer could be a jump, or the packet is not of this cycle: no answer"


@dataclass(frozen=True)
class Answer:
    """An offset, translation (3,), m, and rotation vector (3,), rad, and its bytes up to the IPOC."""

    translation: Array
    rotation: Array
    text: bytes


def per_answer(limits: OffsetLimits) -> OffsetLimits:
    """Limits for a source of answers: LAG + 1 answers in a row stay within one step of the limits given."""
    share = 1.0 / (LAG + 1)
    return replace(
        limits,
        translation=replace(limits.translation, rate=share * limits.translation.rate),
        rotation=replace(limits.rotation, rate=share * limits.rotation.rate),
    )
