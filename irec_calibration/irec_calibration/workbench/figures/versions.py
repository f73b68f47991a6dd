# SPDX-License-Identifier: Apache-2.0
"""How the error fell from version to version, and how accuracy grows with the poses measured."""

from __future__ import annotations

import numpy as np

from ...identification.validation import rms
from ...typing import BoolArray
from ..plain import Codecs, CourseView, Tried, Version
from .look import BLUE, CONFIG, ORANGE, VERMILLION, Figure, Look, layout_of, short, um

LABEL_ROOM = 1.2  # top of the axis over the highest point, which carries its figure above it


def ladder(
    versions: list[Version], current: int, tried: Tried | None, look: Look | None = None, group: BoolArray | None = None
) -> Figure:
    """Held-out error of every version with its standard error, the noise floor, what is being tried; of a group where given."""
    look = look or Look()
    x = list(range(1, len(versions) + 1))
    y = [um(_of_group(v, group)) for v in versions]
    error = [um(v.cv_rms_se_m) if group is None else None for v in versions]
    names = [f"{i}. {short(v.name)}" for i, v in zip(x, versions, strict=True)]
    sizes = [15 if i == current else 10 for i in range(len(versions))]
    data: list[Figure] = [
        {
            "type": "scatter",
            "mode": "lines+markers+text",
            "x": x,
            "y": y,
            "name": "versions",
            "customdata": list(range(len(x))),
            "error_y": {"type": "data", "array": error, "thickness": 1.5, "color": look.ink},
            "marker": {
                "size": sizes,
                "color": BLUE,
                "line": {"width": [3 if i == current else 0 for i in range(len(x))], "color": ORANGE},
            },
            "line": {"color": look.quiet, "width": 1},
            "text": [f"{v:.3g}" if v is not None else "" for v in y],
            "textposition": "top right",
            "textfont": {"color": look.ink},
            "hovertemplate": "%{text} um<extra></extra>",
        }
    ]
    if tried is not None:
        at = len(versions) + 1
        promised = _of_group(tried, group)
        x_t, y_t = [current + 1, at], [y[current] if y else None, um(promised)]
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers+text",
                "x": x_t,
                "y": y_t,
                "name": "tried",
                "line": {"dash": "dot", "color": ORANGE},
                "marker": {"size": [0, 13], "symbol": "diamond-open", "color": VERMILLION, "line": {"width": 3}},
                "text": ["", f"{1e6 * promised:.3g}?"],
                "textposition": "top right",
                "textfont": {"color": look.ink},
                "hovertemplate": "tried: %{y:.1f} um<extra></extra>",
            }
        )
        x, names = [*x, at], [*names, f"try {short(tried.effect)}"]
    title = "held-out error [um]" if group is None else "of the group [um]"
    now = versions[current] if versions else None
    floor = 0.0 if now is None else 1e6 * (now.noise_m if group is None else float(np.sqrt(np.mean(now.sigma[group] ** 2))))
    highest = [floor, *(v for d in data for v in d["y"] if v is not None)]
    top = LABEL_ROOM * max(*highest, 1.0)
    layout = layout_of(look)
    layout |= {
        "xaxis": {
            "tickvals": x,
            "ticktext": names,
            "range": [0.5, len(x) + 0.7],
            "color": look.ink,
            "gridcolor": look.grid,
            "tickangle": 0,
        },
        "yaxis": {
            "title": {"text": title},
            "range": [0.0, top],
            "color": look.ink,
            "gridcolor": look.grid,
        },
        "showlegend": False,
        "shapes": [
            {
                "type": "line",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "y0": floor,
                "y1": floor,
                "line": {"dash": "dash", "color": look.quiet},
            }
        ],
        "annotations": [
            {
                "xref": "paper",
                "x": 0.01,
                "y": floor,
                "yanchor": "bottom",
                "xanchor": "left",
                "text": f"noise {floor:.1f} um",
                "showarrow": False,
                "font": {"color": look.quiet, "size": 11},
            }
        ],
    }
    return {"data": data, "layout": layout, "config": CONFIG}


def _of_group(made: Version | Tried, group: BoolArray | None) -> float:
    """Held-out error of all samples, or of a group of them, m."""
    if group is None or len(made.held_out) != len(group):
        return made.cv_rms_m
    return rms(made.held_out[group])


def growth(codecs: Codecs | None, look: Look | None = None) -> Figure:
    """CODEC: median and quartiles of the error on unseen poses against the number of training poses, one colour per version."""
    look = look or Look()
    data: list[Figure] = []
    colours = ((BLUE, "rgba(0,114,178,0.18)", "solid"), (ORANGE, "rgba(230,159,0,0.22)", "dash"))
    for (name, q), (colour, fill, dash) in zip((codecs.quartiles if codecs else {}).items(), colours, strict=False):
        x = list(range(1, q.shape[1] + 1))
        data.append(
            {
                "type": "scatter",
                "x": x + x[::-1],
                "y": [*q[2].round(5).tolist(), *q[0][::-1].round(5).tolist()],
                "fill": "toself",
                "fillcolor": fill,
                "line": {"width": 0},
                "hoverinfo": "skip",
                "showlegend": False,
            }
        )
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": x,
                "y": q[1].round(5).tolist(),
                "name": short(name),
                "line": {"color": colour, "dash": dash, "width": 2.5},
            }
        )
    layout = layout_of(look)
    top = max((float(np.median(q[1][1:])) * 4 for q in codecs.quartiles.values()), default=1.0) if codecs else 1.0
    layout |= {
        "xaxis": {"title": {"text": "training poses"}, "color": look.ink, "gridcolor": look.grid},
        "yaxis": {"title": {"text": "error on unseen poses [mm]"}, "range": [0, top], "color": look.ink, "gridcolor": look.grid},
        "legend": {"x": 1, "xanchor": "right", "y": 1, "font": {"color": look.ink}},
    }
    if codecs is not None and np.isfinite(codecs.floor_mm):
        layout["shapes"] = [
            {
                "type": "line",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "y0": codecs.floor_mm,
                "y1": codecs.floor_mm,
                "line": {"dash": "dash", "color": look.quiet},
            }
        ]
        layout["annotations"] = [
            {
                "xref": "paper",
                "x": 0.01,
                "y": codecs.floor_mm,
                "yanchor": "bottom",
                "text": "noise alone",
                "showarrow": False,
                "font": {"color": look.quiet, "size": 11},
            }
        ]
    return {"data": data, "layout": layout, "config": CONFIG}


def course(driven: CourseView | None, look: Look | None = None) -> Figure:
    """Lateral deviation along the process course: without correction and corrected with the first version."""
    look = look or Look()
    data: list[Figure] = []
    layout = layout_of(look)
    layout |= {
        "xaxis": {"title": {"text": "way along the course [m]"}, "color": look.ink, "gridcolor": look.grid},
        "yaxis": {
            "title": {"text": "lateral deviation [mm]"}, "rangemode": "tozero", "color": look.ink, "gridcolor": look.grid,
        },
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "font": {"size": 11, "color": look.ink}},
        "margin": {"l": 55, "r": 10, "t": 30, "b": 40},
    }  # fmt: skip
    if driven is None or not len(driven.s):
        return {"data": data, "layout": layout, "config": CONFIG}
    lines = (
        ("without correction", driven.without, VERMILLION, "solid"),
        ("corrected with the first version", driven.before, ORANGE, "dash"),
        ("standard error of the version in use", driven.se, BLUE, "dot"),
        ("tolerance", np.full(len(driven.s), driven.tolerance), look.quiet, "longdash"),
    )
    for name, y, colour, dash in lines:
        data.append(
            {
                "type": "scatter", "mode": "lines", "name": name,
                "x": driven.s.round(4).tolist(), "y": (1e3 * y).round(5).tolist(),
                "line": {"color": colour, "dash": dash, "width": 2},
            }
        )  # fmt: skip
    return {"data": data, "layout": layout, "config": CONFIG}
