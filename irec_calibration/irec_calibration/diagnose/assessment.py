# SPDX-License-Identifier: Apache-2.0
"""From a built model to a verdict: adequate, missing effect, or unexplained.

No verdict rests on the stated noise: a residual above it is no evidence of structure. Structure is shown by repeats that scatter
less than the model leaves, by a structure that helps on held-out poses, or by a flexible regression that does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.traits import Evidence
from ..effects.traits import Family as Alike
from ..identification.noise import InferredNoise
from ..identification.validation import HeldOut, gain, rms
from ..model import Term, total_displacement
from .bad_readings import too_many_aside
from .build import Built
from .candidates import Trial
from .evidence import Block
from .explanation import Explanation, also_called, cause_though_usual, ends_at, usual
from .family import Family
from .flexible import Flexible, flexible_gain
from .ground import Ground
from .held_out import held_out, only_good_poses
from .level import Repeats, inferred, repeats_of
from .naming import one_cause_of_bad_rows
from .one_curve import mends_the_other, of_one_curve, of_one_step
from .part_sets import Parts
from .parts import prune
from .remainder import Part, Remainder, grow
from .settings import SETTINGS, Settings
from .study import Study
from .tool_weight import Readings


@dataclass(frozen=True)
class Assessment:
    """What the evidence says, before it is put in words.

    Attributes:
        names: effects that every good explanation needs, most important first; one_of: sets of which one is needed; usual:
            effects that are there no larger than in every robot; usual_m: structure likewise, m; unproven: that have evidence,
            but no part of which is proven and without which other poses are predicted as well.
        study: the model with the added effects, cut down to the parts that they need; remainder: what is left beside it.
        evidence: what shows the structure that has no name: `repeats`, `held_out_structure`, `flexible_regression`,
            `readings_that_stand_out`, `few_poses`, `wandering`.
        remaining_m: size of that structure, RMS over samples, m.
        hidden_m: how large a cause outside the catalogue could be and not be seen, m.
        explained: share of the explainable excess that the added effects explain.
        held_out_base: error of the model that it started from, at the noise level of this assessment; asked: the model that was
            asked about, fitted at that level.
        parts: of each added effect, which axes or directions are proven; other: the likeliest other set of them, with the names
            of the two, where they are not told apart.
    """

    built: Built
    status: str
    names: tuple[str, ...]
    one_of: tuple[tuple[str, ...], ...]
    study: Study
    remainder: Remainder
    depends_on: tuple[str, ...]
    evidence: tuple[str, ...]
    remaining_m: float
    hidden_m: float
    explained: float
    noise: InferredNoise
    repeats: Repeats
    flexible: Flexible
    readings: Readings | None
    held_out_base: HeldOut
    reason: str
    asked: Study
    parts: dict[str, Parts] = field(default_factory=dict)
    other: tuple[tuple[Term, ...], tuple[str, str]] | None = None
    usual: tuple[str, ...] = ()
    usual_m: float = 0.0
    unproven: tuple[str, ...] = ()

    @property
    def added(self) -> tuple[str, ...]:
        return self.built.final.ids

    def without_names(self, fallen: Collection[str]) -> Assessment:
        """The same where some effects of the model are no names."""
        if not fallen:
            return self
        names = tuple(i for i in self.names if i not in fallen)
        status = self.status if names or self.weight_wrong else "unexplained" if self.evidence or self.one_of else "adequate"
        return replace(self, names=names, status=status, unproven=tuple(fallen))

    @property
    def stand_out(self) -> tuple[Part, ...]:
        """Rows and references that stand out and count for nothing."""
        return (*self.asked.apart, *self.remainder.bad_rows)

    @property
    def weight_wrong(self) -> bool:
        return self.readings is not None and self.readings.log_evidence > SETTINGS.nats_to_name


def assess(
    asked: Study, built: Built, readings: Readings | None, check: Callable[[], None] = lambda: None, settings: Settings = SETTINGS
) -> Assessment:
    """Weigh a built model.

    Args:
        asked: the model that was asked about; the built one starts from it and what completes it.
    """
    start, final = built.start, built.final
    base_cv = held_out(start.study)
    check()
    pruned = prune(final.study, final.ids, _beside(final, forms=True), built.family)
    check()
    study = pruned.study
    rest = final.remainder
    block = study.base + _beside(final)
    ground = Ground(study.bench, block)
    repeats = repeats_of(study, ground)
    known = study.base + _columns(study, built.family, rest.bad_rows)
    bare = repeats_of(study, Ground(study.bench, known)) if rest.structures else repeats
    noise = inferred(study, ground, repeats, settings, asked.apart)
    flexible = flexible_gain(study.observation, _unexpected(study, known), settings)
    evidence = []
    if bare.p_value < settings.repeats_p:
        evidence.append("repeats")
    strongest = max((p.log_evidence for p in rest.structures), default=0.0)
    # where rows stand out, tails are heavy, and a structure may stand for some more of them
    least = settings.nats_for_structure + settings.nats_per_bad_row * len(rest.bad_rows)
    if strongest > least and _helps(study, known, block, rest, settings):
        evidence.append("held_out_structure")
    if flexible.significant:
        evidence.append("flexible_regression")
    aside = (*asked.apart, *rest.bad_rows)
    if too_many_aside(study, aside, noise.inferred_m, settings):
        evidence.append("readings_that_stand_out")
    if not evidence and rest.structures:
        bad = only_bad_rows(study, built.family)
        if rest.gained - bad.gained > settings.nats_in_one_pose:
            evidence.append("few_poses")
        elif strongest > least:  # they may be bad readings as well, and are to be looked at
            rest = bad
    if not evidence and built.closest is not None:
        if one_cause_of_bad_rows(start, final, built.closest, built.family, settings):
            evidence.append("few_poses")
    moves = wanders_too_far(study, noise, settings)
    if moves > 0.0:
        evidence.append("wandering")
    usual_m = 0.0
    if evidence == ["held_out_structure"]:
        usual_m = as_in_every_robot(study, _size(study, known, ground), noise, settings)
    evidence = [] if usual_m > 0.0 else evidence
    lean = replace(final, added=tuple(t for t in study.terms if t.effect.id in final.ids), study=study)
    one_of, names, as_usual = [], [], list[str]()
    for i in final.ids:
        rivals = built.rivals.get(i, ())
        also = _also_read(lean.term(i), pruned.parts.get(i, Parts()), study)
        if also and also not in (*final.ids, *(n for n, _ in rivals)):
            rivals = (*rivals, (also, 0.0))
        as_everywhere = usual(final, i) or usual(lean, i)
        if as_everywhere and not cause_though_usual(final, i, noise.inferred_m, beside=True):
            as_usual.append(i)
        elif rivals:
            one_of.append(tuple(n for _, n in sorted([(0.0, i), *((odds, r) for r, odds in rivals)])))
        else:
            names.append(i)
    weight = readings is not None and readings.log_evidence > settings.nats_to_name
    if not (names or one_of or weight):  # a session that shows a usual effect and nothing else is more than noise
        names = [i for i in as_usual if cause_though_usual(final, i, noise.inferred_m)]
        as_usual = [i for i in as_usual if i not in names]
    names.sort(key=lambda i: -built.evidence.get(i, 0.0))
    is_loaded = study.ready.kind == "loaded"
    curve = of_one_curve(names, pruned.parts, final.ids) if is_loaded else of_one_step(names, pruned.parts)
    mends = mends_the_other(curve, {i: ends_at(lean, i) for i in curve if i in lean.ids})
    if mends:
        names.remove(mends)
    elif curve and is_loaded:
        names = [i for i in names if i not in curve]
        one_of.append(curve)
    if names or weight:
        status = "missing_effect"
    else:
        status = "unexplained" if evidence or one_of else "adequate"
    if status == "unexplained" and not evidence:  # effects describe it, one of which it is
        told = [t for i in final.ids for t in _own_torques(final.term(i), pruned.parts.get(i, Parts()), study)]
        depends_on = tuple(dict.fromkeys((*told, *_depends_on(built, start, flexible, sought=True))))
        depends_on = depends_on[: settings.most_depended_on]
    else:
        depends_on = _depends_on(built, final, flexible, sought=_in_few(evidence)) if evidence else ()
    if moves > 0.0 and "stamp" not in depends_on:
        depends_on = (*depends_on, "stamp")
    remaining = max(_size(study, known, ground) if evidence and rest.structures else 0.0, moves)
    if "repeats" in evidence:  # they know what is missing, whether or not a structure describes it
        remaining = max(remaining, _beside_repeats(study, bare))
    if _in_few(evidence):
        remaining = max(remaining, float(np.sqrt(max(rms(_residual(study, study.base)) ** 2 - noise.inferred_m**2, 0.0))))
    if evidence and remaining == 0.0:
        remaining = flexible.gain_m
    other = None if pruned.other and pruned.other[1][0].split(":")[0] in as_usual else pruned.other
    chi2 = [s.bench.posterior(s.base).chi2 for s in (start.study, study)]
    won = max(chi2[0] - chi2[1], 0.0)
    explained = float(won / max(won + chi2[1] - ground.chi2, 1e-9)) if final.added else float(weight)
    return Assessment(
        built, status, tuple(names), tuple(one_of), study, rest, depends_on, tuple(evidence),
        float(remaining), _hidden(noise, len(study.bench.b), settings), explained, noise, bare, flexible, readings, base_cv,
        built.reason, asked, pruned.parts, other, tuple(as_usual), usual_m,
    )  # fmt: skip


def _in_few(evidence: Collection[str]) -> bool:
    """Whether what is left is seen in few readings or poses, which may count for nothing beside the model."""
    return "readings_that_stand_out" in evidence or "few_poses" in evidence


def wanders_too_far(study: Study, noise: InferredNoise, settings: Settings) -> float:
    """RMS of what wanders in time in a loaded session where that is far beyond what is stated of the noise, m; else 0.

    There what wanders is measured within a pose, against its reference: no instrument that is as good as stated does that, nor
    does a robot that stands still. In an absolute session a robot comes back to a pose less well than a tracker measures.
    """
    moves = float(noise.inferred_m * np.sqrt(noise.wander_share))
    return moves if study.ready.kind == "loaded" and moves > settings.most_wandering * noise.claimed_m else 0.0


def only_bad_rows(study: Study, family: Family) -> Remainder:
    """A remainder of readings that stand out, and of nothing else."""
    return grow(study.bench, family, study.base, without=lambda s: not s.is_bad_row)


def _also_read(term: Term, parts: Parts, study: Study) -> str:
    """Another name for what is proven of an effect on the force sensor's reading, or of joint angles, or an empty string."""
    if term.effect.family not in (Alike.SENSOR, Alike.ANGLE_ERROR) or not parts.proven:
        return ""
    groups = {p.name: p.group for p in term.effect.parameters(study.ready)}
    proven = {n: e for n, e in term.estimates.items() if groups[n] in parts.proven}
    return also_called(replace(term, estimates=proven), study.ready)


def _beside(one: Explanation, forms: bool = False) -> Block:
    """Columns of a remainder alone.

    Args:
        forms: without those of which an added effect is a special form: they would take the place of its parts.
    """
    own = one.remainder.block
    columns = list(range(own.A.shape[1]))[one.remainder.own]
    if forms:
        lag = any("order" in t.effect.needs for t in one.added)
        history, lag = lag and one.study.ready.kind == "loaded", lag and one.study.ready.kind == "absolute"
        law = any(t.effect.family is Alike.TORQUE_LAW for t in one.added)
        kept: list[int] = []
        for part, here in one.remainder.columns:
            form = (lag and part.structure.by_step) or (law and part.structure.law_of is not None)
            form = form or (history and part.structure.history_of is not None)
            kept += [] if form else range(here.start, here.stop)
        columns = kept
    return own.take(columns)


def _residual(study: Study, block: Block) -> np.ndarray:
    ground = Ground(study.bench, block)
    return study.observation.whiten.undo(ground.residual.reshape(-1, 3))


def _unexpected(study: Study, block: Block) -> np.ndarray:
    """Residual of each row, m; in an absolute session whose noise wanders, less what the rows before let expect of it.

    There poses that were measured in succession have like noise, and where they are like each other a regression finds it.
    """
    whiten = study.observation.whiten
    if whiten.wander is None or study.ready.kind == "loaded":
        return _residual(study, block)
    return np.asarray(Ground(study.bench, block).residual.reshape(-1, 3) * whiten.sigma[:, None])


def _columns(study: Study, family: Family, parts: tuple[Part, ...]) -> Block:
    """Columns of some parts of a remainder."""
    block = study.base.take([])
    for p in parts:
        block = block + family.block(p.structure, p.amplitude)
    return block


def _helps(study: Study, known: Block, block: Block, rest: Remainder, settings: Settings) -> bool:
    """Whether a remainder lowers the error on held-out poses, those with bad rows apart."""
    before, after = (only_good_poses(held_out(study, _after(study, b)), study, rest) for b in (known, block))
    mean, se, _ = gain(before, after)
    return bool(np.isfinite(mean) and mean > settings.held_out_sigmas * se)


def _after(study: Study, block: Block) -> Block:
    return block.take(list(range(study.base.A.shape[1], block.A.shape[1])))


def _size(study: Study, known: Block, ground: Ground) -> float:
    """RMS over samples of what a remainder moves, m."""
    with_it = study.observation.whiten.undo(ground.residual.reshape(-1, 3))
    alone = _residual(study, known)
    return rms(alone - with_it)


def as_in_every_robot(study: Study, left: float, noise: InferredNoise, settings: Settings) -> float:
    """The size of structure, m, where it is no larger than what gears of every robot leave; else 0."""
    if study.ready.kind != "loaded":
        return 0.0
    observation = study.observation
    on_tool = observation.session.on_tool[observation.rows]  # what is left is of all markers, those on the base hardly move
    moved = rms(observation.of(total_displacement(study.terms, observation.scene))[on_tool]) if on_tool.any() else 0.0
    return left if left <= min(settings.usual_structure * moved, settings.usual_beside_noise * noise.inferred_m) else 0.0


def _beside_repeats(study: Study, repeats: Repeats) -> float:
    """RMS over samples of what a model leaves beyond the scatter of repeats, m."""
    level = repeats.chi2 / max(repeats.dof, 1)
    more = max(repeats.beside - repeats.beside_dof * level, 0.0) / max(len(study.bench.b), 1)
    return float(np.sqrt(more)) * study.observation.whiten.floor


def _hidden(noise: InferredNoise, equations: int, settings: Settings) -> float:
    """How large a cause without structure may be and stay unseen, m: what the claim leaves room for where nothing was repeated,
    else a structure of one parameter just below the evidence that shows it."""
    seen = noise.inferred_m * np.sqrt(2.0 * (settings.nats_for_structure + 6.0) / max(equations, 1))
    if "repeats" in noise.source:
        return float(seen)
    return float(max(seen, np.sqrt(max(noise.inferred_m**2 - (0.5 * noise.claimed_m) ** 2, 0.0))))


def _depends_on(built: Built, one: Explanation, flexible: Flexible, *, sought: bool) -> tuple[str, ...]:
    """Variables of what a model leaves, strongest first.

    Args:
        sought: those of the likeliest structures are told even where its remainder has none.
    """
    out: list[str] = []

    def add(names: tuple[str, ...]) -> None:
        out.extend(n for n in names if n not in out)

    parts = sorted(one.remainder.structures, key=lambda p: -p.log_evidence)
    if parts or sought:
        gains, _ = built.family.gains(Ground(one.study.bench, one.study.base))
        odds = gains - np.log([s.tried for s in built.family.structures])
        odds[[s.is_bad_row for s in built.family.structures]] = -np.inf
        ranked = [built.family.structures[i] for i in np.argsort(-odds)]
        for structure in ranked[: min(int((odds > odds.max() - SETTINGS.nats_to_depend).sum()), 3)]:
            add(structure.variables)
        if sought and not out:  # what is the same everywhere is seen by what else describes it
            add(next((s.variables for s in ranked if s.variables), ()))
    for p in parts:
        add(p.structure.variables)
    if not parts:
        add(flexible.variables)
    elif not out and one.study.ready.kind == "loaded":
        add(("load_case",))  # what is the same in all loaded rows is not there at the reference
    return tuple(out[: SETTINGS.most_depended_on])


def _own_torques(term: Term, parts: Parts, study: Study) -> list[str]:
    """Torques that a law of the gears goes with: of the axes in which the session proves it, whichever law it is."""
    if term.effect.family is not Alike.TORQUE_LAW:
        return []
    axes = {p.group: p.axis for p in term.effect.parameters(study.ready) if p.axis is not None}
    return [f"tau_{axes[group] + 1}" for group in parts.proven if group in axes]


def p_value(log_evidence: float) -> float:
    """Probability that noise alone gives any of the effects tried this evidence.

    For one effect exp(-log_evidence) is an upper bound (Markov); that it holds for the best of all that are tried, whose own
    evidence is below one on average, is measured: `tools/hidden/calibration.py`.
    """
    return float(np.exp(-max(log_evidence, 0.0)))


def bad_luck(built: Built, trial: Trial) -> float:
    """Evidence of the likeliest bad reading, which an effect that shows in one pose only has to beat; 0 for all others, nats."""
    scene = built.start.study.ready
    if trial.effect.evidence is not Evidence.ONE_POSE or scene.kind != "loaded" or trial.effect.id in built.final.ids:
        return 0.0
    gains, _ = built.family.gains(Ground(built.start.study.bench, built.start.study.base))
    bad = [float(g - np.log(s.tried)) for g, s in zip(gains, built.family.structures, strict=True) if s.is_bad_row]
    return max([0.0, *bad])
