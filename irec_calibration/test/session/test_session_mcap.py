# SPDX-License-Identifier: Apache-2.0
"""The MCAP form of a session against its table form."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.cli import main
from irec_calibration.errors import SessionError
from irec_calibration.recording import BagReader, BagWriter
from irec_calibration.session import Session, read_session, record_message, write_table
from irec_calibration.session.mcap_io import read_mcap, write_mcap

MESSAGE = Path(__file__).parents[3] / "irec_msgs" / "msg" / "LoadCaseRecord.msg"


def assert_same(a: Session, b: Session) -> None:
    for f in fields(Session):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if f.name in ("path", "notes", "meta"):
            continue
        if f.name == "robot":
            assert x.urdf_text == y.urdf_text
        elif isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y, err_msg=f.name)
        elif isinstance(x, dict) and x and isinstance(next(iter(x.values())), np.ndarray):
            assert x.keys() == y.keys()
            for key in x:
                np.testing.assert_array_equal(x[key], y[key], err_msg=f"{f.name}.{key}")
        else:
            assert x == y, f.name


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A table of four poses with an external axis, temperatures (one of them missing once), and full-length numbers."""
    folder = write_table(synthetic.session(4), tmp_path / "table")
    rng = np.random.default_rng(0)
    lines = (folder / "samples.csv").read_text().splitlines()
    extra = [f",{rng.normal()!r},{20 + rng.random()!r}" for _ in lines[1:]]
    extra[3] = extra[3].rpartition(",")[0] + ","
    lines = [lines[0] + ",ext_rail,temp_ambient", *(a + b for a, b in zip(lines[1:], extra, strict=True))]
    (folder / "samples.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_a_table_survives_the_way_to_mcap_and_back(table: Path, tmp_path: Path) -> None:
    assert main(["import", str(table), "-o", str(tmp_path / "a.mcap")]) == 0
    assert main(["export", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "back")]) == 0
    assert_same(read_session(table), read_session(tmp_path / "a.mcap"))
    assert_same(read_session(table), read_session(tmp_path / "back"))


def test_the_header_survives_with_keys_that_nobody_reads(table: Path, tmp_path: Path) -> None:
    path = table / "session.yaml"
    path.write_text(path.read_text() + "\nweather: fair\n")
    back = write_table(read_mcap(write_mcap(read_session(table), tmp_path / "a.mcap")), tmp_path / "back")
    assert read_session(back).meta["weather"] == "fair"


def test_a_truncated_recording_gives_what_is_whole_and_names_what_is_lost(tmp_path: Path) -> None:
    session = synthetic.session(400)
    whole = write_mcap(session, tmp_path / "whole.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(0.7 * len(whole))])
    part = read_mcap(cut)
    assert 0 < len(part) < len(session)
    assert any("lost" in note for note in part.notes)
    np.testing.assert_array_equal(part.q, session.q[: len(part)])


def test_a_recording_cut_before_the_first_row_is_refused_with_the_reason(tmp_path: Path) -> None:
    whole = write_mcap(synthetic.session(4), tmp_path / "whole.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: whole.index(b"</robot>") + 30])
    with pytest.raises(SessionError, match="cut at byte|without an end mark"):
        read_mcap(cut)


def test_a_foreign_recording_is_refused_by_name_of_what_is_missing(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "foreign.mcap", record_message.Catalogue()) as bag:
        bag.add_topic(record_message.TOPIC, record_message.TYPE)
    with pytest.raises(SessionError, match=r"session\.yaml is not attached"):
        read_session(tmp_path / "foreign.mcap")


def test_of_a_pose_that_was_begun_again_only_the_last_attempt_counts(tmp_path: Path) -> None:
    session = synthetic.session(2)
    first = write_mcap(session, tmp_path / "first.mcap")
    messages = list(BagReader(first).messages())
    bag = BagReader(first)
    list(bag.messages())
    again = tmp_path / "again.mcap"
    with BagWriter(again, record_message.Catalogue()) as out:
        for name, data in bag.attachments.items():
            out.attach(name, data)
        channel = out.add_topic(record_message.TOPIC, record_message.TYPE)
        for message in messages[:3] + messages:  # pose 1 was broken off after two load cases
            out.write(channel, message.data, message.log_time)
    read = read_mcap(again)
    assert_same(read, read_mcap(first))
    assert any("begun again" in note for note in read.notes)


def test_the_definition_written_without_ros_is_that_of_irec_msgs() -> None:
    code = [" ".join(line.split("#")[0].split()) for line in MESSAGE.read_text().splitlines()]
    own = record_message.Catalogue().definition(record_message.TYPE).split("=" * 80)[0].splitlines()
    assert own == [line for line in code if line]
