# SPDX-License-Identifier: Apache-2.0
"""The process course of a cell as rows for a model, and what models predict for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.diagnose import Study, Validated, held_out, prepare, start_terms, versioned
from irec_calibration.diagnose.on_course import on_course
from irec_calibration.errors import CellError
from irec_calibration.model import Estimate
from irec_calibration.poses.course import course_of
from irec_calibration.session import Session, read_session
from irec_sim.cellfile import read_cell as simulated_cell
from irec_sim.course import plan_course
from irec_sim.errors import SimError
from irec_sim.session import generate, write_session
from irec_sim.truth import make_truth

CELL = Path(__file__).parents[1] / "config" / "cells" / "afp.yaml"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return read_cell(CELL)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    made = simulated_cell(CELL)
    rows = generate(made, make_truth(made.name, [], 1, effort=made.chain.effort), 12, 3)
    return read_session(write_session(rows, tmp_path_factory.mktemp("course") / "clean", "clean"))


@pytest.fixture(scope="module")
def study(session: Session) -> Study:
    return prepare(session, start_terms(session))


def test_the_tool_is_pressed_on_the_surface_all_along_the_course(cell, session):
    course = course_of(cell, session)
    assert course is not None and course.s[-1] > 1.0 and (np.diff(course.s) > 0.0).all()
    kin = session.robot.kinematics(course.session.q)
    assert np.abs(kin.R_tool[:, :, 2] + np.repeat(course.normal, 2, axis=0)).max() < 1e-6
    surface = cell.surface.place(np.linspace((-0.30, -0.60), (0.30, 0.60), len(course.s)))[0]
    rail = next(iter(course.session.ext.values()))[:, None] * cell.rail.axis
    assert np.abs((kin.p_tcp + rail)[::2] - surface).max() < 1e-6
    assert not course.session.force_in_tool[::2].any() and (course.session.force_in_tool[1::2, 2] < -700.0).all()


def test_a_correction_with_the_right_model_leaves_nothing_and_one_with_half_its_springs_leaves_half(cell, session, study):
    course = course_of(cell, session)
    model = versioned(Validated(study, held_out(study)), None, "start")
    right = on_course(course, model, study)
    assert right.before.max() < 1e-12 < right.without.max()
    half = replace(
        model,
        terms=tuple(
            replace(t, estimates={n: Estimate(0.5 * e.value) for n, e in t.estimates.items()}) for t in model.terms
        ),
    )
    assert np.allclose(on_course(course, half, study).before, 0.5 * right.without, atol=1e-12)
    assert (right.se > 0.0).all() and right.se.mean() < 0.1 * right.without.mean()
    assert "without correction" in right.in_words() and "0.30 mm" in right.in_words()
    assert "as the cell file says (course.tool_x)" in right.in_words()
    assert "as in the nearest pose of the session" in replace(right, is_turned=False).in_words()


def test_a_cell_without_a_course_has_none_and_a_wrong_one_is_refused_with_its_place(cell, session):
    assert course_of(replace(cell, raw={}), session) is None
    with pytest.raises(CellError, match="section 'course' lacks.*speed"):
        course_of(replace(cell, raw={"course": {"from": [0, 0], "to": [0.1, 0], "force": [0, 0, -900]}}), session)
    far = dict(cell.raw["course"], to=[9.0, 9.0])
    with pytest.raises(CellError, match="can't follow"):
        course_of(replace(cell, raw={"course": far}), session)


def asked(section: dict, tool_x: object) -> dict:
    return {k: v for k, v in section.items() if k != "tool_x"} | ({} if tool_x is None else {"tool_x": tool_x})


@pytest.mark.parametrize("tool_x", ["course", [-0.7, 0.0, -0.714], [0.0, 1.0, 0.0], [0.0, -1.0, 0.3]])
def test_predicted_and_driven_course_turn_the_tool_as_the_cell_file_says(cell, session, tool_x):
    section = asked(cell.raw["course"], tool_x)
    predicted = course_of(replace(cell, raw={**cell.raw, "course": section}), session)
    driven = plan_course(replace(simulated_cell(CELL), course=section))
    assert predicted is not None
    way = np.linspace(0.0, 1.0, len(driven.q))
    q = np.array([np.interp(predicted.s / predicted.s[-1], way, angle) for angle in driven.q.T]).T
    assert np.abs(predicted.session.q[::2] - q).max() < 2e-4
    x = session.robot.kinematics(predicted.session.q[::2]).R_tool[:, :, 0]
    wanted = predicted.tangent if tool_x == "course" else np.tile(tool_x, (len(x), 1))
    along = wanted - predicted.normal * np.sum(wanted * predicted.normal, axis=1)[:, None]
    assert np.abs(x - along / np.linalg.norm(along, axis=1)[:, None]).max() < 1e-6


def test_without_the_key_predicted_and_driven_course_may_differ(cell, session):
    section = asked(cell.raw["course"], None)
    predicted = course_of(replace(cell, raw={**cell.raw, "course": section}), session)
    driven = plan_course(replace(simulated_cell(CELL), course=section))
    assert predicted is not None
    assert abs(predicted.session.q[-1, 5] - driven.q[-1, 5]) > 0.5  # rad about the tool's axis
    said = plan_course(simulated_cell(CELL))  # the key of the file asks for what the simulator does without it
    assert np.abs(said.q - driven.q).max() < 1e-9


@pytest.mark.parametrize(("tool_x", "words"), [("across", "3 numbers"), ([1.0], "3 numbers"), ("normal", "lies along the tool")])
def test_a_tool_direction_that_says_nothing_is_refused_by_both(cell, session, tool_x, words):
    if tool_x == "normal":
        tool_x = plan_course(simulated_cell(CELL)).normal[0].tolist()
    section = asked(cell.raw["course"], tool_x)
    section |= {"to": [section["from"][0] + 1e-4, section["from"][1]]}  # short: the same normal all along
    with pytest.raises(CellError, match=words):
        course_of(replace(cell, raw={**cell.raw, "course": section}), session)
    with pytest.raises(SimError, match=words):
        plan_course(replace(simulated_cell(CELL), course=section))
