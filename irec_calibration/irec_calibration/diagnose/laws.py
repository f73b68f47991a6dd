# SPDX-License-Identifier: Apache-2.0
"""Short laws that stand in for what has structure and no name, so that an improved model predicts it.

They are formulas such as a diagnosis proposes (`proposals.py`, `law_forms.py`), as far as they may be used without anybody
looking at them: laws in proportion to the load that lower the error on held-out poses, also where whole regions of poses are held
out. Others are left to people: a calibration presses with few forces, held-out poses with the same, and what happens between and
beyond them no such test tells.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..effects import is_predicted
from ..effects.formula import FormulaEffect
from ..effects.live import Refused
from ..effects.scene import Scene
from ..errors import SolveError
from ..identification.validation import predicted_from_others
from ..model import Term, displacements
from ..session.data import Session
from ..typing import Array, IntArray
from .assessment import Assessment
from .columns import block_columns
from .directions import follows_course
from .evidence import Bench, Block
from .held_out import Validated, validated
from .level import family_in_view
from .proposals import weighed
from .remainder import grow
from .settings import SETTINGS, Settings
from .stand_in import StandIn
from .study import Study, study_of

NO_LAW = {"wandering"}  # evidence of what goes by itself
REPEATS = re.compile(r"([\d.]+) \* q_")
WAVE = re.compile(r"(?<=(?:cos|sin)\()(?:([\d.]+) \* )?q_(\d+)(?=\))")  # what a law of an angle turns with
SEEN_TO_REPEAT = 2.0  # periods of the angles of a session, from which a law is carried on beyond them
BISECTIONS = 4  # of the poses, at most: into 16 regions
FEWEST_IN_REGION = 2  # poses


def laws(
    session: Session, assessment: Assessment, before: Validated, check: Callable[[], None], settings: Settings = SETTINGS
) -> tuple[StandIn, ...]:
    """Laws that stand in for what has no name, one on top of the other, each with the model that has it.

    Args:
        before: the model without them, as people are shown it; check: raises where the work was cancelled.

    Raises:
        SolveError: the session can't be used with this model.
    """
    out: list[StandIn] = []
    if not set(assessment.evidence) - NO_LAW:
        return ()
    variables: Sequence[str] = assessment.depends_on
    while len(out) < settings.laws.most:
        found = _best(session, before, variables, check, settings)
        if found is None:
            break
        out.append(found)
        before, variables = found.model, ()
    return tuple(out)


def _best(
    session: Session, before: Validated, variables: Sequence[str], check: Callable[[], None], settings: Settings
) -> StandIn | None:
    """The likeliest law on top of a model that helps on held-out poses and regions of them."""
    plain = before.study  # where what stands out counts for nothing
    refitted = 0
    for law, block, nats in _likely(plain.to_weigh, variables, check, settings):
        check()
        columns = replace(block, A=block_columns(plain, law, {})[0].A)
        if not helps_elsewhere(plain, plain.bench, plain.base + columns, settings):
            continue
        if refitted == settings.laws.refitted:
            break
        refitted += 1
        effect = FormulaEffect(_id(law.formula, {t.effect.id for t in plain.terms}), within_angles(law.formula, plain.ready.q))
        try:
            made = validated(session, (*plain.terms, Term(effect)))
        except SolveError:
            continue
        if made.study.fit.rms >= plain.fit.rms or made.held_out.rms_m > (1.0 - settings.laws.worth) * before.held_out.rms_m:
            continue
        if _share(made.study, effect.id) > settings.laws.most_of_deflection:
            continue
        again = study_of(plain.observation, made.study.terms)  # with it the springs are as soft as they are beside it
        if helps_elsewhere(plain, again.bench, again.base, settings):
            return StandIn(effect, nats, made)
    return None


def _likely(
    study: Study, variables: Sequence[str], check: Callable[[], None], settings: Settings
) -> list[tuple[FormulaEffect, Block, float]]:
    """Laws that may stand in where structure is left beside a model, with their columns and evidence, the likeliest first.

    Beside structure that follows time or a temperature, one that follows neither needs a share of its evidence.
    """
    remainder = grow(study.bench, family_in_view(study), study.base)
    if not remainder.structures:
        return []
    variables = list(dict.fromkeys([*variables, *(v for p in remainder.structures for v in p.structure.variables)]))
    in_course = [p.log_evidence for p in remainder.structures if any(map(follows_course, p.structure.variables))]
    least = settings.laws.beside_course * max(in_course, default=0.0)

    def may(law: FormulaEffect, nats: float) -> bool:
        return (nats >= least or bool({"time", "temperature"} & set(law.needs))) and _may(law, study.ready, settings)

    return [one for one in weighed(study, remainder, variables, check, settings) if may(one[0], one[2])]


def within_angles(formula: str, q: Array) -> str:
    """A law with the angles of its waves held at the ends of what a session has of them, but for waves seen to repeat.

    Args:
        q: joint angles of the session, (n, k), rad.
    """

    def held(wave: re.Match[str]) -> str:
        often, joint = float(wave[1] or 1.0), int(wave[2])
        low, high = np.floor(100.0 * q[:, joint - 1].min()) / 100.0, np.ceil(100.0 * q[:, joint - 1].max()) / 100.0
        if often * (high - low) >= SEEN_TO_REPEAT * 2.0 * np.pi:
            return wave[0]
        return f"{wave[1]} * clip(q_{joint}, {low:g}, {high:g})" if wave[1] else f"clip(q_{joint}, {low:g}, {high:g})"

    return WAVE.sub(held, formula)


def _share(study: Study, effect_id: str) -> float:
    """RMS of the displacement by an effect over that of the whole model, in observed rows; 0 in an absolute session."""
    if study.ready.kind == "absolute":
        return 0.0
    each = displacements(study.terms, study.observation.scene, study.ready)
    rows = study.observation.rows
    whole = np.sum(list(each.values()), axis=0)[rows]
    return float(np.linalg.norm(each[effect_id][rows]) / max(float(np.linalg.norm(whole)), 1e-300))


def helps_elsewhere(study: Study, bench: Bench, block: Block, settings: Settings = SETTINGS) -> bool:
    """Whether a model is better with a law by some standard errors over regions, each predicted from all others.

    A pose alone is much like its neighbours, and what they have in common by chance predicts it. A region that lies beyond all
    others counts no more than some of them: a model is not used beyond the poses that it was identified in.

    Args:
        study: without it; bench, block: with it, on the same rows.
    """
    of_region = regions(study.session.q[study.observation.rows], study.observation.pose)
    if len(of_region) < 2:
        return False
    parts = [np.flatnonzero(np.isin(study.bench.pose, poses)) for poses in of_region]
    saved = _missed(study.bench, study.base, parts) - _missed(bench, block, parts)
    most = settings.laws.far_off * float(np.median(np.abs(saved)))
    saved = np.clip(saved, -most, most)
    return bool(saved.mean() > settings.held_out_sigmas * saved.std(ddof=1) / np.sqrt(len(saved)))


def regions(q: Array, pose: IntArray) -> list[IntArray]:
    """Poses that are near each other: halved time and again across the joint that spreads them most.

    Args:
        q: joint angles of rows, (m, k), rad; pose: of each row, (m,).
    """
    poses, of_row = np.unique(pose, return_inverse=True)
    centre = np.stack([np.bincount(of_row.ravel(), column) for column in q.T], axis=1) / np.bincount(of_row.ravel())[:, None]
    parts = [np.arange(len(poses))]
    for _ in range(BISECTIONS):
        if min(len(p) for p in parts) < 2 * FEWEST_IN_REGION:
            break
        parts = [half for part in parts for half in np.array_split(_along_widest(centre, part), 2)]
    return [poses[p] for p in parts]


def _along_widest(centre: Array, part: IntArray) -> IntArray:
    """Some poses in the order of the joint that spreads them most."""
    joint = int(np.argmax(np.ptp(centre[part], axis=0)))
    return np.asarray(part[np.argsort(centre[part, joint], kind="stable")])


def _missed(bench: Bench, block: Block, parts: Sequence[IntArray]) -> Array:
    """Squared error of equations that are predicted from those of all other parts, per part, in variances."""
    left = predicted_from_others(block.A, bench.b, parts, block.lower, block.upper, block.width**-2.0, bench.rounding)
    return np.array([(left[rows] ** 2).sum() for rows in parts])


def _may(law: FormulaEffect, scene: Scene, settings: Settings = SETTINGS) -> bool:
    """Whether predictions and corrections may have it: in proportion to the process force in a loaded session, of an axis' own
    torque and angle in an absolute one, without powers of anything else, which soon are far off where it is a little warmer.

    What repeats often per turn of an axis in an absolute session is left to `joint_ripple`, all orders of which belong together:
    one order by itself did harm in poses that were not measured.
    """
    if not is_predicted(law.cause, scene.kind) or isinstance(law.no_live_form(), Refused) or "**" in law.formula:
        return False
    if scene.kind == "absolute":
        return law.turns_by_itself and all(float(often) <= settings.laws.most_often for often in REPEATS.findall(law.formula))
    ones = np.ones(len(law.parameters(scene)))
    by_half = law.displacement(scene.with_wrench(0.5 * scene.force_in_tool, 0.5 * scene.torque_in_tool), ones)
    return np.allclose(by_half, 0.5 * law.displacement(scene, ones), rtol=1e-6, atol=1e-15)


def _id(formula: str, present: set[str]) -> str:
    """An id that a model does not have yet."""
    stem = "law_of_" + formula.partition(":")[0].replace(" ", "_")
    return next(i for i in (stem, *(f"{stem}_{n}" for n in range(2, 100))) if i not in present)
