# SPDX-License-Identifier: Apache-2.0
"""Figures that compare models: the ladder of held-out errors, candidate effects, residual views, deviation along a course."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..lengths import length, unit_of
from ..typing import Array
from . import style


def ladder(
    labels: Sequence[str], cv_rms: Sequence[float], cv_se: Sequence[float], unsure: Sequence[bool], floor: float, path: str | Path
) -> Path:
    """Held-out error per model version down to the noise floor, m; hollow where what was added is no diagnosis."""
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(max(5.5, 1.5 * len(labels) + 2), 4.2))
    x = np.arange(len(labels))
    factor, unit = unit_of(max([*cv_rms, floor]))
    top = factor * np.array(cv_rms)
    ax.plot(x, top, color=style.GREY, lw=1, zorder=1)
    ax.errorbar(x, top, yerr=factor * np.array(cv_se), fmt="o", ms=8, capsize=4, color=style.BLUE, zorder=2)
    hollow = np.array(unsure)
    ax.plot(x[hollow], top[hollow], "o", ms=5, color="white", zorder=3)
    for i, value in enumerate(top):
        ax.annotate(f"{value:.2f}" if unit == "mm" else f"{value:.1f}", (x[i], value), textcoords="offset points", xytext=(10, 6))
    ax.axhline(factor * floor, color=style.RED, ls="--", label=f"{style.NOISE_LABEL} {length(floor)}")
    ax.set_xticks(x, [label.replace(" + ", "\n+ ").replace(" (", "\n(").replace(": ", ":\n") for label in labels])
    ax.set_xlim(-0.5, len(labels) - 0.3)
    ax.set_ylim(0, 1.15 * max(top.max(), factor * floor))
    ax.set_ylabel(f"held-out error [{unit} rms]")
    ax.set_title("Error on poses that the model was not fitted to")
    ax.legend(loc="upper right")
    figure.tight_layout()
    return style.save(figure, path)


def candidates(
    names: Sequence[str],
    cv_rms: Sequence[float],
    cv_se: Sequence[float],
    base: float,
    floor: float,
    named: Sequence[str],
    path: str | Path,
) -> Path:
    """Held-out error with each candidate effect added, in the order given; m. `named` are those of the verdict (hatched)."""
    plt = style.pyplot()
    names, cv_rms, cv_se = names[:14], cv_rms[:14], cv_se[:14]
    figure, ax = plt.subplots(figsize=(7.5, 0.36 * len(names) + 1.6))
    y = np.arange(len(names))[::-1]
    factor, unit = unit_of(max([*cv_rms, base, floor]))
    colours = [style.ORANGE if n in named else style.BLUE for n in names]
    error = factor * np.array(cv_se)
    bars = ax.barh(y, factor * np.array(cv_rms), xerr=error, color=colours, height=0.65, ecolor="#444", capsize=2)
    for bar, name in zip(bars, names, strict=True):
        if name in named:
            bar.set_hatch("//")
            bar.set_edgecolor("#222")
    ax.axvline(factor * base, color="#222", lw=1.5, label=f"model as it is, {length(base)}")
    ax.axvline(factor * floor, color=style.RED, ls="--", label=f"{style.NOISE_LABEL}, {length(floor)}")
    ax.set_yticks(y, [f"{n} (named)" if n in named else n for n in names])
    ax.set_xlabel(f"trial: held-out error with this effect added [{unit} rms]")
    ax.set_title("Candidate effects, the best evidence first")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.08), ncols=2)
    ax.grid(axis="y", alpha=0)
    figure.tight_layout()
    return style.save(figure, path)


def gap(
    rows: Sequence[tuple[str, float, float]],
    floor: float,
    path: str | Path,
    title: str,
    of: str = "error on poses that were left out of the fit",
) -> Path:
    """The verdict as one picture: error of one or two models beside the noise.

    Args:
        rows: name, error (m), its standard error (m, NaN where there is none).
        floor: noise, m.
    """
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(8.0, 0.62 * (len(rows) + 1) + 1.0))
    names = [*(r[0] for r in rows), style.NOISE_LABEL]
    factor, unit = unit_of(max([*(r[1] for r in rows), floor]))
    values = factor * np.array([*(r[1] for r in rows), floor])
    errors = factor * np.nan_to_num(np.array([*(r[2] for r in rows), 0.0]))
    y = np.arange(len(names))[::-1]
    colours = [*(style.BLUE, style.ORANGE, style.PURPLE)[: len(rows)], style.GREY]
    ax.barh(y, values, xerr=errors, color=colours, height=0.6, ecolor="#333", capsize=3)
    for at, value, error in zip(y, values, errors, strict=True):
        text = length(value / factor)
        ax.annotate(text, (value + error, at), textcoords="offset points", xytext=(6, 0), va="center", weight="bold")
    ax.axvline(factor * floor, color=style.RED, ls="--", lw=1)
    ax.set_yticks(y, names)
    ax.set_xlim(0, 1.18 * float((values + errors).max()))
    ax.set_xlabel(f"{of} [{unit} rms]")
    ax.set_title(title)
    ax.grid(axis="y", alpha=0)
    figure.tight_layout()
    return style.save(figure, path)


def views(sentences: Sequence[str], share: Sequence[float], path: str | Path) -> Path:
    """Ranked views of the residual: share of the residual's excess that each explains (0..1)."""
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(8.5, 0.4 * len(sentences) + 1.4))
    y = np.arange(len(sentences))[::-1]
    ax.barh(y, 100 * np.array(share), color=style.ORANGE, height=0.6)
    ax.set_yticks(y, sentences)
    ax.set_xlabel("share of the residual's square [%]")
    ax.set_title("What the residual goes along with")
    ax.grid(axis="y", alpha=0)
    figure.tight_layout()
    return style.save(figure, path)


def course(s: Mapping[str, Array], deviation: Mapping[str, Array], tolerance: float | None, path: str | Path, *,
           title: str = "Deviation along the course") -> Path:  # fmt: skip
    """Deviation of the TCP along a loaded course, one line per run.

    Args:
        s: run -> arc length, (n,), m.
        deviation: run -> deviation, (n,), m.
        tolerance: of the process, m; a line where given.
    """
    plt = style.pyplot()
    figure, ax = plt.subplots(figsize=(9, 4))
    colours = (style.RED, style.ORANGE, style.BLUE, style.GREEN)
    for (run, along), colour, dash in zip(s.items(), colours, style.DASHES, strict=False):
        d = 1e3 * np.asarray(deviation[run])
        ax.plot(along, d, lw=1.3, color=colour, ls=dash, label=f"{run}: mean {d.mean():.3f}, max {d.max():.3f} mm")
    if tolerance is not None:
        ax.axhline(1e3 * tolerance, color=style.GREY, ls="--", label=f"tolerance {1e3 * tolerance:.2f} mm")
    ax.set_xlabel("arc length [m]")
    ax.set_ylabel("deviation [mm]")
    ax.set_ylim(bottom=0)
    ax.set_title(title)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    return style.save(figure, path)
