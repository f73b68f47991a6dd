# SPDX-License-Identifier: Apache-2.0
"""The picture of a plan: surface, pool, chosen poses, predicted uncertainty (the paper's Fig. 3)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cell import Cell
from ..files import check_replaceable
from ..files.outputs import PICTURES
from ..poses.plan import Plan
from .style import pyplot, save


def save_picture(cell: Cell, plan: Plan, path: str | Path) -> Path:
    """Draw surface, pool and chosen poses in the cell frame, and the predicted uncertainty over the surface.

    Raises IrecError: matplotlib is not installed.
    """
    plt = pyplot()
    mesh, pool, chosen = cell.surface.mesh(), plan.pool, plan.chosen
    figure = plt.figure(figsize=(15, 7))
    grid = figure.add_gridspec(1, 3, width_ratios=[1, 1, 0.035], left=0.045, right=0.93, bottom=0.02, top=0.9, wspace=0.1)
    view = np.mean(pool.normal_in_cell, axis=0)
    azimuth, elevation = np.degrees(np.arctan2(view[1], view[0])), np.degrees(np.arcsin(view[2] / np.linalg.norm(view)))
    for column, title in enumerate(("Pool and chosen poses", "Predicted uncertainty of the deflection")):
        axes = figure.add_subplot(grid[column], projection="3d", computed_zorder=False)
        axes.plot_trisurf(*mesh.vertices.T, triangles=mesh.corners, color="0.93", edgecolor="none", alpha=0.6, zorder=0)
        if column == 0:
            axes.scatter(*pool.p_in_cell.T, s=3, color="0.35", linewidths=0, label=f"pool, {len(pool)}", zorder=1)
            axes.scatter(*pool.p_in_cell[chosen].T, s=60, color="tab:cyan", edgecolor="black", linewidths=0.7,
                         label=f"{plan.method}, {len(chosen)}, in order of choice", zorder=3)  # fmt: skip
            for number, p in enumerate(pool.p_in_cell[chosen] + 0.05 * pool.normal_in_cell[chosen], start=1):
                axes.text(*p, str(number), fontsize=8, weight="bold", ha="center", zorder=4)
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.0), frameon=False)
        else:
            low, high = np.percentile(1e6 * plan.uncertainty, [0, 98])
            shown = axes.scatter(*pool.p_in_cell.T, s=10, c=1e6 * plan.uncertainty, cmap="viridis", linewidths=0,
                                 vmin=low, vmax=high, zorder=1)  # fmt: skip
            axes.scatter(*pool.p_in_cell[chosen].T, s=36, facecolor="none", edgecolor="#D55E00", linewidths=1.0,
                         label="chosen poses", zorder=3)  # fmt: skip
            bar = figure.colorbar(shown, cax=figure.add_subplot(grid[2]), extend="max")
            bar.set_label("standard deviation, worst load case [um]")
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.0), frameon=False)
        axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
        axes.set_title(title, y=1.0)
        axes.set_aspect("equal")
        axes.view_init(elev=max(elevation - 10, 15), azim=azimuth + 18)
        axes.locator_params(nbins=5)
    f = plan.figures
    figure.suptitle(
        f"{cell.name}: {len(chosen)} poses by {plan.method}, cover distance {1e3 * f['cover_distance_m']:.0f} mm, "
        f"O1 {f['o1']:.3g}, condition {f['condition']:.3g}",
        y=0.98,
    )
    return save(figure, check_replaceable(path, "a picture", PICTURES), 130)
