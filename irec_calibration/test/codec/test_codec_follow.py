# SPDX-License-Identifier: Apache-2.0
"""CODEC beside a running procedure: the recording grows, and every completed pose brings a verdict."""

import json

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_calibration.codec.follow import complete_poses, follow
from irec_calibration.errors import PlanError
from irec_calibration.model import SIX_DOF, blank_model
from irec_calibration.session.mcap_io import write_mcap
from synthetic import session

SIX = blank_model(SIX_DOF)


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """A recording after 1, 2, ... 12 poses as it stands on the disk: without its end, the last one closed."""
    folder, whole = tmp_path_factory.mktemp("recording"), session(12)
    written = [write_mcap(whole.select_poses(np.arange(1, n + 1)), folder / f"{n}.mcap").read_bytes() for n in range(1, 13)]
    return [content[:-100] for content in written[:-1]] + written[-1:]


class Writer:
    """Puts the next state of the recording on the disk at every look, in place of a running procedure."""

    def __init__(self, path, states):
        self.path, self.states, self.slept = path, iter(states), 0.0

    def sleep(self, seconds):
        self.slept += seconds
        state = next(self.states, None)
        if state is not None:
            self.path.write_bytes(state)


def test_every_completed_pose_brings_news_until_the_recording_is_closed(tmp_path, states):
    writer = Writer(tmp_path / "run.mcap", states)
    news = list(follow(writer.path, SIX, sleep=writer.sleep))
    assert [n.poses for n in news] == list(range(1, 13))
    judged = [n for n in news if n.growth]
    assert [n.poses for n in judged] == list(range(6, 13))
    assert all(n.codec.poses == n.growth.poses == n.poses for n in judged)
    assert all("poses" in n.why for n in news if not n.growth)


def test_a_recording_that_stops_growing_is_given_up_after_a_while(tmp_path, states):
    writer = Writer(tmp_path / "run.mcap", states[:3])
    with pytest.raises(PlanError, match="nothing new for 60 s with 3 poses complete: no further pose was completed"):
        list(follow(writer.path, SIX, patience=60.0, sleep=writer.sleep))
    assert writer.slept <= 70.0


def test_a_recording_that_never_begins_is_given_up_with_the_reason(tmp_path):
    with pytest.raises(PlanError, match=r"nothing new for 60 s with 0 poses complete: .*no such file"):
        list(follow(tmp_path / "never.mcap", SIX, patience=60.0, sleep=lambda _: None))


def test_the_pose_under_way_is_left_out():
    whole = session(5)
    part = whole.select(((whole.pose < 5) | (whole.load_case < 3)) & ((whole.pose != 2) | (whole.load_case != 4)))
    np.testing.assert_array_equal(complete_poses(part), [1, 2, 3, 4])  # pose 2 lost a load case, but is not under way


def test_irec_codec_follow_prints_a_verdict_and_draws_the_chart(tmp_path, capsys, states):
    pytest.importorskip("matplotlib", reason="extra 'report' is not installed")
    (tmp_path / "run.mcap").write_bytes(states[-1])
    arguments = ["codec", str(tmp_path / "run.mcap"), "--follow", "--model", "6", "--json", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["poses"] == 12 and "pose" in last["growth"]
    assert (tmp_path / "out" / "codec.png").exists()


def test_follow_takes_no_comparison(tmp_path, capsys):
    assert main(["codec", str(tmp_path / "run.mcap"), "--follow", "--compare", "model"]) == 2
    assert "no comparison" in capsys.readouterr().err
