# SPDX-License-Identifier: Apache-2.0
"""`irec add MODEL EFFECT SESSION -o model2.yaml`: add an effect, refit jointly, say what changed."""

from __future__ import annotations

import argparse
import json

from ..diagnose.held_out import gain, held_out
from ..diagnose.improve import add_effect
from ..diagnose.study import Study
from ..effects.user import effect_from_text
from ..model import Model
from ..model_file import check_belongs, load_model, save_model
from ..session import read_session


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("effect", help="id of an effect (see `irec effects`) or a formula such as 'axis 3: c * tau**3'")
    parser.add_argument("session", help="session that it is refitted to")
    parser.add_argument("-o", "--output", default="model2.yaml", help="model file to write (default: model2.yaml)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    model, session = load_model(args.model), read_session(args.session)
    check_belongs(model, session.robot, session.serial)
    new, before, after = add_effect(model, effect_from_text(args.effect), session)
    path = save_model(new, args.output)
    print(
        json.dumps({"model": str(path), **change(before, after)})
        if args.json
        else f"{what_changed(model, new, before, after)}\nwrote {path}"
    )
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
            se = f" +- {e.se:.2g}" if e.se == e.se else ""
            if key not in values:
                lines.append(f"new      {key:34} {e.value:.4g}{se} {e.unit}")
            elif e.se == e.se and abs(e.value - values[key].value) > 2.0 * e.se:
                lines.append(f"changed  {key:34} {values[key].value:.4g} -> {e.value:.4g}{se} {e.unit}")
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
