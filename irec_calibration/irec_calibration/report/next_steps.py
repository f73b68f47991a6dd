# SPDX-License-Identifier: Apache-2.0
"""What to do next, in words and as a command that can be copied: at the end of every command and at the top of every page."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Sequence

from ..diagnose.improve import Ladder
from ..diagnose.result import Diagnosis, Measurement
from ..identification.noise import InferredNoise
from ..lengths import length
from ..model import EIGHTEEN_DOF, GEOMETRIC

Step = tuple[str, str]  # sentence, command or ""
WIDTH = 100
WITHOUT_TRACKER = "--without-tracker"
DEGREES = 57.29577951308232
DOUBTFUL_NOISE = 2.0  # times the noise that a session states, from which a cause may hide in it
DOUBTFUL_WANDER = 0.5  # share of the noise's variance, likewise


def after_diagnosis(d: Diagnosis, session: str, model: str = "", *, without_tracker: bool = False) -> list[Step]:
    """What follows from a diagnosis.

    Args:
        session, model: paths as the user typed them; no model: one has to be identified first.
        without_tracker: the session was read without its tracker, which irec add and the workbench can't do.
    """
    v = d.verdict
    s = shlex.quote(session)
    steps: list[Step] = []
    if without_tracker:
        return [("Let irec add what the evidence justifies:", f"irec improve {s} {WITHOUT_TRACKER} -o improved")]
    if v.status == "missing_effect":
        start = model
        if not model:
            start = "model.yaml"
            steps.append(("Identify the model that was diagnosed:", _solve(d, s)))
        name = start
        for i, effect in enumerate(v.effects):
            new = "model2.yaml" if len(v.effects) == 1 else f"model{i + 2}.yaml"
            steps.append(
                (
                    f"Add {effect}, refit, and see whether the data support it:",
                    f"irec add {shlex.quote(name)} {effect} {s} -o {new}",
                )
            )
            name = new
        steps.append(("Or let irec add what the evidence justifies:", f"irec improve {s} -o improved"))
        if d.proposals:
            steps.append(("Then try a formula for what has no name:", _formula(d, name, s)))
    elif v.status == "unexplained":
        on = f" It depends on {', '.join(v.depends_on[:3])}." if v.depends_on else ""
        steps.append(
            (
                f"Look at the residual and try effects by hand.{on}",
                f"irec workbench {s}" + (f" {shlex.quote(model)}" if model else ""),
            )
        )
        if d.proposals:
            if not model:
                steps.append(("Identify the model that was diagnosed:", _solve(d, s)))
            steps.append(("Try the formula that describes it best; it names no cause:", _formula(d, model or "model.yaml", s)))
    elif v.too_few:
        steps.append(("Too few data to judge a model. Plan more poses, measure them, and diagnose again:", "irec plan CELL"))
    else:
        doubt = instruments_first(d.noise)
        steps += doubt
        begin = "Until then nothing is to be added." if doubt else "Nothing is to be added."
        if v.usual and not doubt:
            steps.append(("No cause is missing. Take in what every robot has:", f"irec improve {s} -o improved"))
        elif model:
            steps.append(
                (f"{begin} See what the model predicts where it will be used:", f"irec predict {shlex.quote(model)} {s}")
            )
        else:
            steps.append((f"{begin} Identify the model{'' if doubt else ' and use it'}:", _solve(d, s)))
    if d.next_measurements and v.status != "adequate":
        m = d.next_measurements[0]
        if m.repeats:
            steps.append((where_to_measure(m), ""))
    if v.one_of and d.model.effects != GEOMETRIC:  # an absolute session has no tooling to plan on
        tell = "Or measure poses that tell which of them it is, as far as this tooling can:"
        steps.append((tell, f"irec plan CELL --to-tell {s}"))
    return steps


def instruments_first(noise: InferredNoise | None) -> list[Step]:
    """To look at the instruments first, where what passes for noise is far more than they claim, or wanders for the most part."""
    if noise is None:
        return []
    why = []
    if noise.differs and noise.ratio > DOUBTFUL_NOISE:
        why.append(f"is {noise.ratio:.1f} times what the session states")
    if noise.wander_share > DOUBTFUL_WANDER:
        why.append(f"wanders for {100 * noise.wander_share:.0f} %")
    if not why:
        return []
    return [
        (
            f"What passes for noise {' and '.join(why)}: a cause may hide in it. Look at the instruments and their mounting first"
            " (tracker, reflector, station, force sensor), measure some poses twice, and diagnose again.",
            "",
        )
    ]


def _formula(d: Diagnosis, model: str, session: str) -> str:
    return f"irec add {shlex.quote(model)} {shlex.quote(d.proposals[0].formula)} {session} -o model_formula.yaml"


def _solve(d: Diagnosis, session: str) -> str:
    terms = "" if d.model.effects in (EIGHTEEN_DOF, GEOMETRIC) else f" --terms {','.join(d.model.effects)}"
    return f"irec solve {session}{terms} -o model.yaml"


def after_improvement(ladder: Ladder, session: str, model: str, *, without_tracker: bool = False) -> list[Step]:
    """What follows from an improvement; `model` is the file that was written; without_tracker: so was the session read."""
    m = shlex.quote(model)
    s = shlex.quote(session) + (f" {WITHOUT_TRACKER}" if without_tracker else "")
    if len(ladder.rungs) < 2:
        return [("No effect was added. See why:", f"irec diagnose {s}")]
    return [
        ("Compare the new model with a session that it was not made from:", f"irec compare {m} OTHER_SESSION"),
        ("Look at what is left:", f"irec diagnose {s} --model {m}"),
    ]


def where_to_measure(m: Measurement) -> str:
    """A proposed measurement in a sentence, and how often to take it; joint angles in degrees."""
    at = f"pose {m.pose}" if m.pose else "a new pose at joints " + ", ".join(f"{DEGREES * x:.0f}" for x in m.q) + " deg"
    often = f", {m.repeats} repeats" if m.repeats > 1 else ""
    apart = f"it separates {' and '.join(m.separates)} by {length(m.difference_m)}"
    return f"Measure next: {at}, load case {m.load_case}{often}: {apart}."


def in_lines(steps: Sequence[Step]) -> str:
    """Steps for a terminal."""
    lines = []
    for text, command in steps:
        begin = "next: " if command else ""  # what has no command says itself what to do
        lines.append(textwrap.fill(begin + text, WIDTH, subsequent_indent="      "))
        lines += [f"      {command}"] if command else []
    return "\n".join(lines)
