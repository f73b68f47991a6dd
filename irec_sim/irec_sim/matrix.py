# SPDX-License-Identifier: Apache-2.0
"""Which sessions a blind matrix has: how many of each kind, what is hidden in them, and how they are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .absolute import MISHAPS as ABSOLUTE_MISHAPS
from .mishaps import KINDS as MISHAPS
from .noise import TAILS, WAYS_TO_BE_WRONG
from .outside import OUTSIDE
from .truth_catalogue import CATALOGUE

KIND_NAMES = ("clean", "single", "pair", "many", "outside", "robust", "absolute")
STRENGTHS = (0.03, 0.08, 0.15)  # of the RMS deflection
_FULL = {"clean": 26, "single": 44, "pair": 14, "many": 50, "outside": 30, "robust": 18, "absolute": 16}
_QUICK = {"clean": 8, "single": 10, "pair": 3, "many": 10, "outside": 6, "robust": 4, "absolute": 4}
_NEVER_SEEN = ("encoder_harmonics",)  # cancels in loaded sessions


@dataclass(frozen=True)
class Case:
    """One session of the matrix.

    Attributes:
        kind: one of KIND_NAMES; effects: hidden ones; strength: share of the RMS deflection that each causes (0: real sizes).
        claim: `right` or a way to state the noise wrongly; tail: distribution of the noise; slow: part of it wanders.
        mishap: what goes wrong in one row, or empty; repeats: passes over the poses; repeated: poses of later passes.
        one_order: load cases always in the same order; temperatures: columns that are logged.
        nothing_hidden: an absolute session draws no effects of its own.
    """

    kind: str
    effects: tuple[str, ...] = ()
    strength: float = 0.0
    claim: str = "right"
    tail: str = "normal"
    slow: bool = False
    mishap: str = ""
    repeats: int = 1
    repeated: int | None = None
    one_order: bool = True
    temperatures: str = "all"
    nothing_hidden: bool = False


def plain_cases(effects: Sequence[str], strengths: Sequence[float], times: int) -> list[Case]:
    """Given effects (or `clean`) at given strengths, measured without anything else going wrong."""
    out = []
    for e in effects:
        if e == "clean":
            out += [Case("clean")] * times
        else:
            out += [Case("single" if e in CATALOGUE else "outside", (e,), s) for s in strengths for _ in range(times)]
    return out


def clean_cases(rng: np.random.Generator, each: int, mishaps: bool = True) -> list[Case]:
    """Loaded and absolute sessions in which nothing is hidden, so many of each, as in the whole matrix; noise wanders in half."""
    cases = matrix_cases(rng, only=("clean", "absolute"), each=each, mishaps=mishaps)
    return [replace(c, nothing_hidden=True, slow=bool(s)) for c, s in zip(cases, _spread(2 * each, 0.5, rng), strict=True)]


def matrix_cases(
    rng: np.random.Generator, size: float = 1.0, quick: bool = False, only: Sequence[str] = KIND_NAMES,
    each: int | None = None, mishaps: bool = True,
) -> list[Case]:  # fmt: skip
    """The cases of a matrix: in each kind half of the sessions state their noise wrongly, a third has a mishap.

    Args:
        size: multiplies how many there are; quick: about forty in all; only: kinds; each: how many of each kind instead;
            mishaps: whether anything goes wrong in single rows.
    """
    out = []
    for kind in only:
        count = max(1, round((_QUICK if quick else _FULL)[kind] * size)) if each is None else each
        causes = _causes(kind, count, rng)
        wrong = _spread(count, 0.5, rng)
        spoiled = _spread(count, (1.0 if kind == "robust" else 1.0 / 3.0) * mishaps, rng)
        tails, slow, repeated, ordered = (_spread(count, share, rng) for share in (0.4, 0.25, 0.45, 0.3))
        for i, (effects, strength) in enumerate(causes):
            passes = int(rng.integers(2, 4)) if repeated[i] else 1
            out.append(
                Case(
                    kind, effects, strength,
                    claim=str(rng.choice(WAYS_TO_BE_WRONG, p=[0.6, 0.2, 0.2])) if wrong[i] else "right",
                    tail=str(rng.choice(TAILS[1:])) if tails[i] else "normal",
                    slow=bool(slow[i]),
                    mishap=str(_mishaps(kind)[i % len(_mishaps(kind))]) if spoiled[i] else "",
                    repeats=passes,
                    repeated=int(rng.integers(4, 12)) if passes > 1 and rng.random() < 0.7 else None,
                    one_order=bool(ordered[i]),
                    temperatures=str(rng.choice(["all", "ambient", "none"], p=[0.6, 0.2, 0.2])),
                )
            )  # fmt: skip
    return out


def _mishaps(kind: str) -> tuple[str, ...]:
    return ABSOLUTE_MISHAPS if kind == "absolute" else MISHAPS


def _spread(count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """That share of the cases, at random places."""
    exact = count * share
    chosen = np.zeros(count, dtype=bool)
    chosen[: int(exact) + (rng.random() < exact - int(exact))] = True
    return rng.permutation(chosen)


def _causes(kind: str, count: int, rng: np.random.Generator) -> list[tuple[tuple[str, ...], float]]:
    """Effects and strength of each case of a kind; `many` is drawn when the cell is known."""
    names = [e for e in CATALOGUE if e not in _NEVER_SEEN]
    if kind == "single":
        each = [n for _ in range(count // len(names) + 1) for n in rng.permutation(names)][:count]
        strong = np.resize(STRENGTHS, 3)[rng.integers(0, 3, count)]
        return [((str(e),), float(s)) for e, s in zip(each, strong, strict=True)]
    if kind == "pair":
        return [(tuple(str(e) for e in rng.choice(names, 2, replace=False)), float(STRENGTHS[1 + i % 2])) for i in range(count)]
    if kind == "outside":
        each = [n for _ in range(count // len(OUTSIDE) + 1) for n in rng.permutation(list(OUTSIDE))][:count]
        return [((str(e),), float(STRENGTHS[1 + i % 2])) for i, e in enumerate(each)]
    if kind == "robust":
        return [((), 0.0) if i % 2 == 0 else ((str(rng.choice(names)),), 0.1) for i in range(count)]
    return [((), 0.0)] * count
