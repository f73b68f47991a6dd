# SPDX-License-Identifier: Apache-2.0
"""When an effect is named: by its evidence, beside structure, readings that stand out and held-out poses."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from irec_calibration.diagnose import naming
from irec_calibration.diagnose.forms import NO_FORMS, Forms
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.effects import find_effect


def asked(monkeypatch: pytest.MonkeyPatch, odds: float, rows: int, beyond: str = "b_2 = 1 rad", one_pose: bool = False) -> bool:
    monkeypatch.setattr(naming, "odds_of", lambda *_: odds)
    monkeypatch.setattr(naming, "implausible", lambda *_: beyond)
    monkeypatch.setattr(naming, "in_one_pose", lambda *_: one_pose)
    monkeypatch.setattr(naming, "needed", lambda *_: SETTINGS.nats_to_name)
    bare: Any = SimpleNamespace(remainder=SimpleNamespace(bad_rows=(None,) * rows))
    one: Any = SimpleNamespace(ids=("joint_backlash",))
    family: Any = None
    return naming.one_cause_of_bad_rows(bare, bare, one, family, SETTINGS)


def test_each_reading_that_stands_out_asks_for_more_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked(monkeypatch, odds=9.6, rows=3)
    assert not asked(monkeypatch, odds=9.4, rows=3)


def test_without_such_readings_or_within_what_can_be_there_is_nothing_to_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not asked(monkeypatch, odds=99.0, rows=0)
    assert not asked(monkeypatch, odds=99.0, rows=3, beyond="")


def test_a_step_in_one_pose_is_a_bad_reading_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not asked(monkeypatch, odds=99.0, rows=3, one_pose=True)


class Columns:
    """So many columns of a linear problem."""

    def __init__(self, count: int) -> None:
        self.A = np.zeros((1, count))

    def take(self, chosen: list[int]) -> list[int]:
        return chosen


def answer(monkeypatch: pytest.MonkeyPatch, odds: float, better_by: float, beside: float | None = None) -> str:
    """What a name is refused for whose evidence is `odds`, that lowers the held-out error by so many standard errors; and by so
    many beside what has no name, the same where none are given."""
    monkeypatch.setattr(naming, "odds_of", lambda *_: odds)
    monkeypatch.setattr(naming, "needed", lambda *_: SETTINGS.nats_to_name)
    monkeypatch.setattr(naming, "implausible", lambda *_: "")
    monkeypatch.setattr(naming, "in_one_pose", lambda *_: False)
    found = {0: better_by, 2: better_by if beside is None else beside}  # by the columns that are held out beside the model
    monkeypatch.setattr(naming, "held_out", lambda _, columns: len(columns))
    monkeypatch.setattr(naming, "only_good_poses", lambda columns, *_: columns)
    monkeypatch.setattr(naming, "gain", lambda columns, _: (found[columns], 1.0, 0))
    study = SimpleNamespace(bench=SimpleNamespace(poses=range(SETTINGS.fewest_poses)), base=Columns(3))
    remainder = SimpleNamespace(structures=(), block=Columns(5))
    bare: Any = SimpleNamespace(study=study, remainder=remainder)
    one: Any = SimpleNamespace(ids=("joint_backlash",), study=study, remainder=remainder)
    family: Any = None
    return naming.refused(bare, bare, one, family, SETTINGS)[0]


def test_evidence_makes_up_for_held_out_poses_that_show_little(monkeypatch: pytest.MonkeyPatch) -> None:
    enough, clearly = SETTINGS.nats_to_name, SETTINGS.held_out_sigmas
    assert answer(monkeypatch, 1.01 * enough, clearly) == ""
    assert answer(monkeypatch, 1.49 * enough, clearly / 2) == "it does not help on held-out poses"
    assert answer(monkeypatch, 1.51 * enough, clearly / 2) == ""


def test_poses_that_what_has_no_name_predicts_badly_are_asked_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    enough, clearly = SETTINGS.nats_to_name, SETTINGS.held_out_sigmas
    assert answer(monkeypatch, 2.01 * enough, -1.0, beside=clearly) == ""
    assert answer(monkeypatch, 1.99 * enough, -1.0, beside=clearly) == "it does not help on held-out poses"
    assert answer(monkeypatch, 1e6, -1.0, beside=0.0) == "it does not help on held-out poses"


@pytest.mark.parametrize("better_by", [0.0, -1.0, float("nan")])
def test_no_evidence_makes_up_for_held_out_poses_that_get_no_better(monkeypatch: pytest.MonkeyPatch, better_by: float) -> None:
    assert answer(monkeypatch, 1e6, better_by) == "it does not help on held-out poses"


def odds_beside(
    monkeypatch: pytest.MonkeyPatch, one: Any, bare: Any, forms: Forms, remainder_of: Callable[..., object],
    effect_id: str = "joint_backlash",
) -> float:  # fmt: skip
    """Odds of a name of these forms, where `remainder_of` tells what structures without a name explain."""
    monkeypatch.setattr(naming, "own_forms", lambda *_: forms)
    monkeypatch.setattr(naming, "bends", lambda *_: forms.axes)
    monkeypatch.setattr(naming, "remainder_of", remainder_of)
    monkeypatch.setattr(naming, "of_axes", lambda *_: False)
    monkeypatch.setattr(naming, "with_others_by_step", lambda *_: -float("inf"))
    monkeypatch.setattr(naming, "in_one_pose", lambda *_: False)
    monkeypatch.setattr(naming, "less_what_is_lent", lambda odds, *_: odds)
    family: Any = None
    return naming.odds_of(bare, one, bare, effect_id, family, SETTINGS)


def held(monkeypatch: pytest.MonkeyPatch, own: float, in_place: float, left: float = 0.0, rows: int = 0) -> float:
    """What is held against `needed` for a name of own evidence, where structures in its place and left beside it have some."""
    term = SimpleNamespace(effect=SimpleNamespace(family=None, in_readings=False))
    one: Any = SimpleNamespace(
        named=own, ids=("joint_backlash",), study=SimpleNamespace(ready=None), term=lambda _: term,
        remainder=SimpleNamespace(gained=left, parts=(), bad_rows=(None,) * rows),
    )  # fmt: skip
    bare: Any = SimpleNamespace(named=0.0, study=None, remainder=SimpleNamespace(gained=in_place))
    odds = odds_beside(monkeypatch, one, bare, NO_FORMS, lambda *_: SimpleNamespace(gained=in_place))
    return odds - naming.needed(one, "joint_backlash", SETTINGS)


@pytest.mark.parametrize(
    ("kind", "own", "left", "more", "named"),
    [
        ("loaded", 40.0, 20.0, 0.0, True),
        ("loaded", 20.0, 40.0, 0.0, False),
        ("absolute", 40.0, 20.0, 0.0, False),  # there a general course in the base frame is such a form
        ("absolute", 40.0, 20.0, 2.5, True),
    ],
)
def test_a_drift_most_of_which_has_another_form_is_no_thermal_drift(
    monkeypatch: pytest.MonkeyPatch, kind: str, own: float, left: float, more: float, named: bool
) -> None:
    """Name and structures explain more than structures alone by so much."""
    drift = SimpleNamespace(log_evidence=left, structure=SimpleNamespace(is_drift=True))
    rest = SimpleNamespace(gained=left, parts=(drift,), structures=(drift,), bad_rows=())
    term = SimpleNamespace(effect=SimpleNamespace(family=None, in_readings=False))
    study = SimpleNamespace(ready=SimpleNamespace(kind=kind))
    one: Any = SimpleNamespace(named=own, study=study, term=lambda _: term, remainder=rest)
    bare: Any = SimpleNamespace(named=0.0, study=None, remainder=SimpleNamespace(gained=own + left - more))

    def remainder_of(study: object, family: object, parts: object, forms: Forms = NO_FORMS) -> SimpleNamespace:
        return SimpleNamespace(gained=0.0 if forms.drifts else own + left - more)

    odds = odds_beside(monkeypatch, one, bare, Forms(drifts=True), remainder_of, "thermal_drift")
    assert (odds > naming.needed(one, "thermal_drift", SETTINGS)) == named


@pytest.mark.parametrize("rows", [0, 5])
def test_structure_in_its_place_has_to_be_told_apart_from_a_name_that_is_there_for_certain(
    monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    over = SETTINGS.nats_over_structure / (1.0 - SETTINGS.share_of_form)
    assert held(monkeypatch, own=50.0, in_place=50.0 - 1.1 * over - 50.0 * SETTINGS.share_of_form, rows=rows) > 0.0
    assert held(monkeypatch, own=50.0, in_place=50.0 - 0.9 * SETTINGS.nats_over_structure, rows=rows) < 0.0


@pytest.mark.parametrize("rows", [0, 5])
def test_a_name_that_is_hardly_there_needs_all_its_evidence_without_any_structure(
    monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    least = SETTINGS.nats_to_name + rows * SETTINGS.nats_per_bad_row
    assert (
        held(monkeypatch, own=least - 0.1, in_place=0.0, rows=rows)
        < 0.0
        < held(monkeypatch, own=least + 0.1, in_place=0.0, rows=rows)
    )


@pytest.mark.parametrize(("axes", "tilt", "named"), [({2}, 112.0, True), ({0, 2, 3}, 112.0, False), ({2}, 123.0, False)])
def test_a_bearing_gives_way_instead_of_a_gear_where_it_explains_more_and_instead_of_several_where_it_explains_as_much(
    monkeypatch: pytest.MonkeyPatch, axes: set[int], tilt: float, named: bool
) -> None:
    """A link that tilts explains the session almost as well as a law of torque, or better; nothing else explains half of it."""
    rest = SimpleNamespace(gained=0.0, parts=(), structures=(), bad_rows=())
    term = SimpleNamespace(effect=SimpleNamespace(family=naming.Alike.TORQUE_LAW, in_readings=False))
    one: Any = SimpleNamespace(named=118.0, study=SimpleNamespace(ready=None), term=lambda _: term, remainder=rest)
    bare: Any = SimpleNamespace(named=0.0, study=None, remainder=rest)

    def remainder_of(study: object, family: object, parts: object, forms: Forms = NO_FORMS) -> SimpleNamespace:
        in_place = study is bare.study
        return SimpleNamespace(gained=0.0 if not in_place else 50.0 if forms.tilts else tilt)

    odds = odds_beside(monkeypatch, one, bare, Forms(axes=frozenset(axes)), remainder_of, "joint_stiffening")
    assert (odds > naming.needed(one, "joint_stiffening", SETTINGS)) == named


def lent(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, beside: str, kind: str = "absolute", odds: float = 100.0, left: float = 0.0
) -> float:
    """Of the evidence of an effect what it has from another, which explains 180 nats.

    Args:
        left: evidence of the effect where that may deviate from its form.
    """
    forms = {"thermal_drift": Forms(drifts=True), "encoder_harmonics": Forms(angles=frozenset({0}))}
    monkeypatch.setattr(naming, "forms_of", lambda term, _: forms.get(term.effect.id, Forms()))
    monkeypatch.setattr(naming, "without", lambda *_: SimpleNamespace(named=20.0))
    monkeypatch.setattr(naming, "evidence_beside", lambda *_: left)

    def term(i: str) -> SimpleNamespace:
        return SimpleNamespace(effect=find_effect(i))

    one: Any = SimpleNamespace(study=SimpleNamespace(ready=SimpleNamespace(kind=kind)), term=term)
    bare: Any = SimpleNamespace(named=200.0, added=(term(beside),), term=term)
    return odds - naming.less_what_is_lent(odds, bare, one, bare, effect_id, cast(Any, None), SETTINGS)


@pytest.mark.parametrize(("effect_id", "expected"), [("station_shift", 9.0), ("joint_backlash", 0.0), ("thermal_drift", 0.0)])
def test_a_step_in_time_has_some_of_its_evidence_from_the_form_of_a_drift_beside_it(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, expected: float
) -> None:
    assert lent(monkeypatch, effect_id, "thermal_drift") == pytest.approx(expected)


@pytest.mark.parametrize(("beside", "expected"), [("external_force", 9.0), ("joint_torsion", 0.0)])
def test_harmonics_of_an_encoder_have_some_of_their_evidence_from_the_form_of_a_hose_beside_them(
    monkeypatch: pytest.MonkeyPatch, beside: str, expected: float
) -> None:
    assert lent(monkeypatch, "encoder_harmonics", beside) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("effect_id", "beside", "expected"),
    [("creep", "joint_hysteresis", 18.0), ("external_force", "joint_hysteresis", 18.0), ("creep", "joint_backlash", 0.0),
     ("sensor_gain", "joint_hysteresis", 0.0)],
)  # fmt: skip
def test_what_creeps_and_what_a_hose_pulls_have_some_of_their_evidence_from_the_form_of_friction_beside_them(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, beside: str, expected: float
) -> None:
    assert lent(monkeypatch, effect_id, beside, "loaded") == pytest.approx(expected)


@pytest.mark.parametrize(
    ("effect_id", "odds", "left", "expected"),
    [("creep", 20.0, 24.0, 8.0), ("creep", 20.0, 60.0, 0.0), ("creep", 20.0, 3.0, 18.0), ("creep", 5.0, 60.0, 18.0)],
    ids=["half of it counts", "no more than it has", "friction of another form does that too", "too little without friction"],
)
def test_what_creeps_beside_friction_keeps_half_of_what_is_left_where_friction_may_deviate_from_its_form(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, odds: float, left: float, expected: float
) -> None:
    """Beside friction of 700 nats a hose of 52 had to have 73."""
    assert lent(monkeypatch, effect_id, "joint_hysteresis", "loaded", odds, left) == pytest.approx(expected)


def beside_a_curve(
    monkeypatch: pytest.MonkeyPatch, forms: Forms, curve: float, own: float, trace: float, others: tuple[float, float]
) -> bool:
    """Whether an effect is named that stands for a curve of an axis, of which a trace is left beside it, with other structures in
    its place and beside it; all in nats."""

    def of_the_curve(evidence: float) -> SimpleNamespace:
        by_step = bool(forms.steps)
        s = SimpleNamespace(
            law_of=None, softer_by_angle=None, by_step=by_step, axis=0, ripple=None, variables=("joint_1",), is_drift=False,
            is_tilt=False, history_of=None,
        )  # fmt: skip
        return SimpleNamespace(log_evidence=evidence, structure=s)

    def remainder_of(study: Any, family: object, parts: object, exact: Forms = NO_FORMS) -> SimpleNamespace:
        left = study is not None
        return SimpleNamespace(gained=others[left] + (0.0 if exact.steps or exact.angles else (trace if left else curve)))

    kept = (of_the_curve(trace),) if trace else ()
    rest = SimpleNamespace(gained=others[1] + trace, parts=kept, structures=kept, bad_rows=())
    term = SimpleNamespace(effect=SimpleNamespace(family=None, in_readings=False))
    one: Any = SimpleNamespace(
        named=own, study=SimpleNamespace(ready=None), term=lambda _: term, remainder=rest, ids=("joint_hysteresis",)
    )
    before = SimpleNamespace(gained=others[0] + curve, structures=(of_the_curve(curve),))
    bare: Any = SimpleNamespace(named=0.0, study=None, remainder=before)
    odds = odds_beside(monkeypatch, one, bare, forms, remainder_of, "joint_hysteresis")
    return odds > naming.needed(one, "joint_hysteresis", SETTINGS)


@pytest.mark.parametrize(("trace", "named"), [(0.0, True), (4.0, True), (8.0, False)])
def test_friction_stands_for_a_curve_of_the_step_of_which_nothing_that_counts_is_left(monkeypatch, trace, named) -> None:
    assert beside_a_curve(monkeypatch, Forms(steps=frozenset({0})), 950.0, 960.0, trace, (0.0, 0.0)) == named


@pytest.mark.parametrize(("own", "left", "named"), [(70.0, 44.0, True), (42.0, 72.0, False)])
def test_harmonics_explain_as_much_as_the_curve_of_the_angle_that_they_stand_for(monkeypatch, own, left, named) -> None:
    """Together with what is left beside them both explain the same."""
    assert beside_a_curve(monkeypatch, Forms(angles=frozenset({0})), 66.0, own, 0.0, (42.0, left)) == named
