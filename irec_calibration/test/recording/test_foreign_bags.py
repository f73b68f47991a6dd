# SPDX-License-Identifier: Apache-2.0
"""Foreign recordings: what they lack is said, none makes a program fail, and where it can be a session is made of one."""

from __future__ import annotations

import json
import re
import struct

import numpy as np
import pytest
import synthetic
import yaml
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.cli import main
from irec_calibration.errors import RecordingError
from irec_calibration.recording import BagReader, BagWriter, TypeCatalogue
from irec_calibration.recording.frames import frame_of
from irec_calibration.recording.survey import survey
from irec_calibration.recording.unpack import check_definition
from irec_calibration.session.mcap_io import attach_session

JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
POINT = "std_msgs/Header header\ngeometry_msgs/Point point\n"
WRENCH = "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
}
TYPES = {
    "sensor_msgs/msg/JointState": JOINT_STATE,
    "geometry_msgs/msg/PointStamped": POINT,
    "geometry_msgs/msg/WrenchStamped": WRENCH,
}


class Foreign(TypeCatalogue):
    """Definitions without installed packages."""

    def definition(self, type_name):
        return TYPES[type_name] + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in PARTS.items())

    def type_hash(self, type_name):
        return ""


def head(t, frame="base"):
    raw = frame.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<iI", int(t), round((t % 1) * 1e9)) + struct.pack("<I", len(raw)) + raw


def padded(data, size):
    return data + bytes(-(len(data) - 4) % size)


def joint_state(t, names, q):
    out = padded(head(t), 4) + struct.pack("<I", len(names))
    for name in names:
        out = padded(out, 4) + struct.pack("<I", len(name) + 1) + name.encode() + b"\0"
    out = padded(padded(out, 4) + struct.pack("<I", len(q)), 8) + struct.pack(f"<{len(q)}d", *q)
    return out + struct.pack("<II", 0, 0)


def vectors(t, *values):
    return padded(head(t), 8) + struct.pack(f"<{len(values)}d", *values)


@pytest.fixture
def bag(tmp_path):
    """A robot that turns its joints, 100 Hz, a tracker, 20 Hz, and a slow force sensor; vendor's joint names."""
    robot = synthetic.Robot(synthetic.urdf())
    names = [f"axis_{k}" for k in "abcdef"]
    with BagWriter(tmp_path / "bag" / "bag_0.mcap", Foreign()) as writer:
        channel = {name: writer.add_topic(topic, name) for name, topic in zip(TYPES, ("/joints", "/points", "/ft"), strict=True)}
        for i in range(1000):
            t = 100.0 + 0.01 * i
            q = np.array([0.3, 0.2, 0.1, 0.4, 0.5, 0.3]) * np.sin(0.8 * (t - 100.0) + np.arange(6))
            writer.write(channel["sensor_msgs/msg/JointState"], joint_state(t, names, q), round(t * 1e9))
            if i % 5 == 0:
                p = 1000.0 * robot.kinematics(q[None]).p_tcp[0]
                writer.write(channel["geometry_msgs/msg/PointStamped"], vectors(t, *p), round(t * 1e9))
            if i % 7 == 0:
                writer.write(channel["geometry_msgs/msg/WrenchStamped"], vectors(t, *range(6)), round(t * 1e9))
    writer.write_bag_metadata()
    (tmp_path / "robot.urdf").write_text(synthetic.urdf())
    return tmp_path / "bag"


def test_rates_are_judged(bag):
    lacking = "\n".join(survey(BagReader(bag)).lacking)
    assert "rate: /ft comes at 14.3 Hz; the procedure needs 100 Hz, a driver gives 250 Hz" in lacking
    assert "rate: /points comes at 20.0 Hz" in lacking
    assert "/joints comes at" not in lacking
    assert "names its joints axis_a" in lacking


@pytest.mark.parametrize("listed", [True, False])
def test_joints_are_asked_for_only_where_the_recording_does_not_say_which_they_are(tmp_path, listed):
    names = [f"axis_{k}" for k in "abcdef"]
    urdf = synthetic.urdf()
    for described in (urdf, re.sub(r"joint_(\d)", lambda m: names[int(m[1]) - 1], urdf)):
        path = tmp_path / f"{described == urdf}.mcap"
        with BagWriter(path, Foreign()) as writer:
            channel = writer.add_topic("/joints", "sensor_msgs/msg/JointState")
            writer.write(channel, joint_state(100.0, ["gripper", *names], np.zeros(7)), 100 * 10**9)
            attach_session(writer, {"robot": {"joint_names": names} if listed else {}}, described)
        asked = any("names its joints" in item for item in survey(BagReader(path)).lacking)
        assert asked == (not listed and described == urdf)


def compressed_by_message(bag, path):
    """The same recording with each message packed by itself, as `ros2 bag record --compression-mode message` leaves it."""
    reader, channels = BagReader(bag), {}
    with BagWriter(path, Foreign()) as writer:
        for message in reader.messages():
            topic = message.topic
            if topic.name not in channels:
                channels[topic.name] = writer.add_topic(topic.name, topic.type_name)
            writer.write(channels[topic.name], zstandard.compress(message.data), message.log_time)
    return path


def test_messages_that_are_compressed_one_by_one_are_refused(bag, tmp_path, capsys):
    path = compressed_by_message(bag, tmp_path / "packed" / "packed_0.mcap")
    index = yaml.safe_load((bag / "metadata.yaml").read_text())
    index["rosbag2_bagfile_information"].update(compression_mode="MESSAGE", relative_file_paths=[path.name])
    index["rosbag2_bagfile_information"].update(compression_format="zstd")
    for place in (path, path.parent):
        assert main(["inspect", str(place)]) == 2
        said = capsys.readouterr().err
        assert "packed_0.mcap is compressed message by message (/joints: zstd); convert it with ros2 bag convert" in said
    (path.parent / "metadata.yaml").write_text(yaml.safe_dump(index))
    assert main(["inspect", str(path.parent)]) == 2
    assert "packed is compressed message by message (zstd); convert it with ros2 bag convert" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a_0.db3", "a_0.mcap.zstd"])
@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("command", ["inspect", "check", "solve"])
def test_other_bags_are_told_to_be_converted_by_each_command(bag, tmp_path, capsys, name, indexed, command):
    place = tmp_path / "a"
    place.mkdir()
    (place / name).write_bytes(b"SQLite format 3\0")
    if indexed:
        index = yaml.safe_load((bag / "metadata.yaml").read_text())
        index["rosbag2_bagfile_information"].update(relative_file_paths=[name])
        (place / "metadata.yaml").write_text(yaml.safe_dump(index))
    for path in (place, place / name):
        assert main([command, str(path)]) == 2
        said = "".join(capsys.readouterr())
        assert name in said and "convert it with ros2 bag convert" in said


def test_forces_in_another_frame_than_the_tool_are_told(bag, tmp_path):
    lacking = "\n".join(survey(BagReader(bag)).lacking)
    assert "frame: /ft is in 'base'; forces of the environment on the robot have to be in 'tool0'" in lacking
    with BagWriter(tmp_path / "right" / "right_0.mcap", Foreign()) as writer:
        raw, process = (writer.add_topic(f"/{name}", "geometry_msgs/msg/WrenchStamped") for name in ("wrench_raw", "wrench"))
        for i in range(1000):
            t = 100.0 + 0.004 * i
            for channel, frame in ((raw, "ft_sensor"), (process, "tool0")):
                writer.write(channel, padded(head(t, frame), 8) + struct.pack("<6d", *range(6)), round(t * 1e9))
    assert not [item for item in survey(BagReader(tmp_path / "right")).lacking if item.startswith("frame:")]


@given(st.binary(max_size=60))
def test_whatever_a_message_holds_its_frame_is_text(data):
    assert isinstance(frame_of(data), str)


def test_a_session_is_made_of_a_foreign_recording(bag, tmp_path, capsys):
    mapping = {
        "format": "irec-align/1",
        "session": {"name": "x", "robot": {"urdf": "robot.urdf", "serial": "S"}, "noise": {"tracker_m": 1e-5}},
        "joints": {"names": [f"axis_{k}" for k in "abcdef"]},
        "marker": {"scale": 0.001},
    }
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    assert main(["import", str(bag), "--map", str(tmp_path / "map.yaml"), "-o", str(tmp_path / "session")]) == 0
    capsys.readouterr()
    assert main(["check", str(tmp_path / "session")]) == 0
    del mapping["joints"]["names"][0]
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    assert main(["import", str(bag), "--map", str(tmp_path / "map.yaml"), "-o", str(tmp_path / "other")]) == 2
    said = capsys.readouterr().err
    assert "5 joints are recorded" in said
    assert "irec inspect" in said


def test_a_recording_cut_at_any_place_is_described(bag, tmp_path, capsys):
    data = (bag / "bag_0.mcap").read_bytes()
    for cut in np.linspace(9, len(data) - 40, 20).astype(int):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:cut])
        assert main(["inspect", str(path), "--json"]) == 1, cut
        assert json.loads(capsys.readouterr().out)["losses"], cut


def test_what_the_file_says_about_itself_is_what_metadata_yaml_says(bag):
    reader = BagReader(bag)
    list(reader.messages())
    inside = yaml.safe_load(reader.metadata["rosbag2"]["serialized_metadata"])
    beside = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert inside == beside
    assert inside["message_count"] == 1000 + 200 + 143


def test_a_folder_does_not_lead_elsewhere(bag):
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("- bag_0.mcap", "- ../bag_0.mcap"))
    with pytest.raises(RecordingError, match="only files beside it are read"):
        BagReader(bag)


def chunk(plain, announced):
    packed = zstandard.compress(plain)
    body = struct.pack("<QQQI", 0, 1, announced, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    return b"\x06" + struct.pack("<Q", len(body)) + body


@pytest.mark.parametrize(
    ("plain", "announced", "said"),
    [
        (bytes(30_000_000), 30_000_000, "would inflate|records of kind 0"),
        (bytes(900_000), 900_000, "records of kind 0"),
        (bytes(10), 2**40, "would inflate"),
        ((b"\x07" + bytes(8)) * 5000, 45000, "records of kind 7"),
        (b"\x05" + struct.pack("<Q", 2**60), 9, "begins 0 bytes before its end"),
        (bytes(100), 90, "it holds more bytes"),
    ],
)
def test_a_chunk_that_inflates_or_lies_is_a_loss_and_no_work(tmp_path, plain, announced, said):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + chunk(plain, announced) * 3)
    found = survey(BagReader(path))
    assert any(re.search(said, loss) for loss in found.losses), found.losses


@pytest.mark.parametrize("text", ["a/B[] x\n===\nMSG: a/B\n", "float64[99999999999] x\n", "a/B[5] x\n===\nMSG: a/B\nint32 X=1\n"])
def test_definitions_whose_decoding_need_not_end_are_refused(text):
    with pytest.raises(ValueError, match="definition"):
        check_definition(text.encode())


def test_the_definition_of_a_service_event_is_that_of_rosbag2(tmp_path):
    for package, kind, name, text in (
        ("std_srvs", "srv", "SetBool.srv", "bool data # on or off\n---\nbool success\nstring message\n"),
        ("service_msgs", "msg", "ServiceEventInfo.msg", "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\n"),
        ("builtin_interfaces", "msg", "Time.msg", "int32 sec\nuint32 nanosec\n"),
    ):
        folder = tmp_path / package / kind
        folder.mkdir(parents=True)
        (folder / name).write_text(text)
    found = TypeCatalogue(lambda package: tmp_path / package).definition("std_srvs/srv/SetBool_Event")
    assert found.startswith("service_msgs/msg/ServiceEventInfo info\nstd_srvs/srv/SetBool_Request[<=1] request\n")
    for heading in ("std_srvs/srv/SetBool_Request", "std_srvs/srv/SetBool_Response", "service_msgs/ServiceEventInfo",
                    "builtin_interfaces/Time"):  # fmt: skip
        assert f"MSG: {heading}\n" in found
