# SPDX-License-Identifier: Apache-2.0
"""A spring balancer pulls the tool with one tension towards the place where it hangs, whenever the process is on."""

from __future__ import annotations

import html
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.commands.improve import in_words
from irec_calibration.diagnose import diagnose, improve
from irec_calibration.diagnose.columns import block_columns
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.improve import Ladder
from irec_calibration.diagnose.places import Places, places_of
from irec_calibration.diagnose.priors import FACTORS
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.hoses import PLACE, to_place
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term, total_displacement
from irec_calibration.report.ladder import write_ladder_report
from irec_calibration.typing import Array

TENSION, HOOK = 120.0, np.array([0.9, -0.4, 2.6])  # N; m in base_link
AT_TCP, ASIDE = np.zeros(3), np.array([0.35, -0.2, -0.3])  # m in tool0


def pulled(scene: Scene, tension: float = TENSION, stiffness: float = 0.0, tied: Array = AT_TCP) -> Array:
    """What the springs of the synthetic robot make of the tension on the tool, (n, 3), m."""
    at = scene.p_tcp + scene.kin.R_tool @ tied
    way = HOOK - at
    force = (tension / np.linalg.norm(way, axis=1, keepdims=True) + stiffness) * way * (scene.load_case > 0)[:, None]
    tau = np.einsum("nik,ni->nk", scene.kin.jacobian(at), force)
    return np.asarray(np.einsum("nik,nk->ni", scene.J, tau * synthetic.COMPLIANCE))


def study(tension: float = TENSION, tied: Array = AT_TCP) -> Study:
    session = synthetic.session(poses=20, seed=3, extra=lambda scene: pulled(scene, tension, tied=tied))
    return prepare(session, [Term(find_effect(e)) for e in ("joint_torsion", "link_bending")])


def of_hose(at: Study) -> Places:
    return next(p for p in places_of(at, find_effect("external_force")) if p.group == PLACE)


@cache
def ladder() -> Ladder:
    return improve(synthetic.session(poses=24, seed=3, extra=pulled))


@pytest.mark.parametrize("tied", [AT_TCP, ASIDE])
@pytest.mark.parametrize(("tension", "stiffness"), [(TENSION, 0.0), (-150.0, 110.0), (0.0, 40.0)])
def test_the_form_is_a_tension_along_the_way_to_the_place_that_may_grow_with_the_way(
    tension: float, stiffness: float, tied: Array
) -> None:
    scene = scene_of(synthetic.session(poses=6))
    springs = Term(find_effect("joint_torsion"), {f"c_{k + 1}": Estimate(c) for k, c in enumerate(synthetic.COMPLIANCE)})
    values = {"t": tension, "k_place": stiffness} | {f"h_{a}": h for a, h in zip("xyz", HOOK, strict=True)}
    values |= {f"to_{a}": v for a, v in zip("xyz", tied, strict=True)}
    hose = Term(find_effect("external_force"), {n: Estimate(float(v)) for n, v in values.items()})
    moved = total_displacement([springs, hose], scene) - total_displacement([springs], scene)
    np.testing.assert_allclose(moved, pulled(scene, tension, stiffness, tied), atol=1e-12)


def test_what_it_does_by_where_it_is_tied_and_by_the_place_is_the_derivative_of_its_pull() -> None:
    scene, values = scene_of(synthetic.session(poses=6)), np.array([60.0, 20.0, 30.0, *HOOK, *ASIDE])

    def wrench(theta: Array) -> Array:
        return np.asarray(to_place(scene, theta)[:, :, :3] @ theta[:3])

    by_value = to_place(scene, values)
    for i, step in enumerate(1e-6 * np.eye(len(values))):
        expected = (wrench(values + step) - wrench(values - step)) / 2e-6
        np.testing.assert_allclose(by_value[:, :, i], expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(("tension", "tied", "found_m"), [(TENSION, AT_TCP, 0.0), (4.0 * TENSION, ASIDE, 0.15)])
def test_where_on_the_tool_a_hose_is_tied_is_told_where_that_explains_more_than_it_costs(
    tension: float, tied: Array, found_m: float
) -> None:
    at = study(tension, tied)
    place, _ = of_hose(at).best(Ground(at.bench, at.base))
    assert np.linalg.norm([place[f"to_{a}"] for a in "xyz"] - tied) <= found_m, place


def test_a_pull_towards_a_place_that_pushes_on_the_whole_is_impossible() -> None:
    scene, effect = scene_of(synthetic.session(poses=6)), find_effect("external_force")
    values = {f"h_{a}": (float(h), 0.1) for a, h in zip("xyz", HOOK, strict=True)} | {"t": (-150.0, 1.0)}
    assert "it would push with" in effect.why_impossible(values, {}, scene)
    assert effect.why_impossible(values | {"k_place": (110.0, 1.0)}, {}, scene) == ""
    assert effect.why_impossible(values | {"t_wrist": (200.0, 1.0)}, {}, scene) == ""
    assert "it would push with" in effect.why_impossible(values | {"t_wrist": (100.0, 1.0)}, {}, scene)


def test_a_place_from_which_a_hose_would_push_is_no_start() -> None:
    at = study()
    opposite = 2.0 * at.ready.p_tcp.mean(axis=0) - HOOK  # a push from there is much like the pull towards the hook
    at_tcp = {f"to_{a}": 0.0 for a in "xyz"}
    places = [{f"h_{a}": float(v) for a, v in zip("xyz", p, strict=True)} | at_tcp for p in (opposite, HOOK + [0.0, 1.1, 0.0])]
    hose, ground = of_hose(at), Ground(at.bench, at.base)
    blocks = tuple(hose._columns(place) for place in places)
    pushes, pulls = (ground.posterior(block, FACTORS) for block in blocks)
    assert pushes.log_evidence > pulls.log_evidence, "no example"
    found, _ = replace(hose, grid=tuple(places), blocks=blocks).best(ground)
    assert np.linalg.norm([found[f"h_{a}"] for a in "xyz"] - HOOK) < 0.5


def test_a_place_to_which_it_moved_and_from_which_it_would_push_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    at = study()
    hose, ground = of_hose(at), Ground(at.bench, at.base)
    assert hose.best(ground)[0] not in hose.grid, "no example"
    monkeypatch.setattr(Places, "_can_be", lambda self, shape, x: shape in self.grid)
    place, log_prior = hose.best(ground)
    assert place in hose.grid and log_prior == pytest.approx(-np.log(len(hose.grid)))


def test_the_place_is_found_between_those_of_the_grid() -> None:
    at = study()
    place, log_prior = of_hose(at).best(Ground(at.bench, at.base))
    found = np.array([place[f"h_{a}"] for a in "xyz"])
    assert np.linalg.norm(found - HOOK) < 0.25, found
    assert log_prior < -np.log(len(of_hose(at).grid)), "what is found within a cell of the grid costs evidence too"


def test_the_place_has_more_evidence_than_each_of_the_grid() -> None:
    at, hose = study(), of_hose(study())
    ground = Ground(at.bench, at.base)
    place, _ = hose.best(ground)

    def evidence(shape: dict[str, float]) -> float:
        block, parameters = block_columns(at, hose.effect, shape)
        own = block.take([i for i, p in enumerate(parameters) if p.group == PLACE])
        return ground.posterior(own, FACTORS).log_evidence

    assert evidence(place) > max(evidence(shape) for shape in hose.grid)


@pytest.mark.slow
def test_it_is_named_with_its_tension_and_place_and_people_are_told_where_to_look() -> None:
    verdict = ladder().before.verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert PLACE in verdict.parts["external_force"].proven, verdict.text
    assert verdict.where["external_force"] in verdict.text
    assert verdict.where["external_force"].startswith("Unmeasured external force: it pulls with some")


@pytest.mark.slow
def test_who_improves_a_model_is_told_where_to_look_too(tmp_path: Path) -> None:
    where = ladder().before.verdict.where["external_force"]
    assert where in " ".join(in_words(ladder()).split())
    page, *_ = write_ladder_report(ladder(), synthetic.session(poses=24, seed=3, extra=pulled), tmp_path)
    assert html.escape(where) in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_improved_model_has_the_tension_and_the_place_and_nothing_else_of_a_hose() -> None:
    term = next(t for t in ladder().model.terms if t.effect.id == "external_force")
    value = {n: e.value for n, e in term.estimates.items()}
    assert set(value) == {"t", "t_wrist", "k_place", "h_x", "h_y", "h_z", "to_x", "to_y", "to_z"}
    scene = scene_of(synthetic.session(poses=24, seed=3))
    way = float(np.linalg.norm([value[f"h_{a}"] for a in "xyz"] - scene.p_tcp, axis=1).mean())
    assert value["t"] + value["t_wrist"] + value["k_place"] * way == pytest.approx(TENSION, rel=0.2)
    assert np.linalg.norm([value[f"h_{a}"] - h for a, h in zip("xyz", HOOK, strict=True)]) < 0.4


@pytest.mark.slow
def test_of_a_constant_pull_no_place_is_proven() -> None:
    def constant(scene: Scene) -> Array:
        force = np.array([40.0, -60.0, 90.0]) * (scene.load_case > 0)[:, None]
        tau = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), force)
        return np.asarray(np.einsum("nik,nk->ni", scene.J, tau * synthetic.COMPLIANCE))

    verdict = diagnose(synthetic.session(poses=24, seed=3, extra=constant)).verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert PLACE not in verdict.parts["external_force"].proven, verdict.text
    assert "look what hangs" not in verdict.text


@pytest.mark.parametrize(
    ("values", "proven", "told"),
    [
        (
            {"t": 30.0, "t_wrist": 37.0, "h_x": 0.695, "h_y": 0.93, "h_z": 2.82},
            (PLACE,),
            "some 67 N towards about (0.7, 0.9, 2.8) m",
        ),
        (
            {"t": 212.0, "h_x": 1.0, "h_y": 0.0, "h_z": 2.0},
            ("with the tool", PLACE),
            "some 210 N towards about (1.0, 0.0, 2.0) m",
        ),
        (
            {"t": 212.0, "k_place": 35.0, "h_x": 1.0, "h_y": 0.0, "h_z": 2.0},
            (PLACE,),
            "some 210 N and 35 N more for each metre of its way towards about (1.0, 0.0, 2.0) m",
        ),
        (
            {"t": -200.0, "k_place": 240.0, "h_x": 1.0, "h_y": 0.0, "h_z": 2.0},
            (PLACE,),
            "some 240 N/m of what its way is longer than 0.8 m towards about (1.0, 0.0, 2.0) m",
        ),
        ({"f_x": 30.0, "f_y": 0.0, "f_z": -40.0}, ("constant",), "some 50 N along (0.6, 0.0, -0.8) in base_link"),
        (
            {"f_x": 30.0, "f_z": 60.0, "k": 30.0},
            ("constant", "towards a point"),
            "of some 30 N/m towards about (1.0, 0.0, 2.0) m",
        ),
        ({"f_x": 30.0, "f_x_tool": 20.0}, ("constant", "with the tool"), ""),
        ({"t": 30.0, "h_x": 1.0, "h_z": 2.0}, (PLACE,), ""),  # h_y stands at a bound
        ({"t": 30.0, "h_x": 1.0, "h_y": 0.0, "h_z": 2.0}, (), ""),
    ],
)
def test_where_to_look_is_told_of_what_is_proven(values: dict[str, float], proven: tuple[str, ...], told: str) -> None:
    sentence = find_effect("external_force").where_to_look(values, proven)
    assert told in sentence and bool(told) == bool(sentence), sentence
