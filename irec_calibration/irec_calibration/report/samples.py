# SPDX-License-Identifier: Apache-2.0
"""Figures of single samples: norms per sample (the paper's Fig. 8g), predicted against measured, residuals over the surface."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..typing import Array, IntArray
from . import style


def norms_per_sample(commanded: Array, residual: Array, floor: float, path: str | Path, *, poses: IntArray | None = None) -> Path:
    """Norms of the commanded TCP displacement and of the residual, sample by sample (Fig. 8g).

    Args:
        commanded: displacement commanded by the controller against the reference, (m, 3), m.
        residual: measured minus predicted, (m, 3), m.
        floor: instrument noise, m.
        poses: pose number of each sample, (m,), for the ticks.
    """
    plt = style.pyplot()
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 5), sharex=True, height_ratios=(3, 2))
    x = np.arange(1, len(residual) + 1)
    top.bar(x, 1e3 * np.linalg.norm(commanded, axis=1), color=style.RED, width=1.0, label="commanded displacement")
    top.bar(x, 1e3 * np.linalg.norm(residual, axis=1), color=style.BLUE, width=1.0, label="residual of the model")
    top.set_ylabel("norm [mm]")
    top.set_title("Commanded displacement and residual of each sample")
    top.set_ylim(0, 1.2 * 1e3 * np.linalg.norm(commanded, axis=1).max())
    top.legend(loc="upper right", ncols=2)
    bottom.bar(x, 1e6 * np.linalg.norm(residual, axis=1), color=style.BLUE, width=1.0)
    bottom.axhline(1e6 * floor, color=style.GREY, ls="--", label=style.NOISE_LABEL)
    bottom.set_ylim(0, 1.25 * max(1e6 * np.linalg.norm(residual, axis=1).max(), 1e6 * floor))
    bottom.set_ylabel("residual [um]")
    bottom.set_xlabel("sample (load cases of one pose side by side)")
    bottom.legend(loc="upper right")
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
        ax.set_title(f"{name} of base_link")
        ax.set_xlabel("predicted [mm]")
        ax.set_ylabel("measured [mm]")
    figure.tight_layout()
    return style.save(figure, path)


def residual_maps(p_tcp: Array, residuals: Sequence[Array], titles: Sequence[str], path: str | Path) -> Path:
    """Residuals at the TCP positions, seen along the direction of least extent, before and after on the same scale.

    Args:
        p_tcp: TCP of each sample in base_link, (m, 3), m.
        residuals: (m, 3) each, m; one panel each.
    """
    plt = style.pyplot()
    centred = p_tcp - p_tcp.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    across = directions[:2] * np.sign(directions[:2].sum(axis=1, keepdims=True))
    xy = centred @ across.T
    largest = max(float(np.linalg.norm(r, axis=1).max()) for r in residuals)
    width = np.ptp(xy[:, 0])
    figure, axes = plt.subplots(1, len(residuals), figsize=(5.2 * len(residuals), 4.6), squeeze=False)
    for ax, r, title in zip(axes[0], residuals, titles, strict=True):
        size = 1e6 * np.linalg.norm(r, axis=1)
        arrows = r @ across.T * (0.12 * width / largest)
        order = np.argsort(size)
        ax.quiver(*xy[order].T, *arrows[order].T, size[order], angles="xy", scale_units="xy", scale=1, cmap="viridis",
                  width=0.004, clim=(0, 1e6 * largest))  # fmt: skip
        dots = ax.scatter(*xy[order].T, c=size[order], s=14, cmap="viridis", vmin=0, vmax=1e6 * largest)
        ax.set_title(f"{title}: {1e6 * np.sqrt((r**2).sum(axis=1).mean()):.1f} um rms")
        ax.margins(0.15)
        ax.set_aspect("equal", adjustable="box")
        ax.set_xlabel("along the surface [m]")
    axes[0][0].set_ylabel("across [m]")
    figure.colorbar(dots, ax=axes[0].tolist(), label="residual [um]", shrink=0.85)
    return style.save(figure, path)


def residual_against(x: Array, residual: Array, label: str, floor: float, path: str | Path) -> Path:
    """Residual per component of base_link against one variable; x (m,), residual (m, 3) m."""
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(6.4, 3.8))
    ax.axhspan(-1e6 * floor / np.sqrt(3), 1e6 * floor / np.sqrt(3), color=style.GREY, alpha=0.2, lw=0, label=style.NOISE_LABEL)
    for a, name in enumerate("xyz"):
        ax.plot(x, 1e6 * residual[:, a], ".", ms=4, label=name)
    ax.set_xlabel(label)
    ax.set_ylabel("residual [um]")
    ax.set_title(f"Residual against {label.split(' [')[0]}")
    ax.legend(ncols=4, loc="best")
    figure.tight_layout()
    return style.save(figure, path)
