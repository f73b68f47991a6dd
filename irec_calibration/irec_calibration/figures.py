# SPDX-License-Identifier: Apache-2.0
"""matplotlib, loaded only when a picture is asked for, without a display."""

from __future__ import annotations

from typing import Any

from .errors import IrecError


def pyplot() -> Any:
    """matplotlib.pyplot with the Agg backend. Raises IrecError: matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError as error:
        raise IrecError("pictures need matplotlib: pip install 'irec_calibration[report]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
