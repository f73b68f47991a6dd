# SPDX-License-Identifier: Apache-2.0
"""A cell as it stands: robot at HOME and at its poses, surface with its normals, stations and what they see, the work box."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cell import Cell
from ..files import check_replaceable
from ..files.outputs import PICTURES
from ..poses.checker import Checker
from ..poses.store import PoseList
from ..typing import Array
from .style import pyplot, save

SEEN, HIDDEN, TOOL, ROBOT = "#009E73", "#D55E00", "#E69F00", "#0072B2"
VIEWS = (("from above", (0, 1)), ("from the side", (0, 2)), ("from the front", (1, 2)))


def save_cell_picture(cell: Cell, poses: PoseList | None, path: str | Path) -> tuple[Path, list[str]]:
    """Draw the cell in the cell frame, in space and from three sides; returns the file and a line about each station.

    Raises IrecError: matplotlib is not installed.
    """
    plt = pyplot()
    mesh = cell.surface.mesh()
    home = cell.robot.kinematics(cell.home[None])
    arm = np.vstack([np.zeros(3), home.origin[0], home.p_tcp[0]])
    hull = home.p_tcp[0] + cell.hull[:, :3] @ home.R_tool[0].T
    stations = np.array([s.p_in_cell for s in cell.stations])
    q = np.array([p.q for p in poses.poses]) if poses else np.zeros((0, cell.robot.n_joints))
    rail = np.array([p.ext.get("rail", 0.0) for p in poses.poses]) if poses else np.zeros(0)
    lines, seen_by, marker, arms = [], np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros((0, 0, 3))
    if len(q):
        checker, kin = Checker(cell), cell.robot.kinematics(q)
        base = cell.base_in_cell(rail)
        marker = kin.p_tcp + base + kin.R_tool @ cell.marker_in_tool
        best, visible = checker.line_of_sight(kin, base, -kin.R_tool[:, :, 2])
        seen_by = np.where(visible, best, -1)
        arms = np.concatenate([np.zeros((len(q), 1, 3)), kin.origin, kin.p_tcp[:, None]], axis=1) + base[:, None]
        for i, station in enumerate(cell.stations):
            lines.append(f"station {station.name}: sees the marker best at {int(np.sum(seen_by == i))} of {len(q)} poses")
        if (seen_by < 0).any():
            hidden = [poses.poses[i].index for i in np.flatnonzero(seen_by < 0)]  # type: ignore[union-attr]
            lines.append(f"no station sees the marker at the poses {', '.join(map(str, hidden))}")
    step = max(1, len(mesh.corners) // 150)
    foot = mesh.vertices[mesh.corners].mean(axis=1)[::step]
    normal = mesh.normal[::step]
    length = 0.08 * float(np.ptp(mesh.vertices, axis=0).max())
    box = _box(cell)

    figure = plt.figure(figsize=(15, 11))
    axes = figure.add_subplot(2, 2, 1, projection="3d", computed_zorder=False)
    axes.plot_trisurf(*mesh.vertices.T, triangles=mesh.corners, color="0.85", edgecolor="none", alpha=0.7)
    axes.quiver(*foot.T, *(length * normal).T, color="0.5", linewidth=0.5)
    _draw(axes, (0, 1, 2), arm, arms, hull, stations, marker, seen_by, box, cell)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"{cell.name}: cell frame (base_link, rail at 0)")
    axes.set_aspect("equal")
    for number, (title, (i, j)) in enumerate(VIEWS, start=2):
        flat = figure.add_subplot(2, 2, number)
        flat.triplot(mesh.vertices[:, i], mesh.vertices[:, j], mesh.corners, color="0.75", linewidth=0.3)
        flat.quiver(foot[:, i], foot[:, j], normal[:, i], normal[:, j], color="0.5", width=0.0015, scale=25)
        _draw(flat, (i, j), arm, arms, hull, stations, marker, seen_by, box, cell)
        flat.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=title)
        flat.set_aspect("equal", adjustable="datalim")
        flat.grid(alpha=0.3)
        if number == 2:
            flat.legend(loc="best", fontsize=8, frameon=False)
    figure.tight_layout()
    return save(figure, check_replaceable(path, "a picture", PICTURES), 110), lines


def _draw(axes, k, arm, arms, hull, stations, marker, seen_by, box, cell) -> None:  # type: ignore[no-untyped-def]
    """What stands in every view; k: the coordinates that it shows."""
    for one in arms[:: max(1, len(arms) // 12)]:
        axes.plot(*one[:, k].T, color=ROBOT, linewidth=0.6, alpha=0.35)
    axes.plot(*arm[:, k].T, "o-", color=ROBOT, linewidth=3, markersize=5, label="robot at HOME")
    axes.scatter(*hull[:, k].T, s=60, facecolor="none", edgecolor=TOOL, label="hull of the tool")
    for i, point in enumerate(marker):
        color = SEEN if seen_by[i] >= 0 else HIDDEN
        end = stations[max(seen_by[i], 0)]
        axes.plot(*np.array([point, end])[:, k].T, color=color, linewidth=0.5, alpha=0.6)
    if len(marker):
        axes.scatter(*marker[:, k].T, s=14, color=[SEEN if s >= 0 else HIDDEN for s in seen_by], label="marker at the poses")
    axes.scatter(*stations[:, k].T, marker="^", s=90, color="black", label="tracker stations")
    for station in cell.stations:
        axes.text(*station.p_in_cell[list(k)], f" {station.name}", fontsize=10, weight="bold")
    if cell.rail is not None:
        ends = np.array([cell.rail.lower, cell.rail.upper])[:, None] * cell.rail.axis
        axes.plot(*ends[:, k].T, color="0.3", linewidth=5, alpha=0.4, label="rail")
    if box is not None:
        for a, b in box:
            axes.plot(*np.array([a, b])[:, k].T, color="0.4", linewidth=0.7, linestyle=":")


def _box(cell: Cell) -> list[tuple[Array, Array]] | None:
    """Edges of the work box."""
    stated = cell.raw.get("workspace")
    if not stated:
        return None
    ends = np.array([stated["lower"], stated["upper"]], dtype=float)
    corners = np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return [(a, b) for n, a in enumerate(corners) for b in corners[n + 1 :] if np.sum(a != b) == 1]
