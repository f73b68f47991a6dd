# SPDX-License-Identifier: Apache-2.0
"""The cell in 3D: robot, surface, stations, samples and their magnified residuals."""

from __future__ import annotations

import numpy as np

from ...typing import Array, BoolArray, IntArray
from ..plain import SessionView, Version
from ..shapes import capsules, link_radii
from .look import BY_RESIDUAL, CONFIG, PURPLE, VERMILLION, Figure, Look, colour_values, hover, layout_of

SCALE = "Cividis"
MOST_LABELS = 80
DISTANCE = 1.9  # of the camera, in radii of what is near: arm and poses fill a wide picture


def nice_scale(view: SessionView, residual: Array) -> float:
    """How much to magnify residuals so that the largest is a fifth of where the poses are, rounded to 1, 2 or 5."""
    extent = float(np.ptp(view.p_tcp, axis=0).max()) or 0.5
    largest = float(np.nanmax(np.linalg.norm(residual, axis=1))) if len(residual) else 0.0
    if largest <= 0.0:
        return 1.0
    wanted = 0.2 * extent / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(s for s in (1.0, 2.0, 5.0) if s * power <= wanted * 1.0001))


def cell(
    view: SessionView,
    version: Version,
    residual: Array,
    *,
    magnify: float,
    by: str = BY_RESIDUAL,
    ghost: Array | None = None,
    selected: int | None = None,
    group: BoolArray | None = None,
    surface: tuple[Array, IntArray] | None = None,
    robot: bool = True,
    numbers: bool = True,
    look: Look | None = None,
    top: float = 0.0,
) -> Figure:
    """The cell in 3D: robot at the selected sample, surface, stations, TCP positions, magnified residuals; m.

    `top`: residual at the end of the colours, m, so that versions can be compared; the largest one where 0.
    """
    look = look or Look()
    p = view.p_tcp[version.rows]
    values, title = colour_values(view, version, residual, by)
    shown = np.ones(len(p), dtype=bool) if group is None else group
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if len(values) else (0.0, 1.0)
    if by == BY_RESIDUAL:
        low, high = 0.0, 1e6 * top if top > 0.0 else high
    traces: list[Figure] = []
    if surface is not None:
        traces.append(_mesh(*surface, "#8a8f98", 0.25, "surface"))
    if robot and len(view.joints):
        at = version.rows[selected] if selected is not None else version.rows[0] if len(version.rows) else 0
        joints = view.joints[at]
        traces.append(_mesh(*capsules(joints, link_radii(joints)), "#c9a227" if look.dark else "#d9a441", 1.0, "robot"))
    for name, place in view.stations.items():
        traces.append(
            _points(
                np.array([place]), f"tracker {name}", {"symbol": "diamond", "size": 7, "color": PURPLE}, text=[f"tracker {name}"]
            )
        )
    if ghost is not None:
        traces.append(_arrows(p[shown], magnify * ghost[shown], {"color": look.quiet, "width": 2}, "residual before", 0.55))
    tips = magnify * residual[shown]
    colour = {"color": np.repeat(values[shown], 3).round(3).tolist(), "colorscale": SCALE, "cmin": low, "cmax": high, "width": 5}
    traces.append(_arrows(p[shown], tips, colour, "residual", 1.0))
    words = hover(view, version, residual)
    marker = {
        "size": 3.5,
        "color": values[shown].round(3).tolist(),
        "colorscale": SCALE,
        "cmin": low,
        "cmax": high,
        "colorbar": {
            "title": {"text": title, "side": "right", "font": {"color": look.ink}},
            "thickness": 12,
            "len": 0.75,
            "tickfont": {"color": look.ink},
        },
    }
    dots = _points(p[shown], "samples", marker)
    dots |= {
        "customdata": np.flatnonzero(shown).tolist(),
        "text": [words[i] for i in np.flatnonzero(shown)],
        "hovertemplate": "%{text}<extra></extra>",
    }
    traces.append(dots)
    if group is not None and not group.all():
        rest = _points(p[~group], "other samples", {"size": 3, "color": look.quiet, "opacity": 0.4})
        traces.append(rest | {"customdata": np.flatnonzero(~group).tolist(), "hoverinfo": "skip"})
    if numbers:
        traces.append(_pose_numbers(view, version, look))
    if selected is not None:
        traces.append(
            _points(
                p[selected : selected + 1],
                "selected",
                {"size": 12, "symbol": "circle-open", "color": VERMILLION, "line": {"width": 4}},
            )
        )
    style = {
        "gridcolor": look.grid,
        "zerolinecolor": look.grid,
        "color": look.ink,
        "backgroundcolor": look.paper,
        "showspikes": False,
    }
    spans, aspect, camera = _space(view, p, surface)
    layout = layout_of(look)
    layout |= {
        "scene": {
            **{f"{a}axis": style | {"title": {"text": f"{a} [m]"}, "range": span} for a, span in zip("xyz", spans.tolist())},
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", aspect.tolist())),
            "camera": camera,
        },
        "showlegend": False,
        "uirevision": "cell",
        "margin": {"l": 0, "r": 0, "t": 26, "b": 0},
        "title": {"text": _key(magnify), "font": {"size": 12, "color": look.ink}, "x": 0.02, "y": 0.985},
    }
    return {"data": traces, "layout": layout, "config": CONFIG}


def _space(view: SessionView, p: Array, surface: tuple[Array, IntArray] | None) -> tuple[Array, Array, Figure]:
    """Ranges of the axes (3, 2), their lengths on the screen (3,), and a camera that looks from the side at arm and poses.

    Trackers stand far away: they are in the ranges, but the camera is near enough to see the arrows.
    """
    joints = view.joints[0] if len(view.joints) else np.zeros((1, 3))
    near = np.concatenate([p, joints, *([surface[0]] if surface is not None else [])])
    everything = np.concatenate([near, *(np.array([s]) for s in view.stations.values())])
    low, high = everything.min(axis=0) - 0.15, everything.max(axis=0) + 0.15
    size = high - low
    unit = float(np.prod(size)) ** (1.0 / 3.0)
    aspect = size / unit
    middle, base = p.mean(axis=0) if len(p) else near.mean(axis=0), joints[0]
    ahead = (middle - base) * [1.0, 1.0, 0.0]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0.0, 0.0])
    side = np.cross([0.0, 0.0, 1.0], ahead)
    others = [np.asarray(s) - middle for s in view.stations.values()]
    if others and float(np.mean([o @ side for o in others])) > 0.0:
        side = -side  # away from the trackers
    direction = side - 0.35 * ahead + [0.0, 0.0, 0.45]
    centre = 0.5 * (near.min(axis=0) + near.max(axis=0))
    looked_at = (centre - 0.5 * (low + high)) / unit
    reach = DISTANCE * 0.5 * float(np.linalg.norm(np.ptp(near, axis=0))) / unit
    eye = looked_at + reach * direction / np.linalg.norm(direction)
    return (
        np.stack([low, high], axis=1),
        aspect,
        {"center": dict(zip("xyz", looked_at.tolist())), "eye": dict(zip("xyz", eye.tolist()))},
    )


def _key(magnify: float) -> str:
    for um in (500.0, 200.0, 100.0, 50.0, 20.0, 10.0, 5.0, 1.0):
        if um * 1e-6 * magnify <= 0.12:
            break
    return f"residuals drawn {magnify:g} times: {um:g} um is {1e-3 * um * magnify:g} mm long"


def _mesh(vertices: Array, triangles: IntArray, colour: str, opacity: float, name: str) -> Figure:
    x, y, z = (vertices[:, a].round(4).tolist() for a in range(3))
    i, j, k = (triangles[:, a].tolist() for a in range(3))
    return {
        "type": "mesh3d",
        "x": x,
        "y": y,
        "z": z,
        "i": i,
        "j": j,
        "k": k,
        "color": colour,
        "opacity": opacity,
        "name": name,
        "hoverinfo": "skip",
        "flatshading": False,
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
    }


def _points(p: Array, name: str, marker: Figure, text: list[str] | None = None) -> Figure:
    out: Figure = {"type": "scatter3d", "mode": "markers" if text is None else "markers+text", "name": name, "marker": marker}
    for a, axis in enumerate("xyz"):
        out[axis] = p[:, a].round(5).tolist()
    if text is not None:
        out |= {"text": text, "textposition": "top center", "hoverinfo": "text"}
    return out


def _arrows(p: Array, along: Array, line: Figure, name: str, opacity: float) -> Figure:
    """Lines from p to p + along; a None between two, in one trace."""
    out: Figure = {"type": "scatter3d", "mode": "lines", "name": name, "line": line, "opacity": opacity, "hoverinfo": "skip"}
    for a, axis in enumerate("xyz"):
        ends = np.stack([p[:, a], p[:, a] + along[:, a]], axis=1).round(5).astype(object)
        out[axis] = np.concatenate([ends, np.full((len(p), 1), None)], axis=1).reshape(-1).tolist()
    return out


def _pose_numbers(view: SessionView, version: Version, look: Look) -> Figure:
    pose = view.pose[version.rows]
    numbers = np.unique(pose)
    shown = numbers[:: max(1, -(-len(numbers) // MOST_LABELS))]
    centres = np.array([view.p_tcp[version.rows][pose == n].mean(axis=0) for n in shown]).reshape(-1, 3)
    out: Figure = {
        "type": "scatter3d",
        "mode": "text",
        "text": [str(n) for n in shown],
        "textposition": "top center",
        "textfont": {"size": 11, "color": look.ink},
        "hoverinfo": "skip",
        "name": "pose numbers",
    }
    for a, axis in enumerate("xyz"):
        out[axis] = centres[:, a].round(4).tolist()
    return out
