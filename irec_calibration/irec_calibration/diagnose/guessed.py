# SPDX-License-Identifier: Apache-2.0
"""Effects with so many parameters that they take up whatever each pose does by itself.

Such an effect explains a session well, other poses too where they are few, and nothing bears out that it is there: what gears
keep from the way to a pose, and noise that its readings have in common, were called a hose with each of its forms at once.
"""

from __future__ import annotations

import numpy as np

from .build import Built
from .parts import prune
from .settings import SETTINGS


def guessed(built: Built) -> dict[str, str]:
    """Added effects of a loaded session no part of which is proven, with more parameters than any displacement of each pose has,
    and why they can't be told, in words."""
    final = built.final
    poses = len(np.unique(final.study.observation.pose))
    most = SETTINGS.parameters_of_pose * poses

    def too_many(owners: tuple[str, ...]) -> list[str]:
        return [i for i in final.ids if owners.count(i) > most]

    many = too_many(final.study.owners) if final.study.ready.kind == "loaded" else []
    if not many:
        return {}
    pruned = prune(final.study, many, family=built.family)
    why = f"no part of it is proven, and it has more parameters than {SETTINGS.parameters_of_pose} for each of {poses} poses"
    return {i: why for i in too_many(pruned.study.owners) if i in pruned.parts and not pruned.parts[i].proven}
