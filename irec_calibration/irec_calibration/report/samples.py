# SPDX-License-Identifier: Apache-2.0
"""Figures of single samples: norms per sample (paper, Fig. 8g), predicted against measured, residuals where the poses are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..identification.validation import rms
from ..lengths import length, unit_of
from ..typing import Array, IntArray
from . import style

MOST_ARROWS = 400  # beyond it one arrow per pose: the mean of its samples
MOST_NUMBERS = 60


def norms_per_sample(
    commanded: Array,
    residual: Array,
    floor: float,
    path: str | Path,
    *,
    poses: IntArray | None = None,
    measured: Array | None = None,
) -> Path:
    """Norms of what was commanded, what was measured and what the model leaves, sample by sample, each with its own axis.

    Args:
        commanded: displacement commanded against the reference, (m, 3), m; its panel is left out where all are 0.
        residual: measured minus predicted, (m, 3), m.
        floor: noise, m.
        poses: pose number of each sample, (m,), for the ticks.
        measured: measured deflection, (m, 3), m.
    """
    plt = style.pyplot()
    x = np.arange(1, len(residual) + 1)
    upper = [("commanded displacement [mm]", np.linalg.norm(commanded, axis=1), style.GREY)]
    if measured is not None:
        upper.append(("measured deflection [mm]", np.linalg.norm(measured, axis=1), style.ORANGE))
    upper = [u for u in upper if u[1].max(initial=0.0) > 1e-9]
    figure, axes = plt.subplots(len(upper) + 1, 1, figsize=(9, 2.0 * len(upper) + 2.6), sharex=True, squeeze=False,
                                height_ratios=[2] * len(upper) + [3])  # fmt: skip
    for ax, (label, values, colour) in zip(axes[:, 0], upper, strict=False):
        ax.bar(x, 1e3 * values, color=colour, width=1.0)
        ax.set_ylabel(label.replace(" [", "\n["))
        ax.set_ylim(bottom=0)
    bottom = axes[-1, 0]
    size = np.linalg.norm(residual, axis=1)
    factor, unit = unit_of(max(float(size.max(initial=0.0)), floor))
    size = factor * size
    bottom.bar(x, size, color=style.BLUE, width=1.0)
    bottom.axhline(factor * floor, color=style.RED, ls="--", label=f"{style.NOISE_LABEL}, {length(floor)} rms")
    bottom.set_ylim(0, 1.25 * max(float(size.max(initial=0.0)), factor * floor, 1e-3))
    bottom.set_ylabel(f"residual of\nthe model [{unit}]")
    bottom.set_xlabel("sample (load cases of one pose side by side)")
    bottom.legend(loc="upper right")
    axes[0, 0].set_title(f"What the model leaves of each sample: {length(rms(residual))} rms")
    if poses is not None and len(np.unique(poses)) > 1:
        first = np.flatnonzero(np.diff(poses, prepend=poses[0] - 1))
        shown = first[:: max(1, len(first) // 16)]
        bottom.set_xticks(x[shown], [f"{int(p)}" for p in poses[shown]])
        bottom.set_xlabel("pose (its load cases side by side)")
    figure.tight_layout()
    return style.save(figure, path)


def predicted_against_measured(measured: Array, predicted: Array, path: str | Path) -> Path:
    """Scatter per axis of base_link with the line of agreement; (m, 3) each, m."""
    plt = style.pyplot()
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.6))
    for a, (ax, name) in enumerate(zip(axes, "xyz", strict=True)):
        m, p = 1e3 * measured[:, a], 1e3 * predicted[:, a]
        ends = [min(m.min(), p.min()), max(m.max(), p.max())]
        ax.plot(ends, ends, color=style.GREY, lw=1)
        ax.plot(p, m, ".", ms=4, color=style.BLUE)
        ax.set_title(f"along {name} of base_link")
        ax.set_xlabel("predicted [mm]")
        ax.set_ylabel("measured [mm]")
    figure.tight_layout()
    return style.save(figure, path)


def residual_maps(
    p_tcp: Array,
    residuals: Sequence[Array],
    titles: Sequence[str],
    path: str | Path,
    *,
    poses: IntArray | None = None,
    on_surface: bool = True,
) -> Path:
    """Residuals at the TCP positions, seen along the direction in which these extend least, all panels on the same scale.

    Args:
        p_tcp: TCP of each sample in base_link, (m, 3), m.
        residuals: (m, 3) each, m; one panel each.
        poses: pose number of each sample, (m,): written beside the arrows.
        on_surface: the poses lie on a tooling surface; else the axes only name the directions of largest extent.
    """
    plt = style.pyplot()
    if poses is not None and len(p_tcp) > MOST_ARROWS:
        index = [np.flatnonzero(poses == n) for n in np.unique(poses)]
        p_tcp = np.stack([p_tcp[i].mean(axis=0) for i in index])
        residuals = [np.stack([r[i].mean(axis=0) for i in index]) for r in residuals]
        poses = np.unique(poses)
        titles = [f"{t}, mean of each pose" for t in titles]
    centred = p_tcp - p_tcp.mean(axis=0)
    directions = np.linalg.svd(centred.T @ centred)[2]  # all three, also of a single pose
    across = directions[:2] * np.sign(directions[:2].sum(axis=1, keepdims=True))
    xy = centred @ across.T
    largest = max(max(float(np.linalg.norm(r, axis=1).max()) for r in residuals), 1e-12)
    factor, unit = unit_of(largest)
    width = max(float(np.ptp(xy[:, 0])), 1e-3)
    per_metre = 0.12 * width / largest
    figure, axes = plt.subplots(1, len(residuals), figsize=(max(6.4, 5.2 * len(residuals)), 4.8), squeeze=False)
    for ax, r, title in zip(axes[0], residuals, titles, strict=True):
        size = factor * np.linalg.norm(r, axis=1)
        arrows = r @ across.T * per_metre
        order = np.argsort(size)
        ax.quiver(*xy[order].T, *arrows[order].T, size[order], angles="xy", scale_units="xy", scale=1, cmap=style.CONTINUOUS,
                  width=0.004, clim=(0, factor * largest))  # fmt: skip
        dots = ax.scatter(*xy[order].T, c=size[order], s=14, cmap=style.CONTINUOUS, vmin=0, vmax=factor * largest)
        if poses is not None:
            _numbers(ax, xy, poses)
        ax.set_title(f"{title}: {length(rms(r))} rms")
        ax.margins(0.15)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("along the surface [m]" if on_surface else "along the largest extent of the poses [m]")
    _arrow_scale(axes[0][0], largest, per_metre)
    axes[0][0].set_ylabel("across [m]")
    figure.colorbar(dots, ax=axes[0].tolist(), label=f"residual [{unit}]", shrink=0.85)
    return style.save(figure, path)


def _numbers(ax: object, xy: Array, poses: IntArray) -> None:
    numbers = np.unique(poses)
    for n in numbers[:: max(1, -(-len(numbers) // MOST_NUMBERS))]:
        at = xy[poses == n].mean(axis=0)
        ax.annotate(str(int(n)), at, textcoords="offset points", xytext=(4, 4), fontsize=8, color="#333")  # type: ignore[attr-defined]


def _arrow_scale(ax: object, largest: float, per_metre: float) -> None:
    """An arrow of a round length below the panel, with what it stands for."""
    power = 10.0 ** np.floor(np.log10(max(largest, 1e-9)))
    shown = max(s * power for s in (1.0, 2.0, 5.0) if s * power <= max(largest, 1e-9) * 1.0001)
    factor, unit = unit_of(largest)
    at = {"xycoords": "axes fraction", "textcoords": "axes fraction"}
    low, high = ax.get_xlim()  # type: ignore[attr-defined]
    across = shown * per_metre / (high - low)
    ax.annotate("", xy=(0.03 + across, 0.04), xytext=(0.03, 0.04), arrowprops={"arrowstyle": "->", "color": "#222"}, **at)  # type: ignore[attr-defined]
    ax.annotate(f"{factor * shown:.3g} {unit}", xy=(0.03, 0.055), fontsize=9, color="#222", **at)  # type: ignore[attr-defined]


def residual_against(x: Array, residual: Array, label: str, floor: float, path: str | Path) -> Path:
    """Residual per component of base_link against one variable; x (m,), residual (m, 3) m."""
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(6.4, 3.8))
    factor, unit = unit_of(max(float(np.abs(residual).max(initial=0.0)), floor))
    band = factor * floor / np.sqrt(3)
    ax.axhspan(-band, band, color=style.GREY, alpha=0.2, lw=0, label=style.NOISE_LABEL)
    for a, name in enumerate("xyz"):
        ax.plot(x, factor * residual[:, a], style.MARKERS[a], ms=4, alpha=0.75, label=f"base {name}", color=style.CYCLE[a])
    ax.set_xlabel(label)
    ax.set_ylabel(f"residual [{unit}]")
    ax.set_title(f"Residual against {label.split(' [')[0]}")
    ax.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    figure.tight_layout()
    return style.save(figure, path)
