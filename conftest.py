# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests that run real processes over DDS: a domain of their own, and processes that always end."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

ROOT = Path(__file__).parent
sys.path.append(str(ROOT / "tools"))

from demo_parts.domain import take_domain  # noqa: E402
from irec_calibration.effects import registry  # noqa: E402

FIRST_DOMAIN, LAST_DOMAIN = 60, 99  # below 101, where Linux hands out ephemeral ports
STOP_SECONDS = 10.0
hypothesis.settings.register_profile("irec", deadline=None)  # a busy machine is no failure
hypothesis.settings.load_profile("irec")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip ROS tests, with the reason, where rclpy or the built messages are missing.

    Raises:
        pytest.UsageError: a file whose tests start nodes does not say so itself; tools/test.sh would not run them.
    """
    for path in {item.path for item in items if "ros" in item.keywords}:
        if "mark.ros" not in path.read_text(encoding="utf-8"):
            raise pytest.UsageError(f"{path}: its tests start nodes; write pytest.mark.ros in it, tools/test.sh looks for that")
    if importlib.util.find_spec("rclpy") and importlib.util.find_spec("irec_msgs"):
        return
    skip = pytest.mark.skip(reason="rclpy or irec_msgs is missing: run `make test`")
    for item in items:
        if "ros" in item.keywords:
            item.add_marker(skip)


@pytest.fixture(autouse=True)
def effects_of_this_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects that a test registers are candidates of every later diagnosis of the process: they end with the test."""
    for name in ("_registered", "_files"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS_DOMAIN_ID that nobody on this machine uses now; set in the environment together with LOCALHOST."""
    try:
        domain, lock = take_domain(FIRST_DOMAIN, LAST_DOMAIN)
    except ValueError as error:
        pytest.fail(str(error))
    with lock:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(ROOT / "config" / "fastdds_localhost.xml"))
        yield domain


@pytest.fixture
def start_process(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start processes that are ended with the test, their output kept in tmp_path/NAME.log.

    `start_process(args, name="node")` returns the Popen; SIGINT, then SIGKILL to its whole group at the end.
    """
    running: list[subprocess.Popen[bytes]] = []

    def start(args: list[str], name: str = "process", **options: object) -> subprocess.Popen[bytes]:
        with open(tmp_path / f"{name}.log", "wb") as log:
            process = subprocess.Popen(args, stdout=log, stderr=subprocess.STDOUT, start_new_session=True, **options)  # type: ignore[call-overload]
        running.append(process)
        return process

    yield start
    for process in running:
        _signal(process, signal.SIGINT)
    deadline = time.monotonic() + STOP_SECONDS
    for process in running:
        try:
            process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            pass
        _signal(process, signal.SIGKILL)
        process.wait(STOP_SECONDS)


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        pass
