# SPDX-License-Identifier: Apache-2.0
"""How wrong a model's predictions are to be expected, as its file says."""

from __future__ import annotations

from ..lengths import length
from ..model import Model


def expected_in_words(model: Model) -> list[str]:
    """One line for a terminal; none where the model does not say."""
    tcp, reflector = (model.figures.get(f"expected_error{at}_m") for at in ("", "_reflector"))
    if not isinstance(tcp, float) or not isinstance(reflector, float):
        return []
    at = f"{length(tcp)} at the TCP, {length(reflector)} at the reflector"
    return [f"expected error of predictions: {at} (RMS, at poses and forces as of its session)"]
