# SPDX-License-Identifier: Apache-2.0
"""`irec add MODEL EFFECT SESSION -o model2.yaml`: add an effect, refit jointly, say what changed."""

from __future__ import annotations

import argparse

from ..diagnose.improve import add_effect
from ..effects.user import effect_from_text
from ._refit import configure_refit, run_refit


def configure(parser: argparse.ArgumentParser) -> None:
    configure_refit(parser, "id of an effect (see `irec effects`) or a formula such as 'axis 3: c * tau**3'")


def run(args: argparse.Namespace) -> int:
    return run_refit(args, lambda model, session: add_effect(model, effect_from_text(args.effect), session))
