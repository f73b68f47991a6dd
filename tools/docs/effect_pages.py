# SPDX-License-Identifier: Apache-2.0
"""A page for each effect of the catalogue: physics, parameters, what it needs, how it looks in residuals when it is missing.

The plot shows what is left of the effect, at a strength of 100 um, after the 18-DOF model has absorbed what it can.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from irec_calibration.diagnose.run import start_terms
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects import CATALOGUE, Effect
from irec_calibration.effects.traits import Cause
from irec_calibration.model import Estimate, Term, total_displacement
from irec_calibration.report import style
from irec_calibration.report.diagnosis import variables
from irec_calibration.session import Session, read_session

from irec_sim import cli as simulator

STRENGTH = 1e-4  # m rms
POSES, SEED = 24, 4
SMALL = 0.02  # share left of an effect below which it is said to be absorbed


def write(folder: Path) -> list[str]:
    """Write all pages and pictures into a folder; names of the pages, the list of effects first."""
    folder.mkdir(parents=True, exist_ok=True)
    session = _session()
    study = prepare(session, start_terms(session))
    pages, rows = [], []
    for kind in CATALOGUE:
        effect = kind()
        (folder / f"{effect.id}.md").write_text(_page(effect, study, session, folder), encoding="utf-8")
        pages.append(f"{effect.id}.md")
        rows.append(f"| [{effect.id}]({effect.id}.md) | {effect.label} | {effect.acts_on} |")
    index = ["# The catalogue of effects", "", "| effect | what it is | acts on |", "| --- | --- | --- |", *rows, ""]
    (folder / "index.md").write_text("\n".join(index), encoding="utf-8")
    return ["index.md", *pages]


def _session() -> Session:
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "session"
        simulator.main(["session", "--poses", str(POSES), "--seed", str(SEED), "-o", str(path)])
        return read_session(path)


def _page(effect: Effect, study: Study, session: Session, folder: Path) -> str:
    base = {t.effect.id for t in study.terms}
    why = study.why_not(effect)
    lines = [f"# {effect.id}", "", f"**{effect.label.capitalize()}.** {effect.physics}", ""]
    parts = {
        Cause.LOAD: "moves the tool: it is part of predictions",
        Cause.STATE: "moves the tool by the joint angles alone: only predictions of `absolute` sessions have it",
        Cause.MOTION: "moves the tool by the step before: only predictions of `absolute` sessions have it",
        Cause.TIME: "passes with time whatever the force: it is no part of predictions",
        Cause.MEASUREMENT: "only the measurement sees it: it is no part of predictions",
    }
    acts = "changes the force that the model is evaluated at" if effect.acts_on == "wrench" else parts[effect.cause]
    lines += [
        f"* Acts on: {effect.acts_on} ({acts}).",
        f"* Needs: {', '.join(effect.needs) or 'nothing besides the session'}.",
    ]
    parameters = () if why else effect.parameters(study.ready)
    if parameters:
        lines += [
            "",
            "## Parameters",
            "",
            "In the AFP cell with six axes and a rail.",
            "",
            "| name | unit | bounds | likely |",
            "| --- | --- | --- | --- |",
        ]
        for p in parameters[:12]:
            low, high = p.plausible_range
            lines.append(f"| `{p.name}` | {p.unit} | {p.lower:.3g} … {p.upper:.3g} | {low:.3g} … {high:.3g} |")
        if len(parameters) > 12:
            lines.append(f"| and {len(parameters) - 12} more | | | |")
    lines += ["", "## How it looks when it is missing", ""]
    if effect.id in base:
        lines.append("It is part of the model that everything starts from.")
    elif why:
        lines.append(f"Not in a session such as the one these pages are made with: {why}.")
    else:
        lines += _signature(effect, study, session, folder)
    lines += [
        "",
        "## Add it",
        "",
        "```sh",
        f"irec effects {effect.id}",
        "```",
        "",
        f"`irec add model.yaml {effect.id} SESSION -o model2.yaml`",
        "",
    ]
    return "\n".join(lines)


def _signature(effect: Effect, study: Study, session: Session, folder: Path) -> list[str]:
    observed, name = _observed(effect, study)
    size = float(np.sqrt((observed**2).sum(axis=1).mean()))
    if size < 1e-12:
        return ["It cancels in a `loaded` session, where each row is read against its reference; an `absolute` session shows it."]
    observed = observed * (STRENGTH / size)
    o = study.observation
    white = o.whiten(observed).reshape(-1)
    left = white - study.base.A @ np.linalg.lstsq(study.base.A, white, rcond=None)[0]
    residual = o.whiten.undo(left.reshape(-1, 3))
    share = float(np.sqrt((residual**2).sum(axis=1).mean())) / STRENGTH
    if share < SMALL:
        return [f"Of 100 um, the 18-DOF model absorbs all but {100 * share:.1f} um: this session can't show it."]
    variable, values, label = _strongest(session, residual, o.rows)
    plt = style.pyplot()
    figure, (left_ax, right_ax) = plt.subplots(1, 2, figsize=(10, 3.6))
    left_ax.bar(np.arange(len(residual)), 1e6 * np.linalg.norm(residual, axis=1), width=1.0, color=style.BLUE)
    left_ax.set(
        xlabel="sample (load cases of one pose side by side)",
        ylabel="residual [um]",
        title=f"{100 * share:.0f} um of 100 um are left",
    )
    for a, axis in enumerate("xyz"):
        right_ax.plot(values, 1e6 * residual[:, a], style.MARKERS[a], ms=4, color=style.CYCLE[a], label=f"base {axis}")
    right_ax.set(xlabel=label, ylabel="residual [um]", title=f"against {label.split(' [')[0]}")
    right_ax.legend(ncols=3, fontsize=8)
    figure.tight_layout()
    style.save(figure, folder / f"{effect.id}.png")
    return [
        f"{name} at a strength of 100 um. After the 18-DOF model has absorbed what it can, {100 * share:.0f} um are left;"
        f" they depend most on `{variable}`.",
        "",
        f"![Residuals that {effect.id} leaves in the 18-DOF model]({effect.id}.png)",
    ]


def _observed(effect: Effect, study: Study) -> tuple[np.ndarray, str]:
    """What the session sees of the part of an effect that moves most, and the name of that part."""
    o, parameters = study.observation, effect.parameters(study.ready)
    before = total_displacement(study.terms, o.scene)
    groups = list(dict.fromkeys(p.group for p in parameters if not p.grid)) or [""]
    best, named = np.zeros((len(o.rows), 3)), "It"
    for group in groups:
        values = {
            p.name: Estimate(p.grid[len(p.grid) // 2] if p.grid else p.scale if p.group == group else 0.0) for p in parameters
        }
        moved = o.of(total_displacement([*study.terms, Term(effect, values)], o.scene) - before)
        if (moved**2).sum() > (best**2).sum():
            best, named = moved, group.capitalize() if group else "It"
    return best, named


def _strongest(session: Session, residual: np.ndarray, rows: np.ndarray) -> tuple[str, np.ndarray, str]:
    """The variable that explains most of a residual by a curve of third order."""
    best, out = -1.0, ("stamp", session.stamp[rows], "time in the session [s]")
    for name, (values, label) in variables(session).items():
        v = values[rows]
        if not np.isfinite(v).all() or np.ptp(v) < 1e-9:
            continue
        z = (v - v.mean()) / v.std()
        A = np.stack([z**0, z, z**2, z**3], axis=1)
        fitted = A @ np.linalg.lstsq(A, residual, rcond=None)[0]
        explained = float((fitted**2).sum() / (residual**2).sum())
        if explained > best:
            best, out = explained, (name, v, label)
    return out


if __name__ == "__main__":
    import sys

    print(*write(Path(sys.argv[1])), sep="\n")
