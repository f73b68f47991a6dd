# SPDX-License-Identifier: Apache-2.0
"""Which names of a model stand beside each other, and beside what stays without a name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from irec_calibration.diagnose import build, standing
from irec_calibration.diagnose.forms import NO_FORMS, Forms
from irec_calibration.diagnose.rivals import Rivals
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.effects import Parameter, find_effect


@pytest.fixture
def needs_six_and_a_half(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each name, beside what others could feign."""
    monkeypatch.setattr(standing, "feigned", lambda *_: {})
    monkeypatch.setattr(standing, "_least", lambda *_: 6.5)


@pytest.mark.usefixtures("needs_six_and_a_half")
@pytest.mark.parametrize(
    ("kind", "own", "left", "evidence", "outweighed"),
    [
        ("loaded", 30.0, 40.0, 10.0, True),
        ("loaded", 50.0, 40.0, 10.0, False),
        ("loaded", 7.0, 0.0, 7.0, False),
        ("absolute", 30.0, 40.0, 10.0, False),
        ("loaded", 30.0, 40.0, 3.1 * 6.5, False),  # told apart from every structure by several times what it needs
    ],
)
def test_a_name_explains_no_less_than_what_stays_without_one_in_a_loaded_session(
    monkeypatch: pytest.MonkeyPatch, kind: str, own: float, left: float, evidence: float, outweighed: bool
) -> None:
    monkeypatch.setattr(standing, "in_one_pose", lambda *_: False)
    monkeypatch.setattr(standing, "shown_by_readings", lambda *_: 0.0)
    rest = SimpleNamespace(structures=(SimpleNamespace(log_evidence=0.75 * left), SimpleNamespace(log_evidence=0.25 * left)))
    study = SimpleNamespace(ready=SimpleNamespace(kind=kind))
    one: Any = SimpleNamespace(named=100.0 + own, study=study, remainder=rest, added=())
    bare: Any = {"joint_coupling": SimpleNamespace(named=100.0)}
    assert standing.outweighed(one, bare, {"joint_coupling": evidence}, "joint_coupling", SETTINGS) == outweighed


@pytest.mark.parametrize(("effect_id", "feigned"), [("base_compliance", 50.0), ("link_bending", 0.0), ("joint_torsion", 0.0)])
def test_what_has_no_name_may_feign_a_base_and_no_gears_or_links(
    monkeypatch: pytest.MonkeyPatch, effect_id: str, feigned: float
) -> None:
    monkeypatch.setattr(standing, "needed", lambda *_: 6.5)
    monkeypatch.setattr(standing, "everywhere", lambda *_: True)  # as all three are in an absolute session
    monkeypatch.setattr(standing, "shown_by_readings", lambda *_: 0.0)
    one: Any = SimpleNamespace(term=lambda i: SimpleNamespace(effect=find_effect(i)))
    assert standing._least(one, effect_id, {effect_id: 50.0}, SETTINGS) == 6.5 + feigned


@pytest.mark.parametrize("stands", [True, False])
def test_what_is_likelier_in_a_names_place_takes_it_only_where_it_stands_too(
    monkeypatch: pytest.MonkeyPatch, stands: bool
) -> None:
    links, base, none = (SimpleNamespace(ids=i) for i in (("link_bending",), ("base_compliance",), ()))
    rival = Rivals({"link_bending": (("base_compliance", -17.9),)}, ((base, none),))
    monkeypatch.setattr(build, "rivals_of", lambda start, one, *_: rival if one is links else Rivals())
    monkeypatch.setattr(build, "refused", lambda *_: ("", 16.0))
    monkeypatch.setattr(build, "all_stand", lambda *_: {"base_compliance": 16.0} if stands else {})
    monkeypatch.setattr(build, "odds_of", lambda *_: 16.0)
    way: Any = SimpleNamespace(
        start=none, family=None, settings=SETTINGS, steps=[none, links], near={}, found=(), check=None,
        evidence={"link_bending": 14.6},
    )  # fmt: skip
    found = build._Way.rivals(way, ())
    assert way.steps[-1] is (base if stands else links)
    assert found.of == ({} if stands else rival.of)


@pytest.mark.usefixtures("needs_six_and_a_half")
@pytest.mark.parametrize(("of_settling", "outweighed"), [(500.0, False), (30.0, True)])
def test_what_has_the_form_of_a_larger_name_is_that_ones_and_outweighs_no_other(
    monkeypatch: pytest.MonkeyPatch, of_settling: float, outweighed: bool
) -> None:
    """A curve of the step just made, of 40, beside play of 35 and settling of the same axis."""
    monkeypatch.setattr(standing, "in_one_pose", lambda *_: False)
    monkeypatch.setattr(standing, "shown_by_readings", lambda *_: 0.0)
    monkeypatch.setattr(standing, "has_form_of", lambda structure, term, scene: term.effect.id == "joint_settling")
    added = tuple(SimpleNamespace(effect=SimpleNamespace(id=i)) for i in ("joint_settling", "joint_backlash"))
    rest = SimpleNamespace(structures=(SimpleNamespace(log_evidence=40.0, structure="step"),))
    study = SimpleNamespace(ready=SimpleNamespace(kind="loaded"))
    one: Any = SimpleNamespace(named=1000.0, study=study, remainder=rest, added=added)
    bare: Any = {"joint_settling": SimpleNamespace(named=1000.0 - of_settling), "joint_backlash": SimpleNamespace(named=965.0)}
    assert standing.outweighed(one, bare, {"joint_backlash": 10.0}, "joint_backlash", SETTINGS) == outweighed


@pytest.mark.usefixtures("needs_six_and_a_half")
@pytest.mark.parametrize(("weakest", "kept"), [("outweighed", ("sensor_alignment",)), ("too weak", ())])
def test_what_an_outweighed_name_explained_is_no_unknown_cause_beside_the_others(
    monkeypatch: pytest.MonkeyPatch, weakest: str, kept: tuple[str, ...]
) -> None:
    """A drift of 13 beside an unknown of 32 goes. Without it structures explain 71, more than the 34 of the name that is left;
    what too weak a name explained may be unknown, what an outweighed one did is not."""

    def model(named: float, ids: tuple[str, ...], rest: float) -> Any:
        added = tuple(SimpleNamespace(effect=SimpleNamespace(id=i)) for i in ids)
        left = SimpleNamespace(structures=(SimpleNamespace(log_evidence=rest, structure=None),), without_a_name=rest)
        study = SimpleNamespace(ready=SimpleNamespace(kind="loaded"))
        return SimpleNamespace(named=named, ids=ids, added=added, remainder=left, study=study, term=lambda i: None)

    none = model(0.0, (), 100.0)
    drift, turned = model(13.0, ("thermal_drift",), 100.0), model(34.0, ("sensor_alignment",), 71.0)
    both = model(47.0, ("sensor_alignment", "thermal_drift"), 32.0)
    less = {(both.ids, "thermal_drift"): turned, (both.ids, "sensor_alignment"): drift}
    weak = ["thermal_drift"] if weakest == "too weak" else []
    monkeypatch.setattr(standing, "without", lambda start, one, i, family: less.get((one.ids, i), none))
    monkeypatch.setattr(standing, "odds_of", lambda start, one, bare, i, *_: 10.0 if i == "thermal_drift" else 15.0)
    monkeypatch.setattr(standing, "with_more_parts", lambda bare, *_: bare)
    monkeypatch.setattr(standing, "_weak", lambda start, one, *_: [i for i in weak if i in one.ids])
    monkeypatch.setattr(standing, "in_one_pose", lambda *_: False)
    monkeypatch.setattr(standing, "shown_by_readings", lambda *_: 0.0)
    monkeypatch.setattr(standing, "has_form_of", lambda *_: False)
    monkeypatch.setattr(standing, "implausible", lambda *_: "")
    monkeypatch.setattr(standing, "_helps", lambda *_: True)
    family: Any = None
    assert standing.standing(none, both, family, SETTINGS)[0].ids == kept


def test_a_name_whose_values_others_have_made_impossible_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    """An encoder that was off by less than it can be alone was off by 3.4 mrad beside links that bend."""
    rest = SimpleNamespace(without_a_name=0.0)
    names = ("link_bending",), ("link_bending", "encoder_harmonics")
    alone, both = (SimpleNamespace(ids=i, added=i, remainder=rest) for i in names)
    monkeypatch.setattr(standing, "without", lambda start, one, i, family: alone)
    monkeypatch.setattr(standing, "odds_of", lambda *_: 50.0)
    monkeypatch.setattr(standing, "_weak", lambda *_: [])
    for name, said in (("outweighed", False), ("_together", True), ("_helps", True)):
        monkeypatch.setattr(standing, name, lambda *_, said=said: said)
    monkeypatch.setattr(standing, "implausible", lambda one, i: "3.4 mrad" if i == "encoder_harmonics" else "")
    anything: Any = None
    assert standing.standing(anything, both, anything, SETTINGS)[0].ids == ("link_bending",)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("axes_of_play", "brings", "mends"),
    [((2,), 40.0, True), ((2,), 60.0, False), ((2, 3), 40.0, False), ((4,), 40.0, False)],
)
def test_a_second_law_of_torque_that_explains_little_beside_one_of_the_same_axis_only_mends_the_first(
    monkeypatch: pytest.MonkeyPatch, axes_of_play: tuple[int, ...], brings: float, mends: bool
) -> None:
    stiffens = SimpleNamespace(effect=find_effect("joint_stiffening"), axes=frozenset({2}))
    play = SimpleNamespace(effect=find_effect("joint_backlash"), axes=frozenset(axes_of_play))
    monkeypatch.setattr(standing, "bends", lambda term, scene: term.axes)
    monkeypatch.setattr(standing, "without", lambda *_: SimpleNamespace(named=0.0))
    one: Any = SimpleNamespace(added=(stiffens, play), study=SimpleNamespace(ready=None), named=500.0 + brings)
    bare: Any = SimpleNamespace(named=500.0)  # what the first law explains alone
    family: Any = None
    assert standing._mends(family, one, bare, "joint_backlash", family, SETTINGS) == mends


@pytest.mark.parametrize(
    ("variables", "drifts", "left", "falls"),
    [
        (("temp_gear_2", "tau_2"), False, 50.0, True),
        (("temp_gear_2", "tau_2"), False, 20.0, False),
        (("temp_gear_2",), True, 50.0, False),  # another form of the same drift
        (("temp_ambient", "tau_2"), False, 50.0, False),
        (("stamp", "tau_2"), False, 50.0, False),
    ],
)
def test_a_drift_beside_a_load_that_goes_with_the_same_temperature_is_no_drift(
    variables: tuple[str, ...], drifts: bool, left: float, falls: bool
) -> None:
    drift = find_effect("thermal_drift")
    parameters = (Parameter("v_x", "m/s", 1.0, group="time"), Parameter("k_gear_2_x", "m/K", 1.0, group="temp_gear_2"))
    term = SimpleNamespace(
        effect=SimpleNamespace(cause=drift.cause, family=drift.family, parameters=lambda scene: parameters),
        estimates={"k_gear_2_x": None},
    )
    part = SimpleNamespace(structure=SimpleNamespace(is_drift=drifts, variables=variables), log_evidence=left)
    one: Any = SimpleNamespace(
        named=100.0, remainder=SimpleNamespace(structures=(part,)), study=SimpleNamespace(ready=None), term=lambda i: term
    )
    bare: Any = SimpleNamespace(named=0.0)
    assert standing._part_of_another(one, bare, "thermal_drift", SETTINGS) == falls


@pytest.mark.usefixtures("needs_six_and_a_half")
@pytest.mark.parametrize(("structures", "stand"), [(283.5, False), (250.0, True)])
def test_two_names_need_together_what_each_of_them_needs_over_structures_in_the_place_of_both(
    monkeypatch: pytest.MonkeyPatch, structures: float, stand: bool
) -> None:
    """A tool that slides up its taper was called a hose and a gain error, each needed beside the other, by 7.6 nats."""
    for name in ("in_one_pose", "shown_by_readings"):
        monkeypatch.setattr(standing, name, lambda *_: 0.0)
    monkeypatch.setattr(standing, "needed", lambda *_: 6.5)
    monkeypatch.setattr(standing, "forms_of", lambda *_: NO_FORMS)
    start: Any = SimpleNamespace(named=0.0, study="start")
    one: Any = SimpleNamespace(
        named=291.1, ids=("sensor_gain", "external_force"), term=lambda _: None, remainder=SimpleNamespace(parts=()),
        study=SimpleNamespace(ready=None),
    )  # fmt: skip
    monkeypatch.setattr(standing, "remainder_of", lambda s, *_: SimpleNamespace(gained=structures if s == "start" else 0.0))
    assert standing._together(start, one, None, SETTINGS) == stand  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("axis", "left", "of_another_form"),
    [(1, 35.0, True), (1, 6.0, False), (1, 15.0, False), (2, 35.0, False), (None, 35.0, False)],
)
def test_a_compliance_that_goes_with_its_angle_beside_which_more_of_it_is_left_is_no_balancer(
    monkeypatch: pytest.MonkeyPatch, axis: int | None, left: float, of_another_form: bool
) -> None:
    """A gear of axis 2 whose compliance ripples five times per turn was called a counterbalance, with 35 beside 370 left."""
    monkeypatch.setattr(standing, "forms_of", lambda *_: Forms(turns=frozenset({1})))
    structure = SimpleNamespace(log_evidence=left, structure=SimpleNamespace(softer_by_angle=axis))
    study = SimpleNamespace(ready=SimpleNamespace(kind="loaded"))
    term = SimpleNamespace(effect=find_effect("counterbalance"))
    one: Any = SimpleNamespace(named=370.0, remainder=SimpleNamespace(structures=(structure,)), study=study, term=lambda _: term)
    bare: Any = SimpleNamespace(named=0.0)
    assert standing._of_another_form(one, bare, "counterbalance", SETTINGS) == of_another_form


@pytest.mark.parametrize(
    ("kind", "axis", "left", "of_another_form"),
    [
        ("loaded", 0, 65.0, True),
        ("loaded", 0, 12.0, False),
        ("loaded", 1, 65.0, False),
        ("loaded", None, 65.0, False),
        ("absolute", 0, 65.0, False),
    ],
)
def test_a_base_beside_which_much_that_goes_with_the_first_axis_is_left_is_no_spring(
    monkeypatch: pytest.MonkeyPatch, kind: str, axis: int | None, left: float, of_another_form: bool
) -> None:
    """A pedestal of which one foot lifts was called a soft base, with 65 beside 252 left; beside soft bases nothing is."""
    monkeypatch.setattr(standing, "forms_of", lambda *_: NO_FORMS)
    structure = SimpleNamespace(log_evidence=left, structure=SimpleNamespace(softer_by_angle=axis))
    term, study = SimpleNamespace(effect=find_effect("base_compliance")), SimpleNamespace(ready=SimpleNamespace(kind=kind))
    one: Any = SimpleNamespace(named=252.0, remainder=SimpleNamespace(structures=(structure,)), study=study, term=lambda _: term)
    bare: Any = SimpleNamespace(named=0.0)
    assert standing._of_another_form(one, bare, "base_compliance", SETTINGS) == of_another_form


@pytest.mark.parametrize(
    ("falls_by", "in_one_pose", "helps"),
    [(0.5, False, True), (-0.5, False, False), (float("nan"), False, True), (-0.5, True, True)],
    ids=["error falls", "error rises", "too few poses to know", "shown by one pose"],
)
def test_names_that_are_left_after_others_fell_still_have_to_help_on_held_out_poses(
    monkeypatch: pytest.MonkeyPatch, falls_by: float, in_one_pose: bool, helps: bool
) -> None:
    """A hose came in beside an error of geometry; by itself it raised the error from 126 to 137 um."""
    monkeypatch.setattr(standing, "in_one_pose", lambda *_: in_one_pose)
    for name in ("held_out", "only_good_poses"):
        monkeypatch.setattr(standing, name, lambda found, *_: found)
    monkeypatch.setattr(standing, "gain", lambda before, after: (falls_by, 1.0, 10))
    start, one = (SimpleNamespace(study=None, remainder=None, ids=ids) for ids in ((), ("external_force",)))
    assert standing._helps(start, one) == helps  # type: ignore[arg-type]


def test_a_name_that_further_parts_of_another_explain_as_well_does_not_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift beside a geometry error of one axis, which with a second axis explains all of it."""

    def model(named: float, ids: tuple[str, ...]) -> Any:
        return SimpleNamespace(named=named, ids=ids, added=ids, remainder=SimpleNamespace(without_a_name=0.0))

    none, drift, geometry = model(0.0, ()), model(50.0, ("thermal_drift",)), model(80.0, ("geometry_error",))
    both, wider = model(95.0, ("thermal_drift", "geometry_error")), model(94.0, ("geometry_error",))
    bare = {"thermal_drift": geometry, "geometry_error": drift}
    monkeypatch.setattr(standing, "without", lambda start, one, i, family: bare[i] if one is both else none)
    monkeypatch.setattr(standing, "with_more_parts", lambda one, *_: wider if one is geometry else one)
    monkeypatch.setattr(standing, "odds_of", lambda start, one, without, *_: one.named - without.named)
    monkeypatch.setattr(standing, "_weak", lambda start, one, without, nats, *_: [i for i in one.ids if nats[i] < 6.5])
    for quiet in ("outweighed", "implausible"):
        monkeypatch.setattr(standing, quiet, lambda *_: False)
    for fine in ("_together", "_helps"):
        monkeypatch.setattr(standing, fine, lambda *_: True)
    family: Any = None
    kept, evidence = standing.standing(none, both, family, SETTINGS)
    assert kept is wider and evidence == {"geometry_error": 94.0}
