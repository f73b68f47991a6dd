# SPDX-License-Identifier: Apache-2.0
"""What `irec add` and `irec remove` share: their arguments, and what they say of the refitted model."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable

from ..diagnose.held_out import gain, held_out
from ..diagnose.study import Study
from ..model import Model
from ..model_file import check_belongs, load_model, save_model
from ..session import Session, read_session

Refit = Callable[[Model, Session], tuple[Model, Study, Study]]


def configure_refit(parser: argparse.ArgumentParser, effect: str) -> None:
    """Arguments of both; `effect` says what the effect's argument may be."""
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("effect", help=effect)
    parser.add_argument("session", help="session that it is refitted to")
    parser.add_argument("-o", "--output", default="model2.yaml", help="model file to write (default: model2.yaml)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run_refit(args: argparse.Namespace, refit: Refit) -> int:
    """Load model and session, change the model, save it, say what changed; `refit` returns the new model and both studies."""
    model, session = load_model(args.model), read_session(args.session)
    check_belongs(model, session.robot, session.serial)
    new, before, after = refit(model, session)
    path = save_model(new, args.output)
    if args.json:
        print(json.dumps({"model": str(path), **change(before, after)}))
    else:
        print(f"{what_changed(model, new, before, after)}\nwrote {path}")
    return 0


def change(before: Study, after: Study) -> dict[str, float | list[str] | None]:
    """Figures of two models of one session."""
    old, new = held_out(before), held_out(after)
    _, _, p = gain(old, new)
    figures = {
        "cv_rms_before_m": old.rms_m,
        "cv_rms_after_m": new.rms_m,
        "p_value": p,
        "noise_floor_m": after.observation.whiten.floor,
    }
    return {"effects": [t.effect.id for t in after.terms], **{k: v if v == v else None for k, v in figures.items()}}


def what_changed(old: Model, new: Model, before: Study, after: Study) -> str:
    """New parameters, those that moved by more than two standard errors, and the error on held-out poses."""
    f = change(before, after)
    values = {f"{t.effect.id}.{n}": e for t in before.terms for n, e in t.estimates.items()}
    lines = []
    for term in new.terms:
        for name, e in term.estimates.items():
            key = f"{term.effect.id}.{name}"
            if key not in values:
                lines.append(f"new      {key:34} {e}")
            elif e.se == e.se and abs(e.value - values[key].value) > 2.0 * e.se:
                lines.append(f"changed  {key:34} {values[key].value:.4g} -> {e}")
    gone = [t.effect.id for t in old.terms if t.effect.id not in new.effects]
    lines += [f"removed  {g}" for g in gone]
    cv = [f["cv_rms_before_m"], f["cv_rms_after_m"]]
    if all(isinstance(x, float) for x in cv):
        before_um, after_um, noise_um = (1e6 * x for x in (*cv, after.observation.whiten.floor))  # type: ignore[operator]
        lines.append(
            f"error on held-out poses {before_um:.1f} -> {after_um:.1f} um (noise {noise_um:.1f} um, "
            f"paired test p = {f['p_value']:.2g})"
        )
    return "\n".join(lines)
