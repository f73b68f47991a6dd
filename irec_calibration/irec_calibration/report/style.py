# SPDX-License-Identifier: Apache-2.0
"""One look for all figures: quiet axes, a palette that colour-blind readers tell apart, units on every axis.

Colours are those of Okabe and Ito. Nothing is told by colour alone: lines also differ in dashes, named bars in hatching.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import IrecError

BLUE, ORANGE, GREEN, RED, GREY, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#7a808a", "#CC79A7"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
DASHES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^")
CONTINUOUS = "cividis"
NOISE_LABEL = "instrument noise"


def pyplot() -> Any:
    """matplotlib.pyplot without a display, in the look of irec. Raises IrecError where matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError as error:
        raise IrecError("figures need matplotlib: pip install 'irec_calibration[report]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "figure.dpi": 110,
            "savefig.dpi": 150,
            "savefig.bbox": "tight",
            "font.size": 10,
            "axes.titlesize": 11,
            "axes.titleweight": "bold",
            "axes.titlelocation": "left",
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.alpha": 0.25,
            "axes.axisbelow": True,
            "axes.prop_cycle": plt.cycler(color=list(CYCLE)),
            "legend.frameon": False,
        }
    )
    return plt


def save(figure: Any, path: str | Path) -> Path:
    """Write a figure as PNG and close it."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    pyplot().close(figure)
    return path
