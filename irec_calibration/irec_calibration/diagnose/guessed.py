# SPDX-License-Identifier: Apache-2.0
"""Effects with so many parameters that they take up whatever each pose does by itself.

Such an effect explains a session well, other poses too where they are few, and nothing bears out that it is there: what gears
keep from the way to a pose, noise that its readings have in common, and what the form of a large play leaves, were called a hose
with each of its forms at once.
"""

from __future__ import annotations

import numpy as np

from .build import Built
from .explanation import without
from .parts import parts_in, prune
from .settings import SETTINGS
from .study import Study


def guessed(built: Built) -> dict[str, str]:
    """Added effects of a loaded session no part of which is proven, with more parameters than any displacement of each pose has,
    or with more forms of a pull at once than a cause has, and why they can't be told, in words.

    What explains much of all that has a name is there in some form, whichever it is.
    """
    final = built.final
    if final.study.ready.kind != "loaded":
        return {}
    poses = len(np.unique(final.study.observation.pose))

    def too_many(study: Study, effect_id: str) -> bool:
        return study.owners.count(effect_id) > SETTINGS.parameters_of_pose * poses

    def is_much(effect_id: str) -> bool:
        own = final.named - without(built.start, final, effect_id, built.family).named
        return own > max(SETTINGS.nats_of_guess, SETTINGS.share_of_guess * (final.named - built.start.named))

    many = [i for i in final.ids if too_many(final.study, i) or _forms(final.study, i) > SETTINGS.forms_of_cause]
    if not many:
        return {}
    pruned = prune(final.study, many, family=built.family)
    out: dict[str, str] = {}
    for i in many:
        parts = pruned.parts.get(i)
        if parts is None or parts.proven or is_much(i):
            continue
        if too_many(pruned.study, i):
            out[i] = f"it has more parameters than {SETTINGS.parameters_of_pose} for each of {poses} poses"
        elif _forms(pruned.study, i) > SETTINGS.forms_of_cause and not parts.one_of:
            out[i] = f"it has more than {SETTINGS.forms_of_cause} forms at once, each of which would be a cause"
    return {i: f"no part of it is proven, and {why}" for i, why in out.items()}


def _forms(study: Study, effect_id: str) -> int:
    """How many parts of a pull at the arm a model has that are no axes: each would be a cause of its own. Those of a force sensor
    that is wrong are none."""
    term = next(t for t in study.terms if t.effect.id == effect_id)
    if not term.effect.loads_arm:
        return 0
    of_axes = {p.group for p in term.effect.parameters(study.ready) if p.axis is not None}
    return len(set(parts_in(term, study)) - of_axes)
