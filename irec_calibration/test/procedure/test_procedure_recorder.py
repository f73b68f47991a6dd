# SPDX-License-Identifier: Apache-2.0
"""The recording of a run, and going on with one that was broken off."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.errors import SessionError
from irec_calibration.procedure.recorder import SessionRecorder, _seed_of
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
