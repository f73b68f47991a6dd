# SPDX-License-Identifier: Apache-2.0
"""`irec remove MODEL EFFECT SESSION -o model2.yaml`: take an effect out, refit, say what changed."""

from __future__ import annotations

import argparse

from ..diagnose.improve import remove_effect
from ..diagnose.study import Study, prepare
from ..model import Model
from ..session import Session
from ._refit import configure_refit, run_refit


def configure(parser: argparse.ArgumentParser) -> None:
    configure_refit(parser, "id of an effect of the model")


def run(args: argparse.Namespace) -> int:
    def refit(model: Model, session: Session) -> tuple[Model, Study, Study]:
        new, after = remove_effect(model, args.effect, session)
        return new, prepare(session, model.terms), after

    return run_refit(args, refit)
