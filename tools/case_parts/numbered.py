# SPDX-License-Identifier: Apache-2.0
"""Figures 3, 7 to 10 and 12 of the paper, drawn from a case's own session, with what comes out otherwise than there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell, read_cell
from irec_calibration.codec import Codec, pose_data, run_codec
from irec_calibration.identification.observe import observe
from irec_calibration.model import EIGHTEEN_DOF, SIX_DOF, blank_model
from irec_calibration.model.file import load_model
from irec_calibration.poses.plan import make_plan
from irec_calibration.poses.store import read_poses
from irec_calibration.recertification.judgement import residual_of
from irec_calibration.report.codec_charts import save_chart
from irec_calibration.report.page import Figure, Section
from irec_calibration.report.style import BLUE, GREEN, GREY, RED, pyplot, save
from irec_calibration.session import read_session

from .jobs import Case


@dataclass(frozen=True)
class Chart:
    """A comparison by CODEC: of the paper's figure, first named against second named."""

    number: str
    what: str
    paper: str


CHARTS = {
    "pose-search": Chart("7", "training poses in the order of COVER against IOOPS", "COVER leaves less than IOOPS"),
    "model": Chart("9", "18 against 6 degrees of freedom", "18 DOF leave less than 6 DOF"),
    "load-cases": Chart("10", "five load cases against the normal one alone", "five load cases leave less than the normal one"),
}


def numbered(case: Case) -> list[Section]:
    """Sections of the report."""
    session = case.out / "session"
    sections = [_pressing(case, session, "8(g)" if case.name == "afp" else "12")]
    if case.name == "afp":
        sections.insert(0, _poses(case))
    sections += [_chart(case, session, name) for name in CHARTS]
    return sections


def _poses(case: Case) -> Section:
    """Fig. 3: the pool, the poses of the cell (COVER) and as many by IOOPS."""
    cell = read_cell(case.cell_path)
    planned = read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses
    plan = make_plan(cell, len(planned), method="ioops")
    pool = plan.pool.p_in_cell
    chosen = np.array([_in_cell(cell, p.q, p.ext.get("rail", 0.0)) for p in planned])
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(9, 4.6), layout="constrained")
    ax.scatter(pool[:, 1], pool[:, 2], s=3, color=GREY, label=f"pool, {len(pool)}")
    ax.scatter(*pool[plan.chosen][:, 1:].T, s=60, marker="s", color=RED, label=f"IOOPS, {len(plan.chosen)}")
    ax.scatter(*chosen[:, 1:].T, s=50, color=BLUE, edgecolor="black", label=f"COVER, {len(chosen)}")
    ax.set(xlabel="y [m]", ylabel="z [m]", title="Pool and chosen poses, seen from the robot")
    ax.set_aspect("equal")
    figure.legend(loc="outside lower center", ncols=3)
    path = save(figure, case.out / "fig_3.png")
    apart = {n: _apart(pool, points) for n, points in (("COVER", chosen), ("IOOPS", pool[plan.chosen]))}
    text = "Farthest pose of the pool from a chosen one: " + ", ".join(f"{n} {1e3 * d:.0f} mm" for n, d in apart.items())
    return Section("Fig. 3", [text + " (paper: 175 mm was asked of COVER)."], figures=[Figure(path, "As Fig. 3.")])


def _in_cell(cell: Cell, q: np.ndarray, rail: float) -> np.ndarray:
    axis = cell.rail.axis if cell.rail is not None else np.zeros(3)
    return np.asarray(cell.robot.kinematics(np.asarray(q)[None]).p_tcp[0] + rail * axis)


def _apart(pool: np.ndarray, points: np.ndarray) -> float:
    return float(np.linalg.norm(pool[:, None] - points[None], axis=2).min(axis=1).max())


def _pressing(case: Case, session: Path, number: str) -> Section:
    """Fig. 8g, and what belongs to Fig. 12: measured deflection and what the models leave, row by row."""
    observation = observe(read_session(session))
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(10, 3.8), layout="constrained")
    row = np.arange(1, len(observation.y) + 1)
    ax.semilogy(row, 1e3 * np.linalg.norm(observation.y, axis=1), color=GREY, lw=0.9, label="measured deflection")
    for name, colour, dashes in (("6dof", RED, ":"), ("18dof", BLUE, "-"), ("improved", GREEN, "--")):
        left = 1e3 * np.linalg.norm(residual_of(load_model(case.out / f"model_{name}.yaml"), observation), axis=1)
        text = f"left by {name}: mean {left.mean():.3f}, max {left.max():.3f} mm"
        ax.semilogy(row, left, color=colour, ls=dashes, lw=0.9, label=text)
    ax.set(xlabel="row (pose by pose, load case by load case)", ylabel="norm [mm]")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    path = save(figure, case.out / f"fig_{number.split('(')[0]}.png")
    caption = "Deflections of the calibration session and what the models leave of them (rows that were fitted)."
    return Section(f"Fig. {number}", figures=[Figure(path, caption)])


def _chart(case: Case, session: Path, name: str) -> Section:
    chart = CHARTS[name]
    path = case.out / f"fig_{chart.number}.png"
    first, second = _codecs(session, name)
    save_chart([first, second], path, f"{case.name}, {chart.what}")
    text = [_told(first, second, chart)]
    title = f"Fig. {chart.number}" if case.name == "afp" else f"As Fig. {chart.number}, for this cell"
    return Section(title, text, figures=[Figure(path, f"Error on poses that were not fitted: {chart.what}.")])


def _codecs(session: Path, name: str) -> tuple[Codec, Codec]:
    read = read_session(session)
    eighteen = pose_data(read, blank_model(EIGHTEEN_DOF))
    if name == "pose-search":
        return run_codec(eighteen, method="cover", label="COVER"), run_codec(eighteen, method="ioops", label="IOOPS")
    both = run_codec(eighteen, label="18 DOF" if name == "model" else "all load cases")
    if name == "model":
        return both, run_codec(pose_data(read, blank_model(SIX_DOF)), label="6 DOF")
    return both, run_codec(pose_data(read, blank_model(EIGHTEEN_DOF), [1]), label="normal only")


def _told(first: Codec, second: Codec, chart: Chart) -> str:
    """Medians of the mean error after a third of the training poses and after all, and whether that is the paper's finding."""
    n = first.norm_mean.shape[1]
    early = max(1, n // 3)
    a, b = (1e6 * np.median(c.norm_mean, axis=0) for c in (first, second))
    text = (
        f"Median of the mean error with {early} training poses: {first.label} {a[early - 1]:.0f} um, {second.label} "
        f"{b[early - 1]:.0f} um; with all {n}: {a[-1]:.0f} and {b[-1]:.0f} um. In the paper, {chart.paper}; here "
    )
    if a[early - 1] < 0.98 * b[early - 1]:
        return text + "too."
    if a[early - 1] > 1.02 * b[early - 1]:
        return text + "the other way round with few poses."
    settled = a[early - 1] < 1.05 * a[-1]
    return text + "not by more than 2 %" + (f": {early} poses are as good as all {n} in either order." if settled else ".")
