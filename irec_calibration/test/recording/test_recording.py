# SPDX-License-Identifier: Apache-2.0
"""Recordings are written so that rosbag2 can read them, and read whatever their condition."""

import os
import signal
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from irec_calibration.errors import RecordingError
from irec_calibration.recording import BagReader, BagWriter, TypeCatalogue
from irec_calibration.recording.survey import survey

TEXTS = {
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/PointStamped": "# a point\n\nstd_msgs/Header header\nPoint point # [m]\n",
    "test_msgs/msg/Mixed": "uint8 A=1\nstring<=8 name\ngeometry_msgs/Point[<=3] points\nfloat64[6] values\nPart[] parts\n",
    "test_msgs/msg/Part": "int32 value 7\n",
}
SECOND = 1_000_000_000
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@pytest.fixture
def catalogue(tmp_path: Path) -> TypeCatalogue:
    """A catalogue of a few installed types, as interface packages install them."""
    return install_types(tmp_path / "share")


def install_types(share: Path) -> TypeCatalogue:
    for name, text in TEXTS.items():
        package, _, kind = name.split("/")
        folder = share / package / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{kind}.msg").write_text(text)
    hashes = '{"type_hashes": [{"type_name": "geometry_msgs/msg/Point", "hash_string": "RIHS01_beef"}]}'
    (share / "geometry_msgs" / "msg" / "Point.json").write_text(hashes)
    return TypeCatalogue(lambda package: share / package)


def point_stamped(stamp_ns: int, x: float) -> bytes:
    """CDR of a PointStamped with frame 'A', as a middleware serializes it."""
    head = struct.pack("<4xiII2s2x", stamp_ns // SECOND, stamp_ns % SECOND, 2, b"A\0")
    body = struct.pack("<3d", x, 2.0, 3.0)
    return b"\x00\x01\x00\x00" + head[4:] + body


def record(path: Path, catalogue: TypeCatalogue, count: int = 3000) -> Path:
    with BagWriter(path, catalogue) as writer:
        channel = writer.add_topic("/tracker/point", "geometry_msgs/msg/PointStamped")
        writer.attach("robot.urdf", b"<robot/>")
        writer.add_metadata("irec", {"version": "1"})
        for k in range(count):
            stamp = 100 * SECOND + k * 10_000_000
            writer.write(channel, point_stamped(stamp, float(k)), stamp + 2_000_000)
    return path


def test_a_recording_comes_back_message_by_message(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    bag = BagReader(record(tmp_path / "a.mcap", catalogue))
    values = [bag.decode(message).point.x for message in bag.messages()]
    assert values == [float(k) for k in range(3000)]
    assert bag.losses == []


def test_attachments_and_metadata_come_back(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    bag = BagReader(record(tmp_path / "a.mcap", catalogue, 1))
    list(bag.messages())
    assert bag.attachments == {"robot.urdf": b"<robot/>"}
    assert bag.metadata["irec"] == {"version": "1"}


def test_a_definition_carries_every_type_in_it_once(catalogue: TypeCatalogue) -> None:
    text = catalogue.definition("test_msgs/msg/Mixed")
    blocks = text.split("=" * 80 + "\n")
    assert [block.splitlines()[0] for block in blocks[1:]] == ["MSG: geometry_msgs/Point", "MSG: test_msgs/Part"]


def test_the_hash_of_a_type_is_the_installed_one(catalogue: TypeCatalogue) -> None:
    assert catalogue.type_hash("geometry_msgs/msg/Point") == "RIHS01_beef"


def test_a_type_that_is_not_installed_is_named(catalogue: TypeCatalogue) -> None:
    with pytest.raises(RecordingError, match=r"geometry_msgs/msg/Missing"):
        catalogue.definition("geometry_msgs/msg/Missing")


def test_a_recording_is_never_overwritten(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    path = record(tmp_path / "a.mcap", catalogue, 1)
    with pytest.raises(RecordingError, match="exists"):
        BagWriter(path, catalogue)


def test_one_topic_can_not_have_two_types(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    with BagWriter(tmp_path / "a.mcap", catalogue) as writer:
        writer.add_topic("/x", "geometry_msgs/msg/Point")
        with pytest.raises(RecordingError, match="/x"):
            writer.add_topic("/x", "geometry_msgs/msg/PointStamped")


def test_the_folder_becomes_a_bag_with_the_counts_of_its_topics(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    writer = BagWriter(tmp_path / "bag" / "bag_0.mcap", catalogue)
    channel = writer.add_topic("/p", "geometry_msgs/msg/Point")
    writer.write(channel, bytes(28), 5 * SECOND)
    writer.write(channel, bytes(28), 7 * SECOND)
    writer.close()
    information = yaml.safe_load(writer.write_bag_metadata().read_text())["rosbag2_bagfile_information"]
    assert information["message_count"] == 2
    assert information["duration"] == {"nanoseconds": 2 * SECOND}
    topic = information["topics_with_message_count"][0]
    assert topic["topic_metadata"]["type_description_hash"] == "RIHS01_beef"
    assert topic["topic_metadata"]["offered_qos_profiles"][0]["reliability"] == "reliable"


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_of_a_truncated_recording_a_run_from_the_start_is_read_and_the_loss_is_named(
    tmp_path: Path, catalogue: TypeCatalogue, share: float
) -> None:
    whole = record(tmp_path / "a.mcap", catalogue).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(share * len(whole))])
    bag = BagReader(cut)
    values = [bag.decode(message).point.x for message in bag.messages()]
    assert 0 < len(values) < 3000
    assert values == [float(k) for k in range(len(values))]
    assert len(bag.losses) == 1
    assert "cut.mcap" in bag.losses[0]


def test_a_damaged_chunk_is_left_out_and_the_others_are_read(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    data = bytearray(record(tmp_path / "a.mcap", catalogue).read_bytes())
    second_chunk = data.index(ZSTD_MAGIC, data.index(ZSTD_MAGIC) + 1)
    data[second_chunk + 200] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    bag = BagReader(tmp_path / "bad.mcap")
    count = sum(1 for _ in bag.messages())
    assert 0 < count < 3000
    assert any("damaged" in loss and "s to" in loss for loss in bag.losses)


def test_a_file_that_is_not_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"not a recording")
    with pytest.raises(RecordingError, match=r"x\.mcap"):
        list(BagReader(tmp_path / "x.mcap").messages())


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no \.mcap"):
        BagReader(tmp_path)


def test_a_killed_writer_loses_at_most_the_open_chunk(tmp_path: Path) -> None:
    program = f"""
        import sys, time
        from pathlib import Path
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from test_recording import install_types, point_stamped, BagWriter
        writer = BagWriter(Path({str(tmp_path / "k.mcap")!r}), install_types(Path({str(tmp_path / "share")!r})))
        channel = writer.add_topic("/p", "geometry_msgs/msg/PointStamped")
        for k in range(5000):
            writer.write(channel, point_stamped(k, float(k)), k)
        while writer.message_count < 5000:
            time.sleep(0.01)
        time.sleep(0.1)  # the flush that follows the last message of a batch
        print("written", flush=True)
        time.sleep(60)
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"written\n"
        process.send_signal(signal.SIGKILL)
    bag = BagReader(tmp_path / "k.mcap")
    count = sum(1 for _ in bag.messages())
    assert count >= 5000 - 64 * 1024 // len(point_stamped(0, 0.0))
    assert bag.losses


def test_the_survey_finds_a_gap_and_the_lag_of_the_log_time(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    with BagWriter(tmp_path / "a.mcap", catalogue) as writer:
        channel = writer.add_topic("/p", "geometry_msgs/msg/PointStamped")
        for k in [*range(100), *range(150, 200)]:
            writer.write(channel, point_stamped(SECOND + k * 10_000_000, 0.0), SECOND + k * 10_000_000 + 3_000_000)
    topic = survey(BagReader(tmp_path / "a.mcap")).topics[0]
    assert topic.gap_count == 1
    assert topic.gaps[0].length == pytest.approx(0.51)
    assert topic.skew is not None
    assert topic.skew.median == pytest.approx(3e-3)


def test_the_survey_finds_stamps_out_of_order_and_repeated(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    with BagWriter(tmp_path / "a.mcap", catalogue) as writer:
        channel = writer.add_topic("/p", "geometry_msgs/msg/PointStamped")
        for k, stamp in enumerate([1, 2, 4, 3, 5, 5, 6]):
            writer.write(channel, point_stamped(stamp * SECOND, 0.0), k * SECOND)
    topic = survey(BagReader(tmp_path / "a.mcap")).topics[0]
    assert (topic.backwards, topic.repeated) == (1, 1)


def test_the_survey_says_when_messages_come_in_bursts(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    with BagWriter(tmp_path / "a.mcap", catalogue) as writer:
        channel = writer.add_topic("/p", "geometry_msgs/msg/PointStamped")
        for burst in range(20):
            for k in range(3):
                stamp = SECOND + burst * SECOND // 3 + k * 100_000
                writer.write(channel, point_stamped(stamp, 0.0), stamp)
    assert survey(BagReader(tmp_path / "a.mcap")).topics[0].bursts


def test_the_survey_says_what_a_session_still_needs(tmp_path: Path, catalogue: TypeCatalogue) -> None:
    found = survey(BagReader(record(tmp_path / "a.mcap", catalogue, 10)))
    assert any("marker positions" in sentence for sentence in found.present)
    assert any("joint angles" in sentence for sentence in found.lacking)
    assert any("LoadCaseRecord" in sentence for sentence in found.lacking)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 0.999), st.integers(0, 255)), min_size=1, max_size=5), st.floats(0.3, 1.0))
def test_whatever_is_wrong_with_a_file_it_is_read_or_refused_in_one_sentence(
    tmp_path: Path, catalogue: TypeCatalogue, changes: list[tuple[float, int]], kept: float
) -> None:
    source = tmp_path / "whole.mcap"
    if not source.exists():
        record(source, catalogue, 600)
    data = bytearray(source.read_bytes())
    for place, value in changes:
        data[int(place * len(data))] = value
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data[: int(kept * len(data))])
    try:
        count = sum(1 for _ in BagReader(broken).messages())
    except RecordingError as error:
        assert "broken.mcap" in str(error)
    else:
        assert count <= 600
