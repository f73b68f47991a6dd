# SPDX-License-Identifier: Apache-2.0
"""What goes to viewers of other people: frames that agree with the kinematics, messages that another reader decodes, layouts."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from irec_calibration.cli import main
from irec_calibration.errors import RobotError
from irec_calibration.robot import Robot
from irec_calibration.robot.transforms import LinkTree
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation
from workbench_server import write_hidden

ROOT = Path(__file__).parents[3]
URDFS = sorted((ROOT / "config" / "robots").glob("*.urdf"))


def tcp_of(transforms) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of tool0 in base_link, up the tree."""
    by_child = {t.child: t for t in transforms}
    p, R, link = np.zeros(3), Rotation.identity(), "tool0"
    while link != "base_link":
        t = by_child[link]
        turn = Rotation.from_quat(t.quat_xyzw)
        p, R, link = t.xyz + turn.apply(p), turn * R, t.parent
    return p, R.as_matrix()


@pytest.mark.parametrize("urdf", URDFS, ids=lambda p: p.stem)
def test_frames_lead_to_the_same_tool_as_the_kinematics(urdf):
    robot = Robot.from_urdf(urdf)
    tree = LinkTree(urdf.read_text())
    q = np.random.default_rng(0).uniform(-1.0, 1.0, robot.n_joints)
    at = dict.fromkeys(tree.moving, 0.0) | dict(zip(robot.joint_names, q.tolist(), strict=True))
    p, R = tcp_of([*tree.fixed(), *tree.at(at)])
    kin = robot.kinematics(q)
    np.testing.assert_allclose(p, kin.p_tcp[0], atol=1e-9)
    np.testing.assert_allclose(R, kin.R_tool[0], atol=1e-9)


JOINT = '<robot><joint name="a" type="revolute"><parent link="b"/><child link="c"/>{}</joint></robot>'
BROKEN = ["no xml", "<robot/>", '<robot><joint name="a" type="fixed"/></robot>', JOINT.format('<axis xyz="nan 0 1"/>'),
          JOINT.format('<axis xyz="1e308 1e308 0"/>'), JOINT.format('<origin rpy="inf 0 0"/>')]  # fmt: skip


@pytest.mark.parametrize("text", BROKEN)
def test_what_is_no_robot_description_is_refused(text):
    with pytest.raises(RobotError):
        LinkTree(text)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    session = write_hidden(folder / "session")
    assert main(["scene", str(session), "-o", str(folder / "scene.mcap")]) == 0
    with open(folder / "scene.mcap", "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(c.topic, s.name, m) for s, c, _, m in reader.iter_decoded_messages()]
    return found, folder


def test_another_reader_decodes_every_message_of_a_scene(scene):
    found, _ = scene
    types = {topic: name for topic, name, _ in found}
    assert types["/tf"] == types["/tf_static"] == "tf2_msgs/msg/TFMessage"
    assert types["/irec/scene"] == "visualization_msgs/msg/MarkerArray" and "/joint_states" in types


def test_a_reader_of_rosbags_that_is_not_made_for_mcap_alone_reads_it_too(scene):
    highlevel = pytest.importorskip("rosbags.highlevel", reason="rosbags is missing: pip install rosbags")
    found, folder = scene
    with highlevel.AnyReader([folder / "scene.mcap"]) as reader:
        read = [(c.topic, c.msgtype, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    assert sorted((t, n) for t, n, _ in read) == sorted((t, n) for t, n, _ in found)
    poses = [m.header.frame_id for t, _, m in read if t == "/irec/residual"]
    assert poses and all(poses)


def test_residuals_are_lines_and_poses_have_numbers(scene):
    found, _ = scene
    markers = next(m for topic, _, m in found if topic == "/irec/scene").markers
    lines = next(m for m in markers if m.ns == "residual")
    assert len(lines.points) == 2 * 70 and len(lines.colors) == len(lines.points)
    assert [m.text for m in markers if m.ns == "pose"] == [str(n) for n in range(1, 15)]


def test_a_scene_is_never_overwritten(scene, capsys):
    _, folder = scene
    assert main(["scene", str(folder / "session"), "-o", str(folder / "scene.mcap")]) == 2
    assert "never overwritten" in capsys.readouterr().err


def test_layouts_can_be_read_and_name_topics_that_exist():
    viewers = ROOT / "config" / "viewers"
    layout = json.loads((viewers / "foxglove.json").read_text())
    assert set(_panels(layout["layout"])) == set(layout["configById"])
    recorded = yaml.safe_load((ROOT / "config/nodes/recorder.yaml").read_text())["/**/recorder"]["ros__parameters"]["topics"]
    known = {f"/{t}" for t in recorded} | {"/tf", "/tf_static", "/irec/scene"}
    text = (viewers / "foxglove.json").read_text()
    for topic in ("/wrench", "/tracker/point", "/irec/correction/state", "/irec/procedure/status", "/robot_description"):
        assert topic in known and topic in text
    displays = yaml.safe_load((viewers / "irec.rviz").read_text())["Visualization Manager"]["Displays"]
    assert {d["Topic"]["Value"] for d in displays if "Topic" in d} <= known
    curves = [c.get("name", "") for c in ElementTree.parse(viewers / "plotjuggler.xml").iter("curve")]
    assert curves and all(any(c.startswith(t + "/") for t in known) for c in curves)


def _panels(node) -> list[str]:
    return [node] if isinstance(node, str) else [*_panels(node["first"]), *_panels(node["second"])]
