# SPDX-License-Identifier: Apache-2.0
"""Sample by sample: norms of what was commanded, measured and left; the residual against one variable."""

from __future__ import annotations

import numpy as np

from ...typing import Array, BoolArray
from ..plain import SessionView, Version
from .look import BLUE, CONFIG, GREEN, ORANGE, VERMILLION, Figure, Look, colour_values, hover, layout_of


def norms(
    view: SessionView,
    version: Version,
    residual: Array,
    ghost: Array | None = None,
    group: BoolArray | None = None,
    look: Look | None = None,
) -> Figure:
    """Norm of the commanded displacement (above) and of the residual with its noise (below), sample by sample; can be brushed."""
    look = look or Look()
    n = len(version.rows)
    x = list(range(n))
    size = (1e6 * np.linalg.norm(residual, axis=1)).round(2)
    words = hover(view, version, residual)
    chosen = None if group is None else np.flatnonzero(group).tolist()
    commanded = 1e3 * np.linalg.norm(view.commanded[version.rows], axis=1)
    measured = 1e3 * np.linalg.norm(version.measured, axis=1)
    dots = "scattergl" if n > 400 else "bar"
    style: Figure = {"marker": {"color": BLUE, "size": 5}} if dots == "scattergl" else {"marker": {"color": BLUE}}
    data: list[Figure] = []
    if ghost is not None:
        before = (1e6 * np.linalg.norm(ghost, axis=1)).round(2).tolist()
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": x,
                "y": before,
                "name": "residual before",
                "hoverinfo": "skip",
                "line": {"color": look.quiet, "width": 1.5, "shape": "hvh"},
            }
        )
    data.append(
        {
            "type": dots,
            "x": x,
            "y": size.tolist(),
            "name": "residual",
            "text": words,
            "hovertemplate": "%{text}<extra></extra>",
            "customdata": x,
            "selectedpoints": chosen,
            "textposition": "none",
            **({"mode": "markers"} if dots == "scattergl" else {}),
            **style,
        }
    )
    data.append(
        {
            "type": "scatter",
            "mode": "lines",
            "x": x,
            "y": (1e6 * version.sigma).round(2).tolist(),
            "name": "noise, one sigma",
            "line": {"color": VERMILLION, "dash": "dash", "width": 1.5},
            "hoverinfo": "skip",
        }
    )
    upper: list[Figure] = [
        {
            "type": "scatter",
            "mode": "lines+markers",  # markers can be taken as a group with the mouse, lines can't
            "x": x,
            "y": measured.round(4).tolist(),
            "name": "measured deflection",
            "customdata": x,
            "marker": {"size": 3},
            "yaxis": "y2",
            "line": {"color": ORANGE, "width": 1.5, "shape": "hvh"},
            "hoverinfo": "skip",
        }
    ]
    if commanded.max(initial=0.0) > 0.0:
        upper.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": x,
                "y": commanded.round(4).tolist(),
                "name": "commanded displacement",
                "yaxis": "y2",
                "line": {"color": GREEN, "width": 1, "dash": "dot", "shape": "hvh"},
                "hoverinfo": "skip",
            }
        )
    top = 1.08 * max(commanded.max(initial=0.0), measured.max(initial=0.0), 1e-6)
    pose = view.pose[version.rows]
    first = np.flatnonzero(np.diff(pose, prepend=pose[0] - 1)) if n else np.zeros(0, dtype=int)
    first = first[:: max(1, len(first) // 16)]
    axis = {"color": look.ink, "gridcolor": look.grid}
    layout = layout_of(look)
    layout |= {
        "dragmode": "select",
        "selectdirection": "h",
        "barmode": "overlay",
        "bargap": 0.05,
        "uirevision": "norms",
        "xaxis": {
            **axis,
            "tickvals": first.tolist(),
            "ticktext": [str(int(v)) for v in pose[first]],
            "title": {"text": "pose"},
            "anchor": "y",
        },
        "yaxis": {**axis, "domain": [0.0, 0.58], "title": {"text": "residual [um]"}, "rangemode": "tozero"},
        "yaxis2": {**axis, "domain": [0.66, 1.0], "title": {"text": "[mm]"}, "range": [0.0, top]},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "font": {"size": 10, "color": look.ink}},
        "margin": {"l": 55, "r": 10, "t": 30, "b": 36},
    }
    return {"data": data + upper, "layout": layout, "config": CONFIG}


def against(
    view: SessionView, version: Version, residual: Array, column: str, group: BoolArray | None, look: Look | None = None
) -> Figure:
    """Residual along base x, y and z against one variable."""
    look = look or Look()
    values, title = colour_values(view, version, residual, column)
    floor = 1e6 * float(np.sqrt(np.mean(version.sigma**2) / 3.0)) if len(version.sigma) else 0.0
    looks = ((BLUE, "circle"), (ORANGE, "square"), (GREEN, "diamond"))
    data: list[Figure] = []
    shown = np.ones(len(values), dtype=bool) if group is None else group
    for a, (colour, symbol) in enumerate(looks):
        data.append(
            {
                "type": "scattergl",
                "mode": "markers",
                "x": values[shown].round(5).tolist(),
                "name": f"base {'xyz'[a]}",
                "y": (1e6 * residual[shown, a]).round(2).tolist(),
                "marker": {"color": colour, "symbol": symbol, "size": 6},
                "customdata": np.flatnonzero(shown).tolist(),
                "hovertemplate": "%{x:.4g}: %{y:.0f} um<extra></extra>",
            }
        )
    layout = layout_of(look)
    layout |= {
        "xaxis": {"title": {"text": title}, "color": look.ink, "gridcolor": look.grid, "zeroline": False},
        "yaxis": {"title": {"text": "residual [um]"}, "color": look.ink, "gridcolor": look.grid},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "font": {"color": look.ink}},
        "shapes": [
            {
                "type": "rect",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "y0": -floor,
                "y1": floor,
                "fillcolor": look.quiet,
                "opacity": 0.2,
                "line": {"width": 0},
                "layer": "below",
            }
        ],
        "margin": {"l": 55, "r": 10, "t": 30, "b": 40},
    }
    return {"data": data, "layout": layout, "config": CONFIG}
