# SPDX-License-Identifier: Apache-2.0
"""What is tried on top of a model at one step: a hose with the springs that it loads, and what ripples could feign."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from absolute_sessions import session
from irec_calibration.diagnose import build, form_errors, shape, tries
from irec_calibration.diagnose.remainder import Remainder
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Estimate, Term


def trial(effect_id: str) -> Any:
    return SimpleNamespace(effect=find_effect(effect_id), log_evidence=-5.0)


def model(ids: tuple[str, ...], named: float) -> Any:
    return SimpleNamespace(ids=ids, named=named, log_evidence=named, study=None, remainder=SimpleNamespace(without_a_name=300.0))


@pytest.mark.parametrize(("hose_without_springs", "both"), [(True, True), (False, False)])
def test_a_hose_and_the_springs_that_it_loads_are_tried_together_although_neither_shows_alone(
    monkeypatch: pytest.MonkeyPatch, hose_without_springs: bool, both: bool
) -> None:
    """Springs lose 5 alone and the hose moves nothing; together they explain 340. What is no spring is not tried so."""
    none = model((), 0.0)
    worth = {("joint_torsion",): -5.0, ("counterbalance",): 3.0, ("joint_torsion", "external_force"): 340.0}

    def explained(start: Any, current: Any, t: Any, family: Any) -> Any:
        ids = (*current.ids, t.effect.id)
        return model(ids, worth[ids])

    hose = SimpleNamespace(effect=find_effect("external_force"))
    hose.on = lambda study: SimpleNamespace(tables=() if hose_without_springs else ("table",))
    monkeypatch.setattr(tries, "explain", explained)
    monkeypatch.setattr(tries, "tried_on", lambda current, found: [trial(o.effect.id) for o in found])
    monkeypatch.setattr(tries, "refused", lambda *_: ("", 100.0))
    monkeypatch.setattr(tries, "reshaped_again", lambda start, two, family: two)
    monkeypatch.setattr(tries, "all_stand", lambda start, one, *_: dict.fromkeys(one.ids, 100.0))
    trials = [trial("counterbalance"), trial("joint_torsion")]
    family: Any = None
    found: Any = (hose,)
    made = tries.two_together(none, none, trials, found, family, lambda: None, SETTINGS)
    assert (made is not None and made[0].ids == ("joint_torsion", "external_force")) == both


@pytest.mark.parametrize(("shown", "starts"), [(1e-12, ["as found", "typical"]), (1e-5, ["as found"])])
def test_a_hose_is_looked_for_from_typical_springs_too_where_the_weight_shows_nearly_none(
    monkeypatch: pytest.MonkeyPatch, shown: float, starts: list[str]
) -> None:
    scene = scene_of(session(poses=3))
    torsion, hose = find_effect("joint_torsion"), find_effect("external_force")
    soft = {p.name: p.scale for p in torsion.parameters(scene)}
    springs = Term(torsion, {n: Estimate(shown) for n in soft})
    tried: list[str] = []

    def fitted(observation: Any, terms: Any) -> Any:
        values = {n: e.value for n, e in terms[0].estimates.items()}
        is_typical = all(values[n] == pytest.approx(soft[n]) for n in soft)
        tried.append("typical" if is_typical else "as found")
        assert not is_typical or terms[1].estimates["f_x"].value == 0.0  # a small force read off stiff springs says nothing
        return SimpleNamespace(name=tried[-1], base=None, bench=SimpleNamespace(posterior=lambda _: evidence(is_typical)))

    def evidence(is_typical: bool) -> Any:
        return SimpleNamespace(log_evidence=340.0 if is_typical else -37.0)

    monkeypatch.setattr(shape, "study_of", fitted)
    monkeypatch.setattr(shape, "_refined", lambda *_: {})
    variant = SimpleNamespace(effect=hose, names=("f_x",), scale=np.ones(1))
    one: Any = SimpleNamespace(ready=scene, terms=(springs,), observation=None)
    found = shape.refit(one, SimpleNamespace(best=variant, posterior=SimpleNamespace(x=np.array([0.3]))))  # type: ignore[arg-type]
    assert tried == starts
    assert found is not None and found.name == starts[-1]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("effect_id", "ripple", "size", "feigned"),
    [
        ("thermal_drift", None, 1.0, 0.05),
        ("thermal_drift", (2, 40.0), 1.0, 0.0),
        ("joint_backlash", (2, 40.0), 1.0, 0.05),
        ("joint_backlash", None, 80.0, 0.0125),  # explains 3200, sixteen times what has no name
    ],
)
def test_what_remains_feigns_nothing_that_it_is_not_like_and_little_of_what_is_far_larger(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, ripple: tuple[int, float] | None, size: float, feigned: float
) -> None:
    structure = SimpleNamespace(columns=slice(0, 1), is_bad_row=False, ripple=ripple)
    part: Any = SimpleNamespace(structure=structure, log_evidence=200.0)
    block: Any = SimpleNamespace(A=np.diag([size, 1.0]))
    base = SimpleNamespace(A=np.array([[size], [0.0]]), take=lambda columns: None)
    study = SimpleNamespace(
        bench=SimpleNamespace(posterior=lambda block: SimpleNamespace(x=np.ones(2))), owners=(effect_id,), base=base, ready=None
    )
    remainder = Remainder((part,), log_evidence=200.0, block=block, own=slice(1, 2))
    one: Any = SimpleNamespace(
        ids=(effect_id,), study=study, remainder=remainder, term=lambda i: SimpleNamespace(effect=find_effect(i))
    )
    monkeypatch.setattr(form_errors, "Ground", lambda *_: SimpleNamespace(beside=lambda v: v))
    monkeypatch.setattr(form_errors, "forms_of", lambda *_: SimpleNamespace(has=lambda structure: False))
    assert form_errors.feigned(one, SETTINGS) == {effect_id: pytest.approx(feigned * 200.0)}


def test_a_shape_value_whose_grid_holds_kinds_is_not_moved_between_them() -> None:
    shapes = {p.name: p for p in find_effect("joint_stiffening").parameters(scene_of(session(poses=3))) if p.grid}
    assert shape._is_continuous(shapes["x_0"]) and not shape._is_continuous(shapes["slow"])


@pytest.mark.parametrize(
    ("other", "refused", "taken"),
    [
        ((148.0, 140.0), "", "joint_hysteresis"),  # not told apart, and explains nearly all by itself
        ((144.0, 140.0), "", "base_compliance"),  # told apart
        ((148.0, 5.0), "", "base_compliance"),
        ((148.0, 140.0), "its values can't be", "base_compliance"),
    ],
)
def test_of_effects_that_are_not_told_apart_the_one_that_explains_most_by_itself_comes_first(
    monkeypatch: pytest.MonkeyPatch, other: tuple[float, float], refused: str, taken: str
) -> None:
    none = model((), 0.0)
    floor, gear = model(("base_compliance",), 7.0), model(("joint_hysteresis",), other[1])
    floor.log_evidence, gear.log_evidence = 150.0, other[0]
    monkeypatch.setattr(build, "refused", lambda start, current, one, *_: (refused if one is gear else "", 10.0))
    family: Any = None
    way = build._Way(none, family, (), (), lambda: None, lambda *_: None, SETTINGS, [none], tried=(floor, gear))
    found = way._likeliest(none)
    assert found is not None and found[0].ids == (taken,)
