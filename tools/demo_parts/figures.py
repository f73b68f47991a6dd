# SPDX-License-Identifier: Apache-2.0
"""Figures of the demo."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from irec_calibration.identification.observe import observe
from irec_calibration.model import Model
from irec_calibration.recertification.judgement import residual_of
from irec_calibration.session import Session

from .course import Course

matplotlib.use("Agg")
from matplotlib import pyplot as plt

GREY, RED, BLUE = "#8a8f98", "#c8442b", "#1f5fa8"
TOLERANCE_COLOUR = "#3a8a4d"


def residuals_figure(session: Session, models: dict[str, Model], path: Path) -> Path:
    """Norms of the commanded displacement and of the residuals per sample, as Fig. 8g of the paper.

    Args:
        models: name -> model, the last one on top.
    """
    observation = observe(session)
    rows = observation.rows
    reference = observation.scene.reference[rows]
    commanded = np.linalg.norm(session.p_tcp_in_base[rows] - session.p_tcp_in_base[reference], axis=1)
    sample = np.arange(1, len(rows) + 1)
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(10, 6), sharex=True, height_ratios=(3, 2), layout="constrained")
    top.plot(sample, 1e3 * commanded, color=GREY, lw=0.8, marker=".", ms=3, label="commanded displacement")
    deflection = np.linalg.norm(observation.y, axis=1)
    top.plot(sample, 1e3 * deflection, color="black", lw=0.8, marker=".", ms=3, label="measured elastic deflection")
    for (name, model), colour in zip(models.items(), (RED, BLUE), strict=False):
        residual = np.linalg.norm(residual_of(model, observation), axis=1)
        text = f"residual, {name}: mean {1e3 * residual.mean():.3f} mm, max {1e3 * residual.max():.3f} mm"
        for axes in (top, bottom):
            axes.plot(sample, 1e3 * residual, color=colour, lw=0.8, marker=".", ms=3, label=text)
    floor = 1e3 * observation.whiten.floor
    bottom.axhline(floor, color=TOLERANCE_COLOUR, lw=1, ls="--", label=f"instrument noise {floor:.3f} mm")
    top.set_ylabel("norm [mm]")
    bottom.set_ylabel("norm [mm]")
    bottom.set_xlabel("sample (pose by pose, load case by load case)")
    bottom.set_ylim(bottom=0)
    top.set_ylim(bottom=0)
    lines = {line.get_label(): line for axes in (top, bottom) for line in axes.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", fontsize=8, ncols=3)
    top.set_title(f"{session.name}: {len(session.poses)} poses, {len(rows)} loaded samples")
    return _save(figure, path)


def course_figure(without: Course, corrected: Course, tolerance_m: float, path: Path) -> Path:
    """Lateral deviation along the course without and with correction."""
    figure, axes = plt.subplots(figsize=(10, 4), layout="constrained")
    limit = 1e3 * tolerance_m
    axes.axhspan(-limit, limit, color=TOLERANCE_COLOUR, alpha=0.12, lw=0, label="tolerance of the process")
    axes.plot(without.way, 1e3 * without.lateral, color=RED, lw=1.2, label="without correction")
    axes.plot(corrected.way, 1e3 * corrected.lateral, color=BLUE, lw=1.2, label="with correction")
    axes.set_xlabel("way along the course [m]")
    axes.set_ylabel("lateral deviation of the TCP [mm]")
    figure.legend(loc="outside lower center", fontsize=8, ncols=3)
    axes.grid(alpha=0.25)
    return _save(figure, path)


def _save(figure: plt.Figure, path: Path) -> Path:
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path
