# SPDX-License-Identifier: Apache-2.0
"""Which parts of the page have to be drawn anew: only those that show something else than before.

A control that is drawn anew loses the focus of the keyboard; a key or click that meets the old one is not heard by the server.
"""

from __future__ import annotations

from typing import Any


class Redrawn:
    """Remembers what each part of a page shows."""

    def __init__(self) -> None:
        self._shown: dict[str, tuple[Any, ...]] = {}

    def due(self, part: str, *shows: Any) -> bool:
        """Whether a part shows something else now; from then on it counts as drawn.

        Args:
            shows: what the part is drawn from; objects are compared by identity, for arrays can't be compared at once.
        """
        before = self._shown.get(part)
        self._shown[part] = shows
        return before is None or len(before) != len(shows) or not all(map(_same, before, shows))


def _same(a: Any, b: Any) -> bool:
    return a is b or (isinstance(a, (bool, int, float, str)) and isinstance(b, (bool, int, float, str)) and a == b)
