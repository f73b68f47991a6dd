# SPDX-License-Identifier: Apache-2.0
"""Figures 3, 7 to 10 and 12 of the paper, drawn from a case's own session, with what comes out otherwise than there."""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from multiprocessing import get_context

import numpy as np
from demo_parts.processes import die_with_parent
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
STATED = "Dashed: what the noise would leave that the session states of its instruments (data sheets); readings may scatter less."


def numbered(case: Case, processes: int = 1) -> list[Section]:
    """Sections of the report, in the order of their numbers."""
    pressing = partial(_pressing, case, "8(g)" if case.name == "afp" else "12")
    tasks: list[Callable[[], list[Section]]] = [partial(_charts, case), pressing]
    if case.name == "afp":
        tasks.append(partial(_poses, case))
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=die_with_parent) as pool:
        drawn = [future.result() for future in [pool.submit(task) for task in tasks]]
    return sorted(chain(*drawn), key=lambda section: int(re.sub(r"\D*(\d+).*", r"\1", section.heading)))


def _poses(case: Case) -> list[Section]:
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
    return [Section("Fig. 3", [text + " (paper: 175 mm was asked of COVER)."], figures=[Figure(path, "As Fig. 3.")])]


def _in_cell(cell: Cell, q: np.ndarray, rail: float) -> np.ndarray:
    axis = cell.rail.axis if cell.rail is not None else np.zeros(3)
    return np.asarray(cell.robot.kinematics(np.asarray(q)[None]).p_tcp[0] + rail * axis)


def _apart(pool: np.ndarray, points: np.ndarray) -> float:
    return float(np.linalg.norm(pool[:, None] - points[None], axis=2).min(axis=1).max())


def _pressing(case: Case, number: str) -> list[Section]:
    """Fig. 8g, and what belongs to Fig. 12: measured deflection and what the models leave, row by row."""
    observation = observe(read_session(case.out / "session"))
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(10, 3.8), layout="constrained")
    row = np.arange(1, len(observation.y) + 1)
    ax.semilogy(row, 1e3 * np.linalg.norm(observation.y, axis=1), color=GREY, lw=0.9, label="measured deflection")
    for name, called, colour, dashes in (
        ("6dof", "6 DOF", RED, ":"), ("18dof", "18 DOF", BLUE, "-"), ("improved", "improved", GREEN, "--"),
    ):  # fmt: skip
        left = 1e3 * np.linalg.norm(residual_of(load_model(case.out / f"model_{name}.yaml"), observation), axis=1)
        text = f"left by {called}: mean {left.mean():.3f}, max {left.max():.3f} mm"
        ax.semilogy(row, left, color=colour, ls=dashes, lw=0.9, label=text)
    ax.set(xlabel="row (pose by pose, load case by load case)", ylabel="norm [mm]")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    path = save(figure, case.out / f"fig_{number.split('(')[0]}.png")
    caption = "Deflections of the calibration session and what the models leave of them (rows that were fitted)."
    return [Section(f"Fig. {number}", figures=[Figure(path, caption)])]


def _charts(case: Case) -> list[Section]:
    """Comparisons by CODEC, each of the paper's 18 DOF, all load cases and COVER with one other choice."""
    read = read_session(case.out / "session")
    eighteen = pose_data(read, blank_model(EIGHTEEN_DOF))
    first = run_codec(eighteen, method="cover")
    others = {
        "pose-search": ("COVER", run_codec(eighteen, method="ioops", label="IOOPS")),
        "model": ("18 DOF", run_codec(pose_data(read, blank_model(SIX_DOF)), label="6 DOF")),
        "load-cases": ("all load cases", run_codec(pose_data(read, blank_model(EIGHTEEN_DOF), [1]), label="normal only")),
    }
    return [_chart(case, CHARTS[name], replace(first, label=label), other) for name, (label, other) in others.items()]


def _chart(case: Case, chart: Chart, first: Codec, second: Codec) -> Section:
    path = case.out / f"fig_{chart.number}.png"
    save_chart([first, second], path, f"{case.name}, {chart.what}")
    text = [_told(first, second, chart)]
    title = f"Fig. {chart.number}" if case.name == "afp" else f"As Fig. {chart.number}, for this cell"
    return Section(title, text, figures=[Figure(path, f"Error on poses that were not fitted: {chart.what}. {STATED}")])


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
