# SPDX-License-Identifier: Apache-2.0
"""Thresholds that are declared with unit, meaning and derivation, so that a result can record what it was decided by."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TypeVar

from .typing import Json

Value = TypeVar("Value", float, int)


def threshold(value: Value, unit: str, meaning: str, derived: str) -> Value:
    """Field of a frozen dataclass of thresholds with this default."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "derived": derived})  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Thresholds:
    """Base of sets of thresholds; one may hold others."""

    def to_json(self) -> Json:
        """Name -> value, unit, meaning, derivation; of a set that is held, `set.name`."""
        out: Json = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Thresholds):
                out |= {f"{f.name}.{name}": entry for name, entry in value.to_json().items()}
            else:
                out[f.name] = {"value": value, **f.metadata}
        return out
