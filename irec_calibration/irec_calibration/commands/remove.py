# SPDX-License-Identifier: Apache-2.0
"""`irec remove MODEL EFFECT SESSION -o model2.yaml`: take an effect out, refit, say what changed."""

from __future__ import annotations

import argparse
import shlex

from ..diagnose.improve import remove_effect
from ..diagnose.study import Study, prepare
from ..model import Model
from ..session import Session
from ._refit import configure_refit, run_refit

EXAMPLE = "irec remove model2.yaml joint_stiffening SESSION -o model3.yaml"


def configure(parser: argparse.ArgumentParser) -> None:
    configure_refit(parser, "id of an effect of the model")


def run(args: argparse.Namespace) -> int:
    def refit(model: Model, session: Session) -> tuple[Model, Study, Study]:
        new, after = remove_effect(model, args.effect, session)
        return new, prepare(session, model.terms), after

    command = f"irec diagnose {shlex.quote(args.session)} --model {shlex.quote(args.output)}"
    return run_refit(args, refit, steps=lambda _: [("See whether it is missed:", command)])
