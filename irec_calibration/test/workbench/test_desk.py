# SPDX-License-Identifier: Apache-2.0
"""What the workbench computes: versions, trials (quick and exact), views; and its worker process: errors, cancel, death."""

from __future__ import annotations

import asyncio
import time

import numpy as np
import pytest
from irec_calibration.errors import Cancelled, IrecError
from irec_calibration.model.file import load_model
from irec_calibration.workbench import figures, words
from irec_calibration.workbench.desk import Desk
from irec_calibration.workbench.room import Room, Shared
from irec_calibration.workbench.versions import new_folder
from irec_calibration.workbench.worker import Stock, Worker

TRIED = "axis 1: c * tau**3"


def quiet(share, what):
    pass


def never():
    return False


@pytest.fixture(scope="module")
def desk(hidden_session, tmp_path_factory):
    made = Desk()
    folder = str(tmp_path_factory.mktemp("versions"))
    version = made.start(str(hidden_session), "", folder, quiet, never)
    return made, str(hidden_session), version, folder


def test_the_first_version_is_fitted_and_is_a_model_file(desk):
    _, _, version, _ = desk
    assert [e.id for e in version.effects] == ["joint_torsion", "link_bending"]
    assert version.cv_rms_m > 1.5 * version.noise_m and load_model(version.model).effects == ("joint_torsion", "link_bending")


def test_the_quick_answer_agrees_with_the_exact_one(desk):
    made, session, version, folder = desk
    quick = made.quick(session, version.model, TRIED, quiet, never)
    exact = made.exact(session, version.model, TRIED, folder, quiet, never)
    assert quick.supported and exact.supported and exact.version is not None
    assert abs(quick.cv_rms_m - exact.cv_rms_m) < 2.0 * exact.cv_rms_se_m  # the exact one chooses the springs' prior anew
    assert exact.cv_rms_m < 0.7 * version.cv_rms_m


def test_the_quick_answer_comes_within_a_moment_once_the_model_is_prepared(desk):
    made, session, version, _ = desk
    began = time.process_time()
    made.quick(session, version.model, TRIED, quiet, never)
    assert time.process_time() - began < 3.0  # usual: 0.1 s


def test_an_effect_that_the_data_do_not_support_is_told_so(desk):
    made, session, version, _ = desk
    assert "do not support" in made.quick(session, version.model, "tool x: c * sin(30 * q_4)", quiet, never).sentence


def test_an_effect_that_can_not_show_is_refused_with_the_reason(desk):
    made, session, version, _ = desk
    with pytest.raises(IrecError, match="rail_compliance.*external axis"):
        made.quick(session, version.model, "rail_compliance", quiet, never)


def test_a_second_formula_of_the_same_axis_gets_a_name_of_its_own(desk):
    made, session, version, folder = desk
    first = made.exact(session, version.model, TRIED, folder, quiet, never)
    second = made.quick(session, first.model, "axis 1: d * tau", quiet, never)
    assert second.effect != first.effect


def test_an_effect_taken_out_is_gone_and_the_error_is_higher(desk):
    made, session, version, folder = desk
    less = made.without(session, version.model, "link_bending", folder, quiet, never)
    assert [e.id for e in less.effects] == ["joint_torsion"] and less.fit_rms_m > version.fit_rms_m


def test_the_checklist_names_what_is_there_and_what_is_wrong(desk, tmp_path):
    made, session, _, _ = desk
    kinds = [k for k, _ in made.inspect(session, quiet, never)]
    assert "ok" in kinds and "bad" not in kinds
    assert made.inspect(str(tmp_path / "none"), quiet, never)[-1][0] == "bad"


def test_every_figure_can_be_drawn_and_sent(desk):
    import json

    made, session, version, folder = desk
    view = made.view(session, quiet, never)
    tried = made.exact(session, version.model, TRIED, folder, quiet, never)
    group = view.load_case[version.rows] == 2
    for look in (figures.Look(False), figures.Look(True)):
        drawn = [
            figures.cell(
                view, version, tried.residual, magnify=500.0, ghost=version.residual, selected=3, group=group, look=look
            ),
            figures.ladder([version], 0, tried, look),
            figures.norms(view, version, tried.residual, version.residual, group, look),
            figures.against(view, version, version.residual, "tau_1", group, look),
            figures.growth(None, look),
            figures.course(None, look),
        ]
        for figure in drawn:
            assert json.loads(json.dumps(figure, allow_nan=False))["data"] is not None


def test_a_sample_and_a_group_are_described(desk):
    made, session, version, _ = desk
    view = made.view(session, quiet, never)
    names = [name for name, _ in words.sample(view, version, version.residual, 0)]
    assert {"force in tool0", "torque about the axes", "measured", "predicted", "residual"} <= set(names)
    said = words.group(view, version, version.residual, view.load_case[version.rows] == 2)
    assert "All are of load case 2." in said and "samples" in said[0]


def test_magnification_is_a_round_number(desk):
    made, session, version, _ = desk
    scale = figures.nice_scale(made.view(session, quiet, never), version.residual)
    assert float(f"{scale:.0e}") == pytest.approx(scale) and f"{scale:.0e}"[0] in "125"


def test_a_session_of_five_thousand_rows_is_drawn_with_few_traces(desk):
    made, session, version, _ = desk
    view = made.view(session, quiet, never)
    many = np.tile(np.arange(len(version.rows)), 5000 // len(version.rows))
    from dataclasses import replace

    arrays = ("rows", "measured", "predicted", "residual", "sigma", "held_out")
    big = replace(version, **{k: getattr(version, k)[many] for k in arrays})
    figure = figures.cell(view, big, big.residual, magnify=500.0)
    assert len(figure["data"]) < 12


def test_a_room_keeps_throws_away_and_saves_without_overwriting(hidden_session, tmp_path):
    async def story():
        room = Room(str(hidden_session), new_folder(tmp_path, "s"))
        try:
            await room.open()
            await room.attempt("axis 1: c * tau")
            room.discard()
            assert len(room.versions.all) == 1
            await room.attempt(TRIED)
            assert room.tried is not None and room.tried.exact and room.ghost is not None
            room.keep()
            assert len(room.versions.all) == 2 and room.current.cv_rms_m < room.versions.all[0].cv_rms_m
            one, two = room.save(str(tmp_path)), room.save(str(tmp_path))
            assert one != two and load_model(one).effects[-1] == "formula_axis_1"
            room.undo()
            assert room.versions.index == 0
            with pytest.raises(IrecError, match="diagnose first"):
                room.plan(str(tmp_path))
        finally:
            room.close()

    asyncio.run(story())


def test_a_room_follows_a_recording_that_is_still_being_written(growing, tmp_path):
    path, states = growing

    async def story():
        room = Room(str(path), new_folder(tmp_path, "s"))
        try:
            path.write_bytes(states[8])
            await room.open()
            assert len(set(room.view.pose)) == 8 and not await room.grown()
            await room.attempt(TRIED)
            room.keep()
            room.select(3)
            path.write_bytes(states[10])
            assert await room.grown()
            assert len(set(room.view.pose)) == 10 and len(room.current.rows) == 50
            assert [v.name for v in room.versions.all] == ["joint_torsion + link_bending", "+ formula_axis_1"]
            assert room.selected is None and room.group is None
        finally:
            room.close()

    asyncio.run(story())


def test_the_ladder_answers_for_a_group(desk):
    made, session, version, folder = desk
    exact = made.exact(session, version.model, TRIED, folder, quiet, never)
    worst = np.linalg.norm(version.residual, axis=1) > np.quantile(np.linalg.norm(version.residual, axis=1), 0.8)
    points = [figures.ladder([version, exact.version], 1, None, None, g)["data"][0]["y"] for g in (None, worst)]
    assert points[1][0] > 1.3 * points[0][0] and points[1][1] < points[1][0]


@pytest.mark.slow
@pytest.mark.long
def test_two_rooms_share_a_diagnosis_of_the_same_model_on_the_same_data(hidden_session, tmp_path):
    async def story():
        shared = Shared(Stock(most=1))
        try:
            for n in range(2):
                room = Room(str(hidden_session), new_folder(tmp_path, f"s{n}"), "", shared)
                await room.open()
                if n == 0:
                    await room.diagnose()
                    first = room.diagnosis
                else:
                    began = time.process_time()
                    await room.diagnose()
                    assert room.diagnosis is first and room.long._running is None
                    assert time.process_time() - began < 1.0
                room.rest()
                room.close()
        finally:
            shared.stock.close()

    asyncio.run(story())


def test_a_worker_says_what_is_wrong_and_goes_on():
    async def story():
        worker = Worker()
        try:
            with pytest.raises(IrecError, match="no such file"):
                await worker.call(Desk.view, "/nowhere")
            await worker.warm()
        finally:
            worker.close()

    asyncio.run(story())


@pytest.mark.slow
def test_a_long_computation_can_be_cancelled_and_the_worker_works_on(hidden_session, tmp_path):
    async def story():
        worker = Worker()
        try:
            first = await worker.call(Desk.start, str(hidden_session), "", str(tmp_path))
            begun = asyncio.Event()
            computed = worker.call(Desk.diagnosis, str(hidden_session), first.model, progress=lambda share, what: begun.set())
            task = asyncio.create_task(computed)
            await asyncio.wait_for(begun.wait(), 60.0)
            worker.cancel()
            with pytest.raises(Cancelled):
                await asyncio.wait_for(task, 30.0)
            again = await worker.call(Desk.describe, str(hidden_session), first.model, "again")
            assert again.cv_rms_m == pytest.approx(first.cv_rms_m, rel=1e-3)
        finally:
            worker.close()

    asyncio.run(story())


@pytest.mark.slow
def test_a_worker_that_dies_is_reported_and_replaced(hidden_session):
    async def story():
        worker = Worker()
        try:
            await worker.warm()
            task = asyncio.create_task(worker.call(Desk.diagnosis, str(hidden_session), "/nowhere.yaml", progress=quiet))
            await asyncio.sleep(0)
            worker._running.process.kill()
            with pytest.raises(IrecError):
                await asyncio.wait_for(task, 30.0)
            await worker.warm()
        finally:
            worker.close()

    asyncio.run(story())
