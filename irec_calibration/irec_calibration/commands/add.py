# SPDX-License-Identifier: Apache-2.0
"""`irec add MODEL EFFECT SESSION -o model2.yaml`: add an effect, refit jointly, judge whether the data support it."""

from __future__ import annotations

import argparse
import shlex
import sys

from ..diagnose.candidates import try_effect
from ..diagnose.improve import add_effect
from ..diagnose.settings import SETTINGS
from ..diagnose.study import Study
from ..effects import known_effects
from ..effects.user import effect_from_text
from ..errors import EffectError, SolveError
from ..report.addition import Addition
from ..report.next_steps import Step
from ..workbench.formula import is_formula, undeclared
from ._progress import Progress
from ._refit import configure_refit, run_refit

EXAMPLE = """irec add model.yaml joint_stiffening SESSION -o model2.yaml
  irec add model.yaml 'axis 3: c * tau**3' SESSION -o model2.yaml
  irec add model.yaml 'warm = base z: slope * temp_gear_2' SESSION --parameter slope -o model2.yaml"""


def configure(parser: argparse.ArgumentParser) -> None:
    configure_refit(parser, "id of an effect (see `irec effects`) or a formula such as 'axis 3: c * tau**3'")
    parser.add_argument(
        "--parameter", metavar="NAME", action="append", default=[],
        help="a name in the formula that is a parameter to be identified; single letters (c, k2) are without saying so",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="do not look for rivals: effects that explain the session as well")


def run(args: argparse.Namespace) -> int:
    if is_formula(args.effect):
        confirm_parameters(args.effect, args.parameter)
    elif args.parameter:
        raise EffectError(f"--parameter is for formulas; '{args.effect}' is the id of an effect")
    effect = effect_from_text(args.effect)

    def rivals(before: Study) -> list[str]:
        """Effects whose evidence comes near."""
        say = Progress()
        say(0.1, "looking for effects that explain the session as well")
        own = None if before.why_not(effect) else try_effect(before, effect)
        near: list[str] = []
        if own is not None and own.log_evidence > SETTINGS.nats_to_separate:
            present = {t.effect.id for t in before.terms} | {effect.id}
            for other in known_effects().values():
                if other.id in present or before.why_not(other):
                    continue
                try:
                    trial = try_effect(before, other)
                except (EffectError, SolveError):  # it can't act here
                    continue
                if trial is not None and trial.log_evidence > own.log_evidence - SETTINGS.nats_to_separate:
                    near.append(other.id)
        say(1.0, "done")
        return near

    def steps(said: Addition | None) -> list[Step]:
        session, model = shlex.quote(args.session), shlex.quote(args.output)
        if said is not None and not said.supported:
            return [("See what the data ask for instead:", f"irec diagnose {session} --model {shlex.quote(args.model)}")]
        return [
            ("Look at what is left:", f"irec diagnose {session} --model {model}"),
            ("Compare the model with a session that it was not made from:", f"irec compare {model} OTHER_SESSION"),
        ]

    return run_refit(
        args, lambda model, session: add_effect(model, effect, session), rivals=None if args.quick else rivals, steps=steps
    )


def confirm_parameters(text: str, declared: list[str]) -> None:
    """Ask about names that may be typing errors; without a terminal they have to be declared.

    Raises EffectError: the formula can't be read, or a name is neither a variable nor a declared parameter.
    """
    for name, meant in undeclared(text, declared):
        hint = f"; did you mean {meant}?" if meant else ""
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise EffectError(
                f"formula '{text}': '{name}' is no variable{hint} If it is a parameter to be identified, say so with"
                f" --parameter {name}; `irec effects --variables` lists the variables"
            )
        print(f"'{name}' is no variable{hint} Is it a parameter to be identified? [y/N] ", end="", file=sys.stderr, flush=True)
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            raise EffectError(f"formula '{text}': '{name}' is neither a variable nor a parameter")
