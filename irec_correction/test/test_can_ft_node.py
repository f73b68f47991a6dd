# SPDX-License-Identifier: Apache-2.0
"""The sensor node as processes, over a serial adapter on a pseudo-terminal."""

from __future__ import annotations

import sys
import time
import uuid

import numpy as np
import pytest
from irec_correction.errors import CorrectionError
from irec_correction.shared import WRENCH_SIZE, SharedValues
from irec_sim.devices.netft_can import NetFtCan, SlcanAdapter

pytestmark = pytest.mark.ros
LOAD = np.array([120.5, -80.25, -900.0, 3.5, -2.25, 0.125])


def test_readings_come_as_messages_and_in_shared_memory_and_bias_takes_them_as_zero(ros_domain, start_process):
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.executors import SingleThreadedExecutor
    from std_srvs.srv import Trigger

    adapter = SlcanAdapter(NetFtCan(lambda: LOAD))
    name = f"irec_test_{uuid.uuid4().hex}"
    start_process([
        sys.executable, "-m", "irec_correction.nodes.can_ft_node", "--ros-args", "-p", "interface:=slcan", "-p",
        f"channel:={adapter.channel}", "-p", "rate:=50.0", "-p", f"block:={name}",
    ], name="can_ft_node")  # fmt: skip
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("watcher", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    seen: list[WrenchStamped] = []
    client = node.create_client(Trigger, "can_ft_node/bias")  # before the subscription: who is heard has found the client
    node.create_subscription(WrenchStamped, "wrench_raw", seen.append, 50)

    def until(condition, what: str) -> None:
        end = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < end, what
            executor.spin_once(timeout_sec=0.05)

    try:
        until(lambda: len(seen) > 5, "no wrench")
        w = seen[-1].wrench
        np.testing.assert_allclose([w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z], LOAD, atol=1e-5)
        assert seen[-1].header.frame_id == "ft_sensor"
        values = np.zeros(WRENCH_SIZE)
        assert SharedValues.attach(name, WRENCH_SIZE).read(values)
        np.testing.assert_allclose(values[3:], LOAD, atol=1e-5)
        until(client.service_is_ready, "no bias service")
        answer = client.call_async(Trigger.Request())
        until(answer.done, "no answer")
        assert answer.result().success
        until(lambda: abs(seen[-1].wrench.force.z) < 1e-3, "no zero")
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
        adapter.unplug()


def test_the_lifecycle_opens_the_bus_passes_on_and_frees_it_twice_over(ros_domain, start_process):
    from geometry_msgs.msg import WrenchStamped
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from ros_side import RosSide

    adapter = SlcanAdapter(NetFtCan(lambda: LOAD))
    name = f"irec_test_{uuid.uuid4().hex}"
    start_process([
        sys.executable, "-m", "irec_correction.nodes.can_ft_node", "--ros-args", "-p", "interface:=slcan", "-p",
        f"channel:={adapter.channel}", "-p", "rate:=50.0", "-p", f"block:={name}", "-p", "autostart:=false",
    ], name="can_ft_node")  # fmt: skip
    watcher = RosSide("watcher")
    seen = watcher.collect(WrenchStamped, "wrench_raw")

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(watcher.call(ChangeState, "can_ft_node/change_state", request).success)

    try:
        for _ in range(2):
            with pytest.raises(CorrectionError):
                SharedValues.attach(name, WRENCH_SIZE)
            assert change(Transition.TRANSITION_CONFIGURE)
            assert change(Transition.TRANSITION_ACTIVATE)
            begun = len(seen)
            watcher.until(lambda b=begun: len(seen) > b + 5, "wrench")
            assert change(Transition.TRANSITION_DEACTIVATE)
            block, values = SharedValues.attach(name, WRENCH_SIZE), np.zeros(WRENCH_SIZE)
            block.read(values)
            last = values[0]
            time.sleep(0.5)  # what is tested is that time passes without a reading
            block.read(values)
            assert values[0] == last, "nothing is passed on while inactive"
            block.close()
            assert change(Transition.TRANSITION_CLEANUP)
    finally:
        watcher.close()
        adapter.unplug()


def test_a_bus_that_is_not_there_ends_the_node_with_its_name(ros_domain, start_process, tmp_path):
    process = start_process([
        sys.executable, "-m", "irec_correction.nodes.can_ft_node", "--ros-args", "-p", "interface:=slcan",
        "-p", "channel:=/dev/not_there",
    ], name="refused")  # fmt: skip
    assert process.wait(180) == 2
    said = (tmp_path / "refused.log").read_text()
    assert "/dev/not_there" in said
    assert "Traceback" not in said
    with pytest.raises(CorrectionError):
        SharedValues.attach("irec_wrench_of_nobody", WRENCH_SIZE)
