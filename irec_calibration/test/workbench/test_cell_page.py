# SPDX-License-Identifier: Apache-2.0
"""The page for the cell: traffic light, progress, what has to be confirmed, and its talk with an action server of the cell."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest
from irec_calibration.errors import IrecError
from irec_calibration.recertification.journal import Entry
from irec_calibration.recertification.readings import MANNED
from irec_calibration.workbench.cell_logic import AMBER, CONFIRM, GREEN, GREY, RED, calibrations, how_far, light_of, may_start

PATIENCE = 60.0  # s


@pytest.mark.parametrize(
    ("result", "colour"),
    [
        ({"success": True, "verdict": "pass", "text": "All is well. Do this now: nothing."}, GREEN),
        ({"success": True, "verdict": "recalibrated", "activated": True, "text": "New."}, GREEN),
        ({"success": True, "verdict": "recalibrated", "activated": False, "text": "New, dry run."}, AMBER),
        ({"success": True, "verdict": "investigate: axis 3", "text": "Axis 3."}, AMBER),
        ({"success": True, "verdict": "failed: error above tolerance", "text": "Bad.", "session_path": "full.mcap"}, RED),
        ({"success": True, "verdict": "failed: tracker", "text": "Nothing was moved."}, GREY),
        ({"success": False, "verdict": "failed: cancelled", "text": "Cancelled."}, GREY),
    ],
)
def test_each_verdict_has_its_light_and_says_what_to_do_now(result, colour):
    light = light_of(result)
    assert light.colour == colour and light.word and light.now.startswith("Do this now:")


def test_what_the_verdict_says_to_do_is_what_the_page_says():
    light = light_of({"success": True, "verdict": "pass", "text": "All is well. Do this now: nothing."})
    assert (light.sentence, light.now) == ("All is well.", "Do this now: nothing.")


def test_the_page_says_what_to_press_where_a_program_would_be_told_what_to_call():
    text = "Cancelled. Do this now: to go on after the last complete pose, call irec/recertify with resume."
    light = light_of({"success": False, "verdict": "failed: cancelled", "text": text})
    assert "press Recalibrate and tick 'Go on" in light.now and "irec/" not in light.now


def test_progress_says_pose_n_of_n_and_the_time_left():
    share, words = how_far({"pose": 8, "poses": 31, "remaining_s": 610.0, "message": "pressing"})
    assert share == pytest.approx(7 / 31) and words == "Pose 8 of 31, about 11 min left. pressing"
    assert how_far({"pose": 8, "poses": 31, "paused": True})[1].startswith("Paused.")
    assert how_far(None) == (0.0, "")
    assert how_far({"pose": 8, "poses": 31, "message": "pose 8 of 31"})[1] == "Pose 8 of 31."


def test_the_robot_does_not_move_before_everything_is_confirmed_under_a_name():
    yes = dict.fromkeys(MANNED, True)
    with pytest.raises(IrecError, match="your name"):
        may_start(" ", yes)
    for key in MANNED:
        with pytest.raises(IrecError, match="Confirm first"):
            may_start("Maier", yes | {key: False})
    assert may_start("Maier", yes) == list(MANNED)


def test_the_page_asks_for_exactly_what_a_recertification_needs_confirmed():
    assert set(CONFIRM) == set(MANNED)


def test_calibrations_are_listed_once_the_latest_first():
    entries = [
        Entry("added", "0001"), Entry("put_in_force", "0001", by="A", at="2024-03-01T10:00:00"),
        Entry("added", "0002"), Entry("put_in_force", "0002", by="B", at="2025-03-01T10:00:00"),
        Entry("rolled_back", "0001", by="C", at="2025-03-02T10:00:00"),
    ]  # fmt: skip
    past = calibrations(entries, "0001")
    assert [(p.calibration, p.current) for p in past] == [("0001", True), ("0002", False)]
    assert past[0].at == "2025-03-02 10:00" and past[0].by == "C"


async def until(condition, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"no {what} within {PATIENCE:g} s"
        await asyncio.sleep(0.05)


@pytest.mark.ros
def test_the_page_runs_a_recertification_shows_how_far_it_is_and_goes_back(ros_domain):
    rclpy = pytest.importorskip("rclpy")
    pytest.importorskip("irec_msgs.action")
    from irec_calibration.nodes.cell_link import RosLink
    from rclpy.action import ActionServer
    from rclpy.executors import MultiThreadedExecutor

    try:
        from irec_msgs.action import Recertify
        from irec_msgs.srv import PutInForce
    except ImportError:
        pytest.skip("the built messages have no Recertify: make build")
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("fake_cell", context=context)
    asked, go_on = [], threading.Event()

    def run(goal):
        asked.append(goal.request)
        end = time.monotonic() + PATIENCE
        while not go_on.wait(0.05) and time.monotonic() < end:  # as a node does: whoever listens late hears the next one
            goal.publish_feedback(Recertify.Feedback(stage="procedure", message="pressing", pose=2, poses=5))
        goal.succeed()
        return Recertify.Result(success=True, verdict="pass", text="Good. Do this now: nothing.")

    def put(request, response):
        response.success, response.message = True, f"Calibration {request.calibration} is in force now."
        return response

    server = ActionServer(node, Recertify, "irec/recertify", run)
    node.create_service(PutInForce, "irec/put_in_force", put)
    executor = MultiThreadedExecutor(num_threads=3, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    link = RosLink()

    async def story():
        # the feedback is the last but one that a client listens to: who has found it gets the client's answers to it
        await until(lambda: node.count_subscribers("irec/recertify/_action/feedback"), "the server finds the page")
        task = asyncio.create_task(link.recertify("Maier", list(MANNED), check_only=True))
        await until(lambda: link.progress, "progress")
        assert link.running and how_far(link.progress)[1].startswith("Pose 2 of 5")
        with pytest.raises(IrecError, match="under way"):
            await link.recertify("Maier", list(MANNED))
        go_on.set()
        result = await asyncio.wait_for(task, PATIENCE)
        assert light_of(result).colour == GREEN and not link.running
        assert "0002" in await link.put_in_force("Maier", "0002")
        with pytest.raises(IrecError, match="procedure_node does not answer"):
            await link.pause()

    try:
        asyncio.run(story())
        assert asked[0].check_only and list(asked[0].confirmed) == list(MANNED) and asked[0].operator_name == "Maier"
    finally:
        go_on.set()
        link.close()
        server.destroy()
        executor.shutdown(timeout_sec=1.0)
        thread.join(5.0)
        node.destroy_node()
        context.try_shutdown()
