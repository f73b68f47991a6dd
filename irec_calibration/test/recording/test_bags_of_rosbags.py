# SPDX-License-Identifier: Apache-2.0
"""Bags that another library has written, whole and broken: inspect and import describe each of them and fail on none; and that
library reads ours as rosbag2 would."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic
import yaml
from irec_calibration.cli import main
from irec_calibration.recording import BagReader, BagWriter
from irec_calibration.recording.survey import survey
from irec_calibration.recording.writer import Qos
from test_foreign_bags import Foreign, joint_state

pytest.importorskip("rosbags", reason="rosbags is missing: run `make test`")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
ROBOT = synthetic.Robot(synthetic.urdf())
NAMES = [f"axis_{k}" for k in "abcdef"]


def header(store: Any, t: float, frame: str = "tracker") -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
    given = {"seq": 0} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **given)


def messages(store: Any, n: int = 60) -> list[tuple[str, str, int, Any]]:
    """Topic, type, log time, message: a robot that turns and a tracker that follows."""
    types, out = store.types, []
    for i in range(n):
        t = 100.0 + 0.02 * i
        q = 0.3 * np.sin(0.8 * (t - 100.0) + np.arange(6))
        none = np.zeros(0)
        out.append(("/joint_states", "sensor_msgs/msg/JointState", round(t * 1e9),
                    types["sensor_msgs/msg/JointState"](header(store, t), NAMES, q, none, none)))  # fmt: skip
        p = 1000.0 * ROBOT.kinematics(q[None]).p_tcp[0]
        point = types["geometry_msgs/msg/Point"](*map(float, p))
        out.append(("/leica/point", "geometry_msgs/msg/PointStamped", round(t * 1e9),
                    types["geometry_msgs/msg/PointStamped"](header(store, t), point)))  # fmt: skip
    return out


def write2(path: Path, content: list[tuple[str, str, int, Any]], store: Any = ROS2, **options: Any) -> Path:
    mode, form = options.pop("mode", None), options.pop("form", CompressionFormat.ZSTD)
    writer = Writer2(path, version=options.pop("version", 9), storage_plugin=options.pop("plugin", StoragePlugin.MCAP))
    if mode is not None:
        writer.set_compression(mode, form)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, at, message in content:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], at, store.serialize_cdr(message, kind))
    return path


def write1(path: Path, compression: Any = None) -> Path:
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, at, message in messages(ROS1):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], at, ROS1.serialize_ros1(message, kind))
    return path


def cut(path: Path, share: float) -> Path:
    """The largest file of a bag, cut off."""
    file = max([path] if path.is_file() else [f for f in path.iterdir() if f.suffix != ".yaml"], key=lambda f: f.stat().st_size)
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    return path


def with_index(path: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    index = path / "metadata.yaml"
    data = yaml.safe_load(index.read_text())
    change(data["rosbag2_bagfile_information"])
    index.write_text(yaml.safe_dump(data))
    return path


def without_index(path: Path) -> Path:
    (path / "metadata.yaml").unlink()
    return path


def text(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def own_types(path: Path) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("float64[3] point\nstring station\n", "lab_msgs/msg/Spot"))
    spot = store.types["lab_msgs/msg/Spot"](np.array([1.0, 2.0, 3.0]), "A")
    return write2(path, [("/spot", "lab_msgs/msg/Spot", 10**9 * k, spot) for k in range(5)], store)


def images(path: Path) -> Path:
    kind = "sensor_msgs/msg/Image"
    image = ROS2.types[kind](header(ROS2, 1.0), 2, 2, "mono8", 0, 2, np.zeros(4, np.uint8))
    return write2(path, [("/camera", kind, 10**9 * k, image) for k in range(5)])


def without_names(path: Path) -> Path:
    content = messages(ROS2)
    for _, kind, _, message in content:
        if kind.endswith("JointState"):
            message.name = []
    return write2(path, content)


def without_stamps(path: Path) -> Path:
    content = messages(ROS2)
    for *_, message in content:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    return write2(path, content)


def garbled(path: Path) -> Path:
    write2(path, messages(ROS2))
    file = next(path.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    rng = np.random.default_rng(4)
    for at in rng.integers(100, len(data) - 100, 300):
        data[at] = int(rng.integers(256))
    file.write_bytes(bytes(data))
    return path


def ros1_in_mcap(path: Path) -> Path:
    """MCAP whose messages are encoded as ROS 1 does."""
    from mcap.writer import Writer

    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros1")
    schema = writer.register_schema("sensor_msgs/JointState", "ros1msg", b"Header header\nstring[] name\nfloat64[] position\n")
    channel = writer.register_channel("/joint_states", "ros1", schema)
    writer.add_message(channel, 10**9, struct.pack("<IIII", 0, 1, 0, 0) + bytes(8), 10**9)
    writer.finish()
    return text(path, out.getvalue())


COMPRESSED = {"mode": CompressionMode.FILE}
BAGS: dict[str, tuple[Callable[[Path], Path], str]] = {  # how it is made, part of what has to be said
    "ROS 1": (lambda p: write1(p / "a.bag"), "is no .mcap file; convert it"),
    "ROS 1, bz2": (lambda p: write1(p / "a.bag", Writer1.CompressionFormat.BZ2), "is no .mcap file; convert it"),
    "ROS 1, truncated": (lambda p: cut(write1(p / "a.bag"), 0.4), "is no .mcap file; convert it"),
    "ROS 1 in MCAP": (lambda p: ros1_in_mcap(p / "a.mcap"), "It lacks"),
    "SQLite": (lambda p: write2(p / "b", messages(ROS2), plugin=StoragePlugin.SQLITE3), "without MCAP"),
    "SQLite, truncated": (lambda p: cut(write2(p / "b", messages(ROS2), plugin=StoragePlugin.SQLITE3), 0.4), "without MCAP"),
    "SQLite, no metadata": (lambda p: without_index(write2(p / "b", messages(ROS2), plugin=StoragePlugin.SQLITE3)),
        "holds no .mcap file (b.db3); convert it"),
    "MCAP": (lambda p: write2(p / "b", messages(ROS2)), "It lacks"),
    "MCAP, version 8": (lambda p: write2(p / "b", messages(ROS2), version=8), "It lacks"),
    "MCAP, file compressed": (lambda p: write2(p / "b", messages(ROS2), **COMPRESSED), "zstd"),
    "MCAP, messages compressed": (lambda p: write2(p / "b", messages(ROS2), mode=CompressionMode.MESSAGE), "message by message"),
    "MCAP, messages compressed, no metadata": (
        lambda p: without_index(write2(p / "b", messages(ROS2), mode=CompressionMode.MESSAGE)), "message by message"),
    "MCAP, a third": (lambda p: cut(write2(p / "b", messages(ROS2)), 0.33), "Lost"),
    "MCAP, nine tenths": (lambda p: cut(write2(p / "b", messages(ROS2)), 0.9), "Lost"),
    "MCAP, first bytes": (lambda p: cut(write2(p / "b", messages(ROS2)), 0.001), ""),
    "MCAP, garbled": (lambda p: garbled(p / "b"), ""),
    "MCAP, no metadata": (lambda p: without_index(write2(p / "b", messages(ROS2))), "It lacks"),
    "metadata of a later version": (lambda p: with_index(write2(p / "b", messages(ROS2)), lambda m: m.update(version=99)),
        "It lacks"),
    "metadata names another file": (lambda p: with_index(
        write2(p / "b", messages(ROS2)), lambda m: m.update(relative_file_paths=["other.mcap"])), "which is not there"),
    "metadata without files": (lambda p: with_index(
        write2(p / "b", messages(ROS2)), lambda m: m.pop("relative_file_paths")), "no metadata of a rosbag2 folder"),
    "no messages": (lambda p: write2(p / "b", []), "It lacks"),
    "images": (lambda p: images(p / "b"), "It lacks"),
    "types of their own": (lambda p: own_types(p / "b"), "It lacks"),
    "joints without names": (lambda p: without_names(p / "b"), "It lacks"),
    "stamps of 0": (lambda p: without_stamps(p / "b"), "It lacks"),
    "an empty file": (lambda p: text(p / "a.mcap", b""), ""),
    "a text": (lambda p: text(p / "a.mcap", b"not a bag at all\n" * 50), ""),
    "an empty folder": (lambda p: p, "holds no .mcap"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAGS)
def test_a_foreign_bag_is_described_and_imported_or_refused_with_a_reason(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, sentence = BAGS[name]
    folder = tmp_path / "in"
    folder.mkdir()
    bag = make(folder)
    code = main(["inspect", str(bag)])
    said = capsys.readouterr()
    assert code in (0, 1, 2)
    assert sentence in said.out + said.err
    assert said.out if code != 2 else said.err
    (tmp_path / "robot.urdf").write_text(synthetic.urdf())
    mapping = {
        "format": "irec-align/1",
        "session": {"name": "x", "robot": {"urdf": "robot.urdf", "serial": "S"}, "noise": {"tracker_m": 1e-5}},
        "joints": {"names": NAMES}, "marker": {"scale": 0.001},
    }  # fmt: skip
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    code = main(["import", str(bag), "--map", str(tmp_path / "map.yaml"), "-o", str(tmp_path / "session")])
    said = capsys.readouterr()
    assert code in (0, 2) and (said.err.strip() or code == 0)
    if name == "MCAP":
        assert "axis_a" in "\n".join(survey(BagReader(bag)).lacking)


def test_metadata_and_qos_of_our_bags_are_read_by_another_library_also_for_latched_topics(tmp_path: Path) -> None:
    folder = tmp_path / "ours"
    latched = Qos(durability="transient_local", depth=1) if "durability" in Qos.__dataclass_fields__ else Qos()
    with BagWriter(folder / "ours_0.mcap", Foreign()) as writer:
        joints = writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        described = writer.add_topic("/last_joints", "sensor_msgs/msg/JointState", latched)
        for k in range(10):
            writer.write(joints, joint_state(100.0 + k, NAMES, [0.1 * k] * 6), 10**9 * (100 + k))
        writer.write(described, joint_state(100.0, NAMES, [0.0] * 6), 10**11)
    writer.write_bag_metadata()
    with Reader2(folder) as reader:
        assert reader.message_count == 11
        assert reader.duration == 9 * 10**9 + 1
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        counts = {topic: information.msgcount for topic, information in reader.topics.items()}
        raws = [(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/joint_states"]
        positions = [ROS2.deserialize_cdr(*raw).position for raw in raws]
    assert counts == {"/joint_states": 10, "/last_joints": 1}
    np.testing.assert_allclose(np.array(positions)[:, 0], 0.1 * np.arange(10))
    assert [str(q.durability).split(".")[-1].lower() for q in qos["/last_joints"]] == ["transient_local"]
