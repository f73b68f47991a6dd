# SPDX-License-Identifier: Apache-2.0
"""The recording of a run, and going on with one that was broken off."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.errors import CellError, RecordingError, SessionError
from irec_calibration.procedure.recorder import SessionRecorder, _seed_of, refuse_changed
from irec_calibration.recording import BagReader
from irec_calibration.session import read_session, record_message

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
CATALOGUE = record_message.Catalogue()


def recorder(path: Path, resume: bool = False) -> SessionRecorder:
    return SessionRecorder(path, CELL, {"cell": "afp"}, CATALOGUE, resume)


def write_pose(r: SessionRecorder, pose: int, cases: int = 5, complete: bool = True, time: float = 0.0) -> None:
    for j in range(cases + 1):
        force = [0.0, 0.0, 0.0] if j == 0 else CELL.forces_in_tool[j - 1].tolist()
        data = record_message.encode(
            stamp_ns=0, time=time + pose + 0.1 * j, pose=pose, load_case=j, repeat=0,
            joint_names=[*CELL.robot.joint_names, "ext_rail"], joint_position=[*CELL.home.tolist(), 0.1 * pose],
            joint_target=[], p_tcp_in_base=[1.0, 0.0, 1.0],
            p_marker_in_station=[3.0, 0.0, 1e-6 * j], marker="", station="A", wrench_in_tool=[*force, 0.0, 0.0, 0.0],
            temperature_names=["temp_ambient"], temperature=[20.0],
        )  # fmt: skip
        r.write_row(data, 0)
    if complete:
        r.write_event({"kind": "complete", "pose": pose, "repeat": 0, "load_case": 0, "text": ""}, 0)


def test_a_recording_is_a_session_of_its_cell(tmp_path: Path) -> None:
    r = recorder(tmp_path / "s.mcap")
    write_pose(r, 1)
    r.close()
    session = read_session(tmp_path / "s.mcap")
    assert session.serial == CELL.serial
    assert session.robot.sha256 == CELL.robot.sha256
    assert session.case_name(2) == "N"
    np.testing.assert_allclose(session.force_in_tool[1:], CELL.forces_in_tool)
    assert session.ext_axes[0].name == "rail" and session.ext["rail"][0] == 0.1
    assert session.noise.tracker_m == CELL.noise["tracker_m"]
    assert session.markers[0].xyz == tuple(CELL.marker_in_tool)


def copied(folder: Path) -> Cell:
    """The cell from files of its own."""
    text = CELL.path.read_text().replace("../robots/", "")
    (folder / "mine.yaml").write_text(text)
    (folder / Path(CELL.robot.source).name).write_text(CELL.robot.urdf_text)
    return read_cell(folder / "mine.yaml")


def test_the_recording_has_the_cell_file_that_was_read_and_not_what_is_there_now(tmp_path: Path) -> None:
    cell = copied(tmp_path)
    then = cell.path.read_text()
    cell.path.write_text(then.replace("force_abort_n: 1600.0", "force_abort_n: 1200.0"))
    SessionRecorder(tmp_path / "s.mcap", cell, {}, CATALOGUE).close()
    reader = BagReader(tmp_path / "s.mcap")
    assert list(reader.messages()) == [] and reader.attachments["cell.yaml"].decode() == then


def test_no_run_begins_with_a_cell_file_or_a_robot_description_that_is_another_now(tmp_path: Path) -> None:
    cell = copied(tmp_path)
    refuse_changed(cell)
    for path in (cell.path, Path(cell.robot.source)):
        then = path.read_text()
        path.write_text(then.replace("\n", "\n# lower\n", 1))
        with pytest.raises(CellError, match=rf"{path.name}:2: the .* was changed after this node had read it.*start the node"):
            refuse_changed(cell)
        path.write_text(then)
    refuse_changed(cell)
    cell.path.unlink()
    with pytest.raises(CellError, match="mine.yaml"):
        refuse_changed(cell)


def test_a_resumed_run_knows_what_is_complete_and_keeps_it(tmp_path: Path) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    write_pose(first, 2, cases=2, complete=False)
    first.close()
    second = recorder(tmp_path / "s.mcap", resume=True)
    assert second.done == {(1, 0)}
    assert second.time_offset > 2.2
    write_pose(second, 2, time=second.time_offset)
    second.close()
    session = read_session(tmp_path / "s.mcap")
    assert len(session) == 12
    assert session.stamp[session.pose == 2].min() > session.stamp[session.pose == 1].max()
    assert list(tmp_path.iterdir()) == [tmp_path / "s.mcap"]


EVENTS = ["[" * 3000, "5", '{"kind": "complete", "pose": 1e999, "repeat": 0}', '{"kind": "complete", "pose": "x"}']


@pytest.mark.parametrize("event", EVENTS)
def test_a_recording_with_an_event_of_somebody_else_is_not_gone_on_with_and_stays_as_it_is(tmp_path: Path, event: str) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    first.bag.write(first._events, record_message.encode_event(event), 0)
    first.close()
    before = (tmp_path / "s.mcap").read_bytes()
    with pytest.raises(SessionError, match="an event in it can't be read"):
        recorder(tmp_path / "s.mcap", resume=True)
    assert (tmp_path / "s.mcap").read_bytes() == before
    assert list(tmp_path.iterdir()) == [tmp_path / "s.mcap"]


def test_the_order_of_the_load_cases_goes_on_and_a_header_that_explodes_is_not_read(tmp_path: Path) -> None:
    first = SessionRecorder(tmp_path / "s.mcap", CELL, {}, CATALOGUE, order_seed=11)
    first.close()
    second = SessionRecorder(tmp_path / "s.mcap", CELL, {}, CATALOGUE, resume=True, order_seed=12)
    second.close()
    assert second.order_seed == 11
    bomb = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join(9 * [f'*a{i - 1}'])}]\n" for i in range(1, 40))
    old = SimpleNamespace(attachments={"session.yaml": bomb.encode()}, messages=lambda: iter(()))
    assert _seed_of(old, 12) == 12  # type: ignore[arg-type]


def test_a_run_that_was_killed_can_be_resumed(tmp_path: Path) -> None:
    first = recorder(tmp_path / "whole.mcap")
    for pose in range(1, 200):
        write_pose(first, pose)
    first.close()
    whole = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "s.mcap").write_bytes(whole[: int(0.7 * len(whole))])
    second = recorder(tmp_path / "s.mcap", resume=True)
    assert second.losses
    assert 10 < len(second.done) < 199
    second.close()
    assert {(p, 0) for p in read_session(tmp_path / "s.mcap").poses.tolist()} >= second.done


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    recorder(tmp_path / "s.mcap").close()
    with pytest.raises(SessionError, match="exists already"):
        recorder(tmp_path / "s.mcap")


def test_resuming_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="no recording to go on with"):
        recorder(tmp_path / "s.mcap", resume=True)


def test_a_pose_that_was_discarded_is_no_part_of_the_session_and_is_measured_again(tmp_path: Path) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    write_pose(first, 2, complete=False)
    told = {"kind": "discarded", "pose": 2, "repeat": 0, "load_case": 5, "text": "the sensor's bias has changed"}
    first.write_event(told, 0)
    first.close()
    session = read_session(tmp_path / "s.mcap")
    assert session.poses.tolist() == [1] and any("pose 2: the sensor's bias has changed" in note for note in session.notes)
    second = recorder(tmp_path / "s.mcap", resume=True)
    assert second.done == {(1, 0)}
    write_pose(second, 2, time=second.time_offset)
    second.close()
    assert read_session(tmp_path / "s.mcap").poses.tolist() == [1, 2]


# --- one process, one cell, one file --------------------------------------------------------------------------------------------


def test_a_recording_that_is_under_way_can_not_be_gone_on_with_by_another(tmp_path: Path) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    inode = os.stat(tmp_path / "s.mcap").st_ino
    with pytest.raises(RecordingError, match="is being recorded by another process"):
        recorder(tmp_path / "s.mcap", resume=True)
    assert os.stat(tmp_path / "s.mcap").st_ino == inode and list(tmp_path.iterdir()) == [tmp_path / "s.mcap"]
    first.close()
    second = recorder(tmp_path / "s.mcap", resume=True)
    with pytest.raises(RecordingError, match="is being recorded by another process"):
        recorder(tmp_path / "s.mcap", resume=True)
    second.close()
    assert len(read_session(tmp_path / "s.mcap")) == 6


OTHER: dict[str, tuple[Any, str]] = {
    "marker": (replace(CELL, marker_in_tool=CELL.marker_in_tool + [0.0, 0.05, 0.0]), r"marker_in_tool0\[1\] 0.0, .* says 0.05"),
    "forces": (replace(CELL, forces_in_tool=0.5 * CELL.forces_in_tool), r"load_cases\.1\[\d\] -?\d+.0, .* says -?\d+.0"),
    "tool": (replace(CELL, raw={**CELL.raw, "tool": {**CELL.raw["tool"], "name": "another"}}), "tool nothing, .* says 'another'"),
    "serial": (replace(CELL, serial="another"), r"robot\.serial 'KR120-0001', .* says 'another'"),
}


@pytest.mark.parametrize("what", OTHER)
def test_a_run_is_not_gone_on_with_under_a_cell_file_that_gives_rows_another_meaning(tmp_path: Path, what: str) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    first.close()
    before = (tmp_path / "s.mcap").read_bytes()
    cell, told = OTHER[what]
    with pytest.raises(SessionError, match=told):
        SessionRecorder(tmp_path / "s.mcap", cell, {}, CATALOGUE, resume=True)
    assert (tmp_path / "s.mcap").read_bytes() == before and list(tmp_path.iterdir()) == [tmp_path / "s.mcap"]


def test_a_moved_station_is_another_meaning(tmp_path: Path) -> None:
    recorder(tmp_path / "s.mcap").close()
    stations = [{**CELL.raw["stations"][0], "xyz": [0.0, -4.1, 2.2]}]
    with pytest.raises(SessionError, match=r"stations\[0\]\.xyz\[1\] -4.0, .* says -4.1"):
        SessionRecorder(tmp_path / "s.mcap", replace(CELL, raw={**CELL.raw, "stations": stations}), {}, CATALOGUE, resume=True)


def test_the_stated_noise_may_be_another_one(tmp_path: Path) -> None:
    recorder(tmp_path / "s.mcap").close()
    cell = replace(CELL, noise={**CELL.noise, "force_n": 2.0})
    SessionRecorder(tmp_path / "s.mcap", cell, {}, CATALOGUE, resume=True).close()


def test_pose_numbers_that_stand_for_other_places_are_refused(tmp_path: Path) -> None:
    first = recorder(tmp_path / "s.mcap")
    write_pose(first, 1)
    first.close()
    here = np.array([*CELL.home, 0.1])
    SessionRecorder(tmp_path / "s.mcap", CELL, {}, CATALOGUE, resume=True, planned={1: here, 7: here}).close()
    before = (tmp_path / "s.mcap").read_bytes()
    with pytest.raises(SessionError, match="pose 1 was measured with axis 2 at -1.900, the pose list has it at -1.400"):
        SessionRecorder(tmp_path / "s.mcap", CELL, {}, CATALOGUE, resume=True, planned={1: here + 0.5 * np.eye(7)[1]})
    assert (tmp_path / "s.mcap").read_bytes() == before


def test_topics_that_are_added_at_any_time_are_no_change_by_somebody_else(tmp_path: Path) -> None:
    r = recorder(tmp_path / "s.mcap")
    for k in range(300):
        write_pose(r, k + 1)
        r.add_topic(f"/topic_{k}", record_message.EVENT_TYPE)
        if k % 100 == 0:
            written(r)
    r.close()
    assert len(read_session(tmp_path / "s.mcap").poses) == 300


def until_it_fails(r: SessionRecorder) -> str:
    """Records on until that is refused; the reason."""
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        try:
            write_pose(r, 2)
        except RecordingError as error:
            return str(error)
        time.sleep(0.01)
    raise TimeoutError("ten seconds and nobody has noticed")


def written(r: SessionRecorder) -> None:
    """Wait until the file has grown beyond its attachments."""
    end = time.monotonic() + 10.0
    while not r.path.stat().st_size:
        if time.monotonic() > end:
            raise TimeoutError("nothing is written")
        time.sleep(0.01)


def test_a_recording_whose_file_is_removed_is_told_and_kept_under_another_name(tmp_path: Path) -> None:
    r = recorder(tmp_path / "s.mcap")
    write_pose(r, 1)
    written(r)
    (tmp_path / "s.mcap").unlink()
    assert "removed or replaced while it was recorded" in until_it_fails(r)
    with pytest.raises(RecordingError, match="what was recorded is in .*s_rescued_1.mcap"):
        r.close()
    assert 1 in read_session(tmp_path / "s_rescued_1.mcap").poses


CHANGES: list[Callable[[Path], object]] = [lambda p: os.truncate(p, 1000), lambda p: os.truncate(p, 10_000_000)]


@pytest.mark.parametrize("change", CHANGES)
def test_a_recording_that_somebody_else_cuts_or_writes_to_is_told(tmp_path: Path, change: Callable[[Path], object]) -> None:
    r = recorder(tmp_path / "s.mcap")
    write_pose(r, 1)
    written(r)
    change(tmp_path / "s.mcap")
    assert "somebody else has written to it or cut it" in until_it_fails(r)
    with pytest.raises(RecordingError, match="is incomplete"):
        r.close()


def test_a_session_notes_that_its_run_could_not_verify_the_scale_of_the_force(tmp_path: Path) -> None:
    run = recorder(tmp_path / "s.mcap")
    told = {"kind": "unverified", "pose": 0, "repeat": 0, "load_case": 0, "text": "the scale could not be verified"}
    run.write_event(told, 0)
    write_pose(run, 1)
    run.write_event(told, 0)
    run.close()
    assert read_session(tmp_path / "s.mcap").notes.count("the scale could not be verified") == 1
