# SPDX-License-Identifier: Apache-2.0
"""Which axes an effect was hidden in, which axes the tool says, and how the two compare.

Only the score reads truth files. Axes are written as the tool writes them: `axis 3`, `axes 4-5` for a pair of wrist axes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

USUAL_AXES = 6
IN_EVERY_AXIS = ("encoder_harmonics", "geometry_error")
NAMED_BY_PARAMETER = re.compile(r"_([1-9])$")
PAIR = re.compile(r"^c_([1-9])([1-9])$")


@dataclass(frozen=True)
class AxisScore:
    """Axes of one hidden effect that the tool named.

    Attributes:
        hidden: axes that have it; right, wrong: named with certainty; missed: neither named nor among what is not told apart.
        offered: sets of axes that are said not to be told apart; offered_right: one of them is hidden, whole.
        model_wrong: axes that the improved model has, that have nothing hidden, and of which it does not say that it is unsure.
        model_unsure: the same, of which it says so.
    """

    effect: str
    hidden: frozenset[str]
    right: frozenset[str]
    wrong: frozenset[str]
    missed: frozenset[str]
    offered: bool
    offered_right: bool
    model_wrong: frozenset[str]
    model_unsure: frozenset[str]

    @property
    def is_wrong(self) -> bool:
        """An axis without anything hidden is named, or offered without the true one beside it."""
        return bool(self.wrong) or (self.offered and not self.offered_right)

    @property
    def kind(self) -> str:
        """In one word or two, for counting."""
        if self.is_wrong:
            return "a wrong axis"
        if self.offered:
            return "not told apart"
        if not self.missed:
            return "all"
        return "some" if self.right else "none named"


def hidden_axes(effect: str, parameters: dict[str, Any]) -> frozenset[str] | None:
    """The axes of a hidden effect by its truth; None where it does not act in axes that the tool could name."""
    if effect in ("creep", "counterbalance"):  # in all gears together; in axis 2 by its nature
        return None
    if "joint" in parameters:
        return frozenset({f"axis {int(parameters['joint'])}"})
    if "per_joint" in parameters:
        return frozenset(f"axis {k}" for k, v in enumerate(parameters["per_joint"], 1) if v)
    if effect == "joint_coupling":
        return frozenset(f"axes {n[2]}-{n[3]}" for n, v in parameters.items() if PAIR.match(n) and v)
    return _every_axis(parameters) if effect in IN_EVERY_AXIS else None


def _every_axis(parameters: dict[str, Any]) -> frozenset[str]:
    """All axes of an arm, of which parameters that are stated by axis tell how many it has."""
    by_axis = parameters.get("joint_zero") or (parameters.get("sin") or [[0.0] * USUAL_AXES])[0]
    return frozenset(f"axis {k}" for k in range(1, len(by_axis) + 1))


def axes_in_model(model: dict[str, Any], effect: str) -> frozenset[str]:
    """The axes that parameters of an effect in a model file belong to."""
    names = [n for e in model["effects"] if e["effect"] == effect for n in e["parameters"]]
    found = set()
    for name in names:
        pair, single = PAIR.match(name), NAMED_BY_PARAMETER.search(name)
        if pair and effect == "joint_coupling":
            found.add("axes " + "-".join(sorted(pair.groups())))
        elif single:
            found.add(f"axis {single[1]}")
    return frozenset(found)


def axes_in_text(text: str, label: str) -> frozenset[str]:
    """The axes that the sentence on what is missing gives an effect."""
    sentence = re.search(r"Missing: (.*?)\. Added", text)
    said = re.search(re.escape(label) + r" \(([^)]*)\)", sentence[1]) if sentence else None
    return frozenset(re.findall(r"ax(?:is \d|es \d-\d)", said[1])) if said else frozenset()


def _axes(names: Iterable[str]) -> frozenset[str]:
    return frozenset(n for n in names if re.match(r"^ax(is|es) ", n))


def score_axes(
    effect: str,
    hidden: frozenset[str],
    diagnosis: dict[str, Any],
    text: frozenset[str],
    model: frozenset[str],
    ladder: dict[str, Any],
) -> AxisScore:
    """Compare what diagnosis, text and model say about the axes of an effect that was named, with where it was hidden.

    Args:
        text: axes that the verdict's text gives the effect; model: those of the improved model.
    """
    said = diagnosis["verdict"].get("parts", {}).get(effect)
    if said is None:  # a diagnosis that knows nothing of proof claims every part of its fit
        groups = next((c["groups"] for c in diagnosis["candidates"] if c["effect"] == effect), [])
        said = {"proven": groups, "one_of": [], "perhaps": []}
    named = _axes(said["proven"]) | text
    offered = [_axes(s) for s in said["one_of"]]
    last = ladder["steps"][-1].get("parts", {}).get(effect, said)
    unsure = _axes(last["perhaps"]) | {n for s in last["one_of"] for n in _axes(s)}
    extra = model - hidden
    return AxisScore(
        effect, hidden, named & hidden, named - hidden, hidden - named - {n for s in offered for n in s},
        bool(offered), any(s <= hidden for s in offered), frozenset(extra - unsure), frozenset(extra & unsure),
    )  # fmt: skip


def axes_in_words(scores: list[AxisScore]) -> list[str]:
    """Counts for the summary: effects hidden in one or two axes, and those hidden in more."""
    lines = []
    for title, some in (
        ("in one or two axes", [s for s in scores if len(s.hidden) <= 2]),
        ("in more axes", [s for s in scores if len(s.hidden) > 2]),
    ):
        if not some:
            continue
        kinds = [s.kind for s in some]
        lines.append(f"axes of effects hidden {title} and named right ({len(some)}):")
        lines.append(
            f"  all of them {kinds.count('all')}, some and no wrong one {kinds.count('some')}, said not to be told apart "
            f"{kinds.count('not told apart')}, none named {kinds.count('none named')}, a wrong one {kinds.count('a wrong axis')}"
        )
        right, wrong, missed = (sum(len(getattr(s, k)) for s in some) for k in ("right", "wrong", "missed"))
        lines.append(f"  axes named {right + wrong}: right {right}, wrong {wrong}; missed {missed}")
        stray, unsure = (sum(len(getattr(s, k)) for s in some) for k in ("model_wrong", "model_unsure"))
        lines.append(f"  axes in the improved model that have nothing hidden: {stray}, and {unsure} that it calls unsure")
    return lines
