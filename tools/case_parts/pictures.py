# SPDX-License-Identifier: Apache-2.0
"""Figures of a case, in the look of irec's reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from irec_calibration.report.style import BLUE, CONTINUOUS, GREEN, GREY, ORANGE, PURPLE, RED, pyplot, save
from irec_calibration.sensors.look_ahead import missed
from irec_sim.production.runner import Drive

from .budget import Budget
from .table import Figures


def maps(before: Drive, after: Drive, tolerance: float, case: str, path: Path) -> Path:
    """Absolute (lay-down) or signed (roughing) error over the part, both drives on one colour scale."""
    plt = pyplot()
    across, up = np.ptp(before.ways.p_in_cell[before.counted], axis=0)[[1, 0]]
    height = 1.0 + 4.2 * up / across  # so that the colour bar is as high as the maps
    figure, axes = plt.subplots(1, 2, figsize=(11, height), sharex=True, sharey=True, layout="constrained")
    top = 1e3 * float(np.abs(before.error[before.counted]).max())
    for ax, drive, title in zip(axes, (before, after), ("without correction", "with correction, 18 DOF"), strict=True):
        keep = drive.counted.copy()
        keep[np.arange(len(keep)) % 3 > 0] = False
        p, e = drive.ways.p_in_cell[keep], 1e3 * drive.error[keep]
        e, low, colours = (np.abs(e), 0.0, CONTINUOUS) if case == "afp" else (e, -top, "PuOr")
        shown = ax.scatter(p[:, 1], p[:, 0], c=e, s=3, cmap=colours, vmin=low, vmax=top, rasterized=True)
        inside = 100 * float((np.abs(drive.error[drive.judged]) <= tolerance).mean())
        ax.set_title(f"{title}: {inside:.1f} % within {1e3 * tolerance:g} mm")
        ax.set_xlabel("y [m]")
        ax.set_aspect("equal")
        ax.grid(False)
    axes[0].set_ylabel("x [m]")
    figure.colorbar(shown, ax=axes, label="|lateral deviation| [mm]" if case == "afp" else "error along the normal [mm]")
    return save(figure, path)


def course(before: Drive, after: Drive, improved: Drive, tolerance: float, path: Path) -> tuple[Path, str]:
    """One course: T_31 where it was driven, else the last but one."""
    names = before.ways.names
    i = names.index("T_31") if "T_31" in names else max(0, len(names) - 2)
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(10, 3.8), layout="constrained")
    limit = 1e3 * tolerance
    ax.axhspan(-limit, limit, color=GREEN, alpha=0.12, lw=0, label="tolerance")
    lines = ((before, RED, "-", "without correction"), (after, BLUE, "-", "18 DOF"), (improved, PURPLE, "--", "improved"))
    for drive, colour, dashes, label in lines:
        k = drive.counted[:, i]
        ax.plot(drive.ways.way[k, i], 1e3 * drive.error[k, i], color=colour, ls=dashes, lw=0.9, label=label)
    ax.set_xlabel("way along the course [m]")
    ax.set_ylabel("error [mm]")
    ax.legend(ncols=4, fontsize=8)
    ax.set_title(f"Course {names[i]}")
    return save(figure, path), names[i]


def ladder(rungs: dict[str, Figures], path: Path) -> Path:
    plt = pyplot()
    shown = {n: f for n, f in rungs.items() if n != "without correction"}
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.2), sharey=True, layout="constrained")
    at = np.arange(len(shown))[::-1]
    for ax, key, colour in zip(axes, ("mean", "max"), (BLUE, ORANGE), strict=True):
        values = [getattr(f, key) for f in shown.values()]
        bars = ax.barh(at, values, color=colour, hatch="//" if key == "max" else None)
        ax.bar_label(bars, fmt="%.3f", padding=3, fontsize=8)
        ax.set_xlabel(f"{key} error [mm]")
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks(at, list(shown))
    return save(figure, path)


def budget(found: Budget, path: Path) -> Path:
    """Bars of the mean error that begin where the one before ended, and the sum."""
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
    names, values = list(found.parts), [1e3 * m for m, _ in found.parts.values()]
    ends = np.cumsum(values)
    at = np.arange(len(names) + 1)[::-1]
    for y, end, value in zip(at, ends, values, strict=False):
        ax.barh(y, value, left=end - value, color=BLUE if value >= 0 else RED, hatch=None if value >= 0 else "//")
        ax.text(max(end, end - value) + 0.5, y, f"{value:.1f}", va="center", fontsize=8)
    ax.barh(at[-1], 1e3 * found.total[0], color=GREY)
    ax.text(1e3 * found.total[0] + 0.5, at[-1], f"{1e3 * found.total[0]:.1f}", va="center", fontsize=8)
    ax.set_yticks(at, [*names, "sum = mean error"])
    ax.set_xlabel("mean error [um]")
    ax.grid(axis="y", visible=False)
    return save(figure, path)


def learned(told: dict[str, Any], path: Path) -> Path:
    plt = pyplot()
    figure, axes = plt.subplots(2, 2, figsize=(10, 6), layout="constrained")
    latency = told["latency"]
    ax = axes[0, 0]
    ax.plot(1e3 * latency.delays, latency.curve, color=BLUE)
    ax.axvline(1e3 * latency.delay, color=RED, ls="--")
    ax.set(xlabel="delay [ms]", ylabel="share of motion explained", title="Latency")
    ax = axes[0, 1]
    for k, (name, colour) in enumerate((("along", BLUE), ("across", ORANGE), ("out of the surface", GREEN))):
        ax.plot(
            told["profile"].step * np.arange(len(told["profile"].head)),
            (told["profile"].head + told["profile"].middle[0])[:, k],
            color=colour,
            ls=("-", "--", "-.")[k],
            label=name,
        )
    ax.set(xlabel="time since the course began [s]", ylabel="force [N]", title="Known profile: the beginning")
    ax.legend(fontsize=8)
    ax = axes[1, 0]
    f, responses = np.linspace(0.2, 25.0, 300), [s.response for s in told["shaken"]]
    for key, colour, name in (("plain", BLUE, "for the spectrum, a delay"), ("shaped", ORANGE, "arm and drives as measured")):
        rest = missed(told[key].taps, told[key].rate, responses, f)
        ax.plot(f, rest, color=colour, ls="-" if key == "plain" else "--", label=name)
    ax.plot(f, missed(np.array([1.0]), told["plain"].rate, responses, f), color=GREY, ls=":", label="no filter")
    ax.set(xlabel="frequency [Hz]", ylabel="deviation left, 1 = static", title="Designed filter", ylim=(0.0, None))
    ax.legend(fontsize=8)
    ax = axes[1, 1]
    for s, colour in zip(told["shaken"], (BLUE, ORANGE, GREEN), strict=False):
        ax.semilogy(s.response.frequency, np.abs(s.response.to_force), color=colour, lw=0.9, label=f"{s.where}, force")
        ax.semilogy(s.response.frequency, np.abs(s.response.to_offset), color=colour, ls="--", lw=0.9, label=f"{s.where}, offset")
    ax.set(xlabel="frequency [Hz]", ylabel="answer of the TCP, 1 = static", title="Answer of arm and drives")
    ax.legend(fontsize=7, loc="best")
    return save(figure, path)
