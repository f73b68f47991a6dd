# SPDX-License-Identifier: Apache-2.0
"""A name none of whose parts is proven has to help on other poses, or stand alone; parts that are missed stay."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from irec_calibration.diagnose import shown
from irec_calibration.diagnose.assessment import Assessment
from irec_calibration.diagnose.part_sets import Parts
from irec_calibration.diagnose.parts import _missed
from irec_calibration.effects import find_effect
from irec_calibration.model import Term


def model(*ids: str, error: float) -> Any:
    terms = tuple(Term(find_effect(i)) for i in ids)
    return SimpleNamespace(study=SimpleNamespace(terms=terms), held_out=SimpleNamespace(rms_m=error))


@pytest.mark.parametrize(
    ("kind", "parts", "without", "evidence", "fallen"),
    [
        ("absolute", Parts(perhaps=("constant",)), 100.5e-6, (), ("external_force",)),
        ("absolute", Parts(perhaps=("constant",)), 95e-6, (), ("external_force",)),
        ("absolute", Parts(perhaps=("constant",)), 102e-6, (), ()),
        ("absolute", Parts(proven=("constant",)), 100.5e-6, (), ()),
        ("absolute", None, 100.5e-6, (), ()),
        ("loaded", Parts(perhaps=("constant",)), 100.5e-6, (), ()),
        ("loaded", Parts(perhaps=("constant",)), 100.5e-6, ("repeats",), ("external_force",)),
        ("loaded", Parts(perhaps=("constant",)), 105e-6, ("repeats",), ()),
        ("loaded", Parts(proven=("constant",)), 100.5e-6, ("repeats",), ()),
        ("loaded", Parts(one_of=(("constant",), ("with the tool",))), 100.5e-6, ("repeats",), ()),
    ],
)
def test_without_a_proven_part_a_name_has_to_lower_the_error_on_other_poses_by_far_more_than_what_is_left(
    monkeypatch: pytest.MonkeyPatch, kind: str, parts: Parts | None, without: float, evidence: Any, fallen: tuple[str, ...]
) -> None:
    asked: list[tuple[str, ...]] = []

    def validated(session: object, terms: list[Term]) -> Any:
        asked.append(tuple(t.effect.id for t in terms))
        return model(*asked[-1], error=without)

    monkeypatch.setattr(shown, "validated", validated)
    known = {"joint_torsion": Parts(perhaps=("axis 1",))} | ({"external_force": parts} if parts else {})
    names = ("joint_torsion", "external_force")
    assessment: Any = SimpleNamespace(names=names, parts=known, evidence=evidence, remaining_m=10e-6)
    after = model("joint_torsion", "external_force", error=100e-6)
    session: Any = SimpleNamespace(kind=kind)
    assert shown.unproven(session, assessment, after, lambda: None) == fallen
    assert set(asked) <= {("joint_torsion",)}  # that axes give way is no question


@pytest.mark.parametrize(
    ("without", "evidence", "fallen"),
    [(100.3e-6, ("wandering",), ("thermal_drift",)), (101e-6, ("wandering",), ()), (100.3e-6, ("repeats",), ())],
)
def test_a_drift_is_no_name_where_readings_wander_by_more_than_it_explains(
    monkeypatch: pytest.MonkeyPatch, without: float, evidence: Any, fallen: tuple[str, ...]
) -> None:
    monkeypatch.setattr(shown, "validated", lambda session, terms: model(*(t.effect.id for t in terms), error=without))
    known = {"thermal_drift": Parts(proven=("time",)), "sensor_gain": Parts(proven=("gain",))}
    assessment: Any = SimpleNamespace(names=("thermal_drift", "sensor_gain"), parts=known, evidence=evidence, remaining_m=10e-6)
    after = model("thermal_drift", "sensor_gain", error=100e-6)
    assert shown.unproven(SimpleNamespace(kind="loaded"), assessment, after, lambda: None) == fallen


@pytest.mark.parametrize(("lost", "missed"), [(3.0, False), (30.0, True), (-5.0, False)])
def test_parts_are_missed_where_the_fitted_model_explains_much_less_without_them(lost: float, missed: bool) -> None:
    def fitted(log_evidence: float) -> Any:
        posterior = SimpleNamespace(log_evidence=np.float64(log_evidence))
        return SimpleNamespace(bench=SimpleNamespace(posterior=lambda block: posterior), base=None)

    assert _missed(fitted(100.0), fitted(100.0 - lost), None) == missed


@pytest.mark.parametrize(
    ("names", "evidence", "one_of", "status"),
    [
        (("external_force", "joint_torsion"), (), (), "missing_effect"),
        (("external_force",), ("repeats",), (), "unexplained"),
        (("external_force",), (), (("creep", "joint_hysteresis"),), "unexplained"),
        (("external_force",), (), (), "adequate"),
    ],
)
def test_a_verdict_goes_by_the_names_that_are_left(
    names: tuple[str, ...], evidence: tuple[str, ...], one_of: tuple[tuple[str, ...], ...], status: str
) -> None:
    unknown: dict[str, Any] = {f.name: None for f in fields(Assessment)}
    whole = Assessment(**unknown | {"status": "missing_effect", "names": names, "evidence": evidence, "one_of": one_of})
    left = whole.without_names(("external_force",))
    assert (left.status, left.names, left.unproven) == (status, names[1:], ("external_force",))
