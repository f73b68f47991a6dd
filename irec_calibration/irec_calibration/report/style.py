# SPDX-License-Identifier: Apache-2.0
"""One look for all figures: quiet axes, a palette that colour-blind readers tell apart, units on every axis.

Colours are those of Okabe and Ito. Nothing is told by colour alone: lines also differ in dashes, named bars in hatching.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from ..errors import IrecError
from ..files import write_file

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


def save(figure: Any, path: str | Path, dpi: int | None = None) -> Path:
    """Write a figure as its suffix says (PNG, PDF, SVG) and close it. IrecError: it can't be written."""
    buffer = io.BytesIO()  # a disk that is full is told of by write_file, as everywhere
    figure.savefig(buffer, format=Path(path).suffix[1:] or "png", dpi=dpi or pyplot().rcParams["savefig.dpi"])
    pyplot().close(figure)
    return write_file(path, buffer.getvalue())
