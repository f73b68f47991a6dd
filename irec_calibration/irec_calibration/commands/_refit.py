# SPDX-License-Identifier: Apache-2.0
"""What `irec add` and `irec remove` share: their arguments, and what they say of the refitted model."""

from __future__ import annotations

import argparse
import json
import math
import textwrap
from collections.abc import Callable
from pathlib import Path

from ..diagnose.held_out import held_out, held_out_beside
from ..diagnose.study import Study
from ..errors import IrecError
from ..identification.validation import ESTIMATOR, gain
from ..lengths import length
from ..model import Model
from ..model.file import check_belongs, check_model_target, load_model, save_model
from ..report.addition import Addition, addition_of, probability
from ..report.next_steps import Step, in_lines
from ..session import Session
from ._session import configure_plausible, plausible_session

Refit = Callable[[Model, Session], tuple[Model, Study, Study]]
WIDTH = 100


def configure_refit(parser: argparse.ArgumentParser, effect: str) -> None:
    """Arguments of both; `effect` says what the effect's argument may be."""
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("effect", help=effect)
    parser.add_argument("session", help="session that it is refitted to")
    parser.add_argument("-o", "--output", default="model2.yaml", help="model file to write (default: model2.yaml)")
    parser.add_argument("--force", action="store_true", help="overwrite the model file where it exists")
    configure_plausible(parser)
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def check_free(path: str | Path, force: bool) -> None:
    """Refuse to overwrite a file. Raises IrecError."""
    if Path(path).exists() and not force:
        raise IrecError(f"{path} exists already; name another file with -o, or overwrite it with --force")


def run_refit(
    args: argparse.Namespace,
    refit: Refit,
    *,
    rivals: Callable[[Study], list[str]] | None = None,
    steps: Callable[[Addition | None], list[Step]] | None = None,
) -> int:
    """Load model and session, change the model, save it, say what changed and what follows.

    Args:
        refit: returns the new model and both studies.
        rivals: effects that explain the session as well as the one that was added, by the old study.
        steps: what to do next.
    """
    check_free(args.output, args.force)
    check_model_target(args.output)
    model, session = load_model(args.model), plausible_session(args)
    check_belongs(model, session.robot, session.serial)
    new, before, after = refit(model, session)
    said = addition_to(model, new, before, after)
    others = rivals(before) if rivals else []
    path = save_model(new, args.output)
    if args.json:
        more = {} if said is None else {"support": said.support, "sentence": said.sentence, "rivals": others}
        print(json.dumps({"model": str(path), **change(before, after), **more}))
        return 0
    print(what_changed(model, new, before, after))
    if said is not None:
        print(textwrap.fill(said.sentence, WIDTH))
        if others:
            print(
                textwrap.fill(
                    f"These explain the session about as well, so that it can't tell which: {', '.join(others)}.", WIDTH
                )
            )
    print(f"wrote {path}")
    if steps:
        print(in_lines(steps(said)))
    return 0


def addition_to(old: Model, new: Model, before: Study, after: Study) -> Addition | None:
    """Whether the data support what was added; None where nothing was."""
    term = next((t for t in new.terms if t.effect.id not in old.effects), None)
    if term is None:
        return None
    return addition_of(held_out(before), held_out_beside(before, after), term, term.effect.parameters(after.ready))


def change(before: Study, after: Study) -> dict[str, float | str | list[str] | None]:
    """Figures of two models of one session."""
    old, new = held_out(before), held_out_beside(before, after)
    _, _, p = gain(old, new)
    figures = {
        "cv_rms_before_m": old.rms_m,
        "cv_rms_after_m": new.rms_m,
        "p_value": p,
        "noise_floor_m": after.observation.whiten.floor,
    }
    finite = {k: v if v == v else None for k, v in figures.items()}
    return {"effects": [t.effect.id for t in after.terms], "estimator": ESTIMATOR, **finite}


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
        p = f["p_value"] if isinstance(f["p_value"], float) else math.nan
        lines.append(
            f"error on held-out poses {length(cv[0])} -> {length(cv[1])} "  # type: ignore[arg-type]
            f"(noise {length(after.observation.whiten.floor)}, paired test {probability(p)})"
        )
        lines.append(textwrap.fill(f"estimator: {ESTIMATOR}", WIDTH, subsequent_indent="  "))
    return "\n".join(lines)
