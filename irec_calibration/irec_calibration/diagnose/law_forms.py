# SPDX-License-Identifier: Apache-2.0
"""Every short law in proportion to the process force that may stand in for what has no name, and the likeliest of them.

A law is in proportion where half the force gives half of it, whatever the angles: what a calibration with one size of force tells
then says something about others. Written are all that turn an axis, tilt a link or move tool or base by a curve of one torque or
force, by two of them, or by one that goes with the angle of a joint.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby, product
from math import log

import numpy as np

from ..effects.formula import FormulaEffect, size_of_load
from ..effects.scene import Scene
from ..typing import Array, BoolArray
from .columns import block_columns
from .directions import TAKEN_UP, TYPICAL_DISPLACEMENT
from .evidence import Block
from .family import Family, Structure
from .ground import Ground
from .settings import SETTINGS, Settings
from .study import Study

XYZ, ACROSS = "xyz", "ab"
NARROW = 2.0  # rad, over which sine and cosine of a turn and of half a turn are hardly told apart, and go wild beyond
THERE = 1e-3  # share of the largest force or torque of its kind below which one is not there
NAMES = "abcdeghklm"  # of parameters
AT_ONCE = 250_000  # rows times laws whose columns are held in memory together


@dataclass(frozen=True)
class Load:
    """A force or torque as formulas write it, and its values, (n,)."""

    name: str
    values: Array


@dataclass(frozen=True)
class Target:
    """What laws move.

    Attributes:
        name: as formulas write it; along: displacement of the observed point by one unit of it, (n, 3), m.
        loads: that may drive it; alone: names of those that a spring of it answers to by itself, as they are.
        gravity: torque of gravity about it, (n,), N m; None: it is no axis.
    """

    name: str
    along: Array
    loads: tuple[Load, ...]
    alone: frozenset[str]
    gravity: Array | None = None


Words = tuple[str, str]  # a load, or what is in its place, and what it is multiplied by; empty: nothing
Wave = tuple[str, Array]  # a function of a joint angle as formulas write it, and its values, (n,)


@dataclass(frozen=True)
class Form:
    """One law: its terms without their parameters, and the values of each, (n,)."""

    terms: tuple[Words, ...]
    values: tuple[Array, ...]

    @property
    def angles(self) -> int:
        """How many functions of joint angles it has, of which each pose says one value."""
        return len({angle for _, angle in self.terms} - {""})

    def text(self, target: str) -> str:
        """As formulas write it, terms of one load together."""
        names = iter(NAMES)
        said = []
        for load, terms in groupby(self.terms, key=lambda term: term[0]):
            inner = [f"{next(names)} * {angle}" if angle else next(names) for _, angle in terms]
            said.append(f"{inner[0]} * {load}" if len(inner) == 1 else f"{load} * ({' + '.join(inner)})")
        return f"{target}: {' + '.join(said)}"


def targets(scene: Scene) -> Iterator[Target]:
    """All that laws may move on the robot of a scene."""
    tau = _there("tau_{}", range(1, scene.n_joints + 1), scene.tau)
    in_tool, in_base = _there("f_{}", XYZ, scene.force_in_tool), _there("b_{}", XYZ, scene.force)
    for k in np.flatnonzero(scene.driven):
        own = Load("tau", scene.tau[:, k])
        others = (x for x in (*tau, *in_tool) if x.name != f"tau_{k + 1}")
        yield Target(f"axis {k + 1}", scene.J[:, :, k], (own, *others), frozenset({"tau"}), scene.tau_gravity[:, k])
    for i in range(scene.V.shape[2]):
        own = Load("tau", scene.tau_virtual[:, i])
        name, gravity = f"link {i // 2 + 1}{ACROSS[i % 2]}", scene.gravity.tau_virtual[:, i]
        yield Target(name, scene.V[:, :, i], (own, *tau, *in_tool), frozenset({"tau"}), gravity)
    for i, d in enumerate(XYZ):
        along = scene.kin.R_tool[:, :, i] * scene.moves_with_arm[:, None]
        yield Target(f"tool {d}", along, (*in_tool, *tau), frozenset(x.name for x in in_tool))
        along = np.tile(np.eye(3)[i], (len(scene), 1))
        yield Target(f"base {d}", along, (*in_base, *tau), frozenset(x.name for x in in_base))


def _there(name: str, of: Sequence[str] | range, values: Array) -> tuple[Load, ...]:
    """Those of some loads that are not next to nothing beside the others."""
    size = np.abs(values).max(axis=0, initial=0.0)
    return tuple(Load(name.format(w), v) for w, v, s in zip(of, values.T, size, strict=True) if s > THERE * size.max() > 0.0)


def forms(scene: Scene, target: Target) -> Iterator[Form]:
    """All laws of a target."""
    size = size_of_load(scene.force_in_tool, scene.torque_in_tool)
    waves = [_waves(scene, k) for k in range(scene.n_joints)]
    for load in target.loads:
        yield from _of_one_load(load, load.name in target.alone, size, waves)
    for one, other in combinations(target.loads, 2):
        yield from _of_two_loads(one, other, size)
    if target.gravity is not None:
        own = target.loads[0]
        yield from _with_gravity(scene, own.values, target.gravity, size)
        for first, second in combinations([of_joint[0] for of_joint in waves], 2):
            yield _form([((own.name, words), own.values * values) for words, values in _of_two_angles(first, second)])


def _of_one_load(load: Load, alone: bool, size: Array, waves: Sequence[Sequence[Sequence[Wave]]]) -> Iterator[Form]:
    """A curve of a load, or what goes with it, either way of its sign, and with the place of a joint.

    Args:
        alone: a spring of the target answers to the load as it is, so no law has that; size: of the process force, (n,), N.
        waves: of each joint.
    """
    x, v, a = load.name, load.values, np.abs(load.values)
    line = [] if alone else [((x, ""), v)]
    even = [((f"abs({x})", ""), a)]
    square = [((f"{x} * {x} / load", ""), v * v / size), ((f"{x} * abs({x}) / load", ""), v * a / size)]
    cube = [((f"{x} * {x} * {x} / load / load", ""), v**3 / size**2)]
    if line:
        yield _form(line)
    yield _form(even)
    yield _form(line + square)
    yield _form(line + even + square + cube)
    for of_joint in waves:
        odd = [[((x, words), v * wave) for words, wave in one] for one in of_joint]
        of_size = [[((f"abs({x})", words), a * wave) for words, wave in one] for one in of_joint]
        for one, other in zip(odd, of_size, strict=True):
            yield _form(line + one)
            yield _form(even + other)
        for n in range(1, len(of_joint) + 1):
            yield _form(line + sum(odd[:n], []) + even + sum(of_size[:n], []))


def _of_two_loads(one: Load, other: Load, size: Array) -> Iterator[Form]:
    """The product of two loads, either way of their signs."""
    x, y, v, w = one.name, other.name, one.values, other.values
    product_of_both = ((f"{x} * {y} / load", ""), v * w / size)
    yield _form([product_of_both])
    yield _form([
        product_of_both, ((f"abs({x}) * {y} / load", ""), np.abs(v) * w / size),
        ((f"{x} * abs({y}) / load", ""), v * np.abs(w) / size), ((f"abs({x} * {y}) / load", ""), np.abs(v * w) / size),
    ])  # fmt: skip


def _form(parts: Sequence[tuple[Words, Array]]) -> Form:
    return Form(tuple(term for term, _ in parts), tuple(values for _, values in parts))


def _waves(scene: Scene, joint: int) -> list[list[Wave]]:
    """How a law may go with the place of a joint, counted from 0: sets of terms that belong together."""
    q = scene.q[:, joint]
    low, high = float(np.floor(100.0 * q.min()) / 100.0), float(np.ceil(100.0 * q.max()) / 100.0)
    name, q = f"clip(q_{joint + 1}, {low:g}, {high:g})", np.clip(q, low, high)  # beyond no pose says anything
    if scene.kin.is_prismatic[joint] or high - low < NARROW:
        middle = float(f"{0.5 * (low + high):.2f}")
        u = f"({name} {'-' if middle >= 0.0 else '+'} {abs(middle):g})"
        return [[(u, q - middle), (f"{u} * {u}", (q - middle) ** 2)]]
    once, twice = name, f"2 * {name}"
    return [[(f"cos({w})", np.cos(m * q)), (f"sin({w})", np.sin(m * q))] for m, w in ((1.0, once), (2.0, twice))]


def _of_two_angles(one: list[Wave], other: list[Wave]) -> list[Wave]:
    """How a law may go with the places of two joints together: of a joint that hardly moves in proportion to it."""
    narrow = [waves[:1] for waves in (one, other) if _is_narrow(waves)]
    first, second = (waves[:1] if _is_narrow(waves) else waves for waves in (one, other))
    both = [(f"{s} * {t}", v * w) for (s, v), (t, w) in product(first, second)]
    return [*(wave for waves in narrow for wave in waves), *both]


def _is_narrow(waves: list[Wave]) -> bool:
    return not waves[0][0].startswith("cos")


def _with_gravity(scene: Scene, tau: Array, tau_g: Array, size: Array) -> Iterator[Form]:
    """Laws of the torque of process and gravity together, as play has them: as they are at the size of force that was measured,
    and in proportion at others."""
    pressed = scene.load_case > 0
    usual = float(f"{np.sqrt(np.mean(size[pressed] ** 2)):.4g}") if pressed.any() else 0.0
    whole = usual * tau / size + tau_g
    largest = float(np.abs(whole[pressed]).max(initial=0.0))
    if largest <= 0.0 or np.abs(tau_g).max() < THERE * largest:
        return
    words = f"{usual:.4g} * tau / load + tau_g"
    yield _form([((f"load * (abs({words}) - abs(tau_g))", ""), size * (np.abs(whole) - np.abs(tau_g)))])
    for share in TAKEN_UP:
        bend = f"{share * largest:.3g}"
        values = size * (np.tanh(whole / float(bend)) - np.tanh(tau_g / float(bend)))
        yield _form([((f"load * (tanh(({words}) / {bend}) - tanh(tau_g / {bend}))", ""), values)])


def likeliest(
    study: Study, check: Callable[[], None] = lambda: None, settings: Settings = SETTINGS
) -> list[tuple[FormulaEffect, Block, float]]:
    """The laws with most evidence on top of a model, their columns, and that evidence in nats, the number tried taken off.

    A long law may be the likeliest and yet go wrong in a region of its own, so there are some of each number of terms.
    """
    ground, scene = Ground(study.bench, study.base), study.ready
    deflection = np.sqrt((scene.response.displacement[study.observation.rows] ** 2).sum(axis=1).mean())
    largest = settings.laws.most_of_deflection * float(deflection) / TYPICAL_DISPLACEMENT
    most = len(study.bench.poses) / settings.laws.poses_per_angle
    at_once = max(AT_ONCE // len(scene), 1)
    found: list[_Found] = []
    tried = 0
    for target in targets(scene):
        of_target = [form for form in forms(scene, target) if form.angles <= most]
        tried += len(of_target)
        for first in range(0, len(of_target), at_once):
            check()
            some = of_target[first : first + at_once]
            family = _family(study, target, some, largest)
            gains, amplitudes = family.gains(ground)
            gains[~_told_apart(family, ground, settings.laws.least_apart)] = -np.inf
            each = zip(gains, family.structures, amplitudes, some, strict=True)
            found += [_Found(float(g), s.words, float(a), len(f.terms)) for g, s, a, f in each if g >= settings.nats_to_name]
    out: list[tuple[FormulaEffect, Block, float]] = []
    of_size: Counter[int] = Counter()
    for one in sorted(found, key=lambda f: -f.gain):
        nats = one.gain - log(tried)
        of_size[one.terms] += 1
        if nats >= settings.nats_to_name and of_size[one.terms] <= settings.laws.of_a_length:
            law = FormulaEffect("formula", one.text)
            out.append((law, block_columns(study, law, {})[0].widened(one.amplitude), nats))
    return out


@dataclass(frozen=True)
class _Found:
    """A law as text with its log evidence, the amplitude of its prior and how many terms it has."""

    gain: float
    text: str
    amplitude: float
    terms: int


def _told_apart(family: Family, ground: Ground, least: float) -> BoolArray:
    """Which laws have terms that the session tells from each other and from the springs, (k,): else large ones cancel where it
    was measured, and under another load they do not.

    Args:
        least: share of its square that is left of any mixture of terms beside the model.
    """
    V, _ = ground.reduce(family.A)
    size = np.maximum(np.linalg.norm(family.A, axis=0), 1e-12)
    whole, beside = family.A / size, V / size
    out = np.empty(len(family.structures), dtype=bool)
    for i, structure in enumerate(family.structures):
        A, B = whole[:, structure.columns], beside[:, structure.columns]
        out[i] = np.linalg.eigvalsh(A.T @ A - B.T @ B)[0] > least
    return out


def _family(study: Study, target: Target, some: Sequence[Form], largest: float) -> Family:
    """Laws of a target as structures, each column scaled to the typical displacement; largest: see `Structure`."""
    values = np.stack([v for form in some for v in form.values], axis=1)
    columns = target.along[:, :, None] * values[:, None, :]
    size = np.sqrt((columns[study.observation.rows] ** 2).sum(axis=1).mean(axis=0))
    A = study.columns(columns * (TYPICAL_DISPLACEMENT / np.maximum(size, 1e-300)))
    ends = np.cumsum([len(form.terms) for form in some]).tolist()
    places = [slice(end - len(form.terms), end) for form, end in zip(some, ends, strict=True)]
    texts = [form.text(target.name) for form in some]
    return Family(tuple(Structure((), text, at, 1, largest=largest) for text, at in zip(texts, places, strict=True)), A)
