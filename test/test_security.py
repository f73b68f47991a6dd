# SPDX-License-Identifier: Apache-2.0
"""What the nodes open is what the policies allow, no more and no less; and nothing listens wider than it was told."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "config" / "cells" / "afp.yaml"
sys.path.append(str(ROOT / "tools" / "security"))

from interfaces import NODES, OF_EVERY_NODE, Node  # noqa: E402
from policies import ENCLAVES, full_name, policy  # noqa: E402

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

# calibration_node opens its listener only while it looks; tf2_msgs is not among the wheels of the test environment
NOT_TRIED = {"calibration_node_listener", *(() if importlib.util.find_spec("tf2_msgs") else ("tf_node",))}
START = 240.0  # s for all processes to come up on a busy machine
LOOPBACK = "0100007F"  # 127.0.0.1 in /proc/net
DDS_PORTS = range(7400, 7400 + 250 * 102)  # of the domains that a machine can use
EPHEMERAL = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])


def test_every_node_is_in_one_enclave_and_the_policy_names_what_it_may_open() -> None:
    assert sorted(n for names in ENCLAVES.values() for n in names) == sorted(n.name for n in NODES)
    tree = policy("cell_a")
    paths = [e.get("path") for e in tree.iter("enclave")]
    assert "/irec/cell_a/procedure" in paths and len(set(paths)) == len(ENCLAVES)
    profile = next(p for p in tree.iter("profile") if p.get("node") == "procedure_node")
    published = next(t for t in profile.findall("topics") if t.get("publish"))
    assert "/cell_a/robot/force_setpoint" in [t.text for t in published]
    publishers = [
        p.get("node") for p in tree.iter("profile") for group in p.findall("topics") if group.get("publish")
        if "/cell_a/robot/force_setpoint" in [t.text for t in group]
    ]  # fmt: skip
    assert publishers == ["procedure_node"], "nobody else may press"


def test_what_is_sometimes_open_is_among_what_is_allowed() -> None:
    for node in NODES:
        allowed = {*node.publishes, *node.subscribes, *node.serves, *node.call, *node.execute, *node.send}
        assert set(node.sometimes) <= allowed, node.name


class Running:
    """All nodes of a cell on one graph, and one more that looks at them."""

    def __init__(self, processes: dict[str, subprocess.Popen[bytes]], rsi_port: int) -> None:
        import rclpy

        self.processes, self.rsi_port = processes, rsi_port
        rclpy.init()
        self.node = rclpy.create_node("looker")

    def opened(self, name: str) -> dict[str, set[str]]:
        """Full names by role, actions folded into one name each."""
        n, space = self.node, "/"
        found = {
            "publish": n.get_publisher_names_and_types_by_node(name, space),
            "subscribe": n.get_subscriber_names_and_types_by_node(name, space),
            "serve": n.get_service_names_and_types_by_node(name, space),
            "call": n.get_client_names_and_types_by_node(name, space),
        }
        out: dict[str, set[str]] = {role: {t for t, _ in pairs if "/_action/" not in t} for role, pairs in found.items()}
        actions = {role: {t.split("/_action/")[0] for t, _ in pairs if "/_action/" in t} for role, pairs in found.items()}
        out["execute"], out["send"] = actions["serve"], actions["call"]
        return out


def rules_of(node: Node) -> dict[str, frozenset[str]]:
    return {
        "publish": node.publishes, "subscribe": node.subscribes, "serve": node.serves, "call": frozenset(node.call),
        "execute": frozenset(node.execute), "send": frozenset(node.send),
    }  # fmt: skip


def matches(name: str, rule: str) -> bool:
    return name == rule or (rule.endswith("*") and name.startswith(rule[:-1]))


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
    import rclpy

    sys.path.append(str(ROOT / "tools"))
    from demo_parts.domain import free_domain
    from irec_sim.devices.netft_can import NetFtCan, SlcanAdapter

    folder = tmp_path_factory.mktemp("security")
    os.environ.update(
        ROS_DOMAIN_ID=str(free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        FASTRTPS_DEFAULT_PROFILES_FILE=str(ROOT / "config" / "fastdds_localhost.xml"),
    )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        port = int(s.getsockname()[1])
    adapter = SlcanAdapter(NetFtCan(lambda: __import__("numpy").zeros(6)))
    modules: dict[str, tuple[str, dict[str, Any]]] = {
        "cell": ("irec_sim.nodes.cell_node", {"cell": CELL, "speed_factor": 1.0}),
        "procedure_node": ("irec_calibration.nodes.procedure_node", {"cell": CELL, "session_folder": folder,
                                                                     "use_sim_time": "true"}),
        "calibration_node": ("irec_calibration.nodes.calibration_node", {"cell": CELL, "calibration_folder": folder / "c"}),
        "recorder": ("irec_calibration.nodes.recorder_node", {"output": folder / "bag", "topics": "[wrench]"}),
        "tf_node": ("irec_calibration.nodes.tf_node", {}),
        "correction_node": ("irec_correction.nodes.correction_node", {"cell": CELL, "autostart": "true"}),
        "rsi_bridge": ("irec_correction.nodes.rsi_bridge", {"cell": CELL, "port": port}),
        "driver": ("irec_calibration.nodes.ros2_control_driver", {"cell": CELL}),
        "tracker": ("irec_calibration.nodes.tracker_driver", {"source": f"udp://127.0.0.1:{port + 1}", "station": "A"}),
        "can_ft_node": ("irec_correction.nodes.can_ft_node", {"interface": "slcan", "channel": adapter.channel, "rate": 50.0,
                                                              "block": f"irec_security_{os.getpid()}"}),
    }  # fmt: skip
    processes = {}
    for name, (module, parameters) in modules.items():
        if name in NOT_TRIED:
            continue
        arguments = [a for k, v in parameters.items() for a in ("-p", f"{k}:={v}")]
        with open(folder / f"{name}.log", "wb") as log:
            processes[name] = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", *arguments], stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True,
            )  # fmt: skip
    with open(folder / "irec_cell_page.log", "wb") as log:
        page = "import time; from irec_calibration.nodes.cell_link import RosLink; link = RosLink(); time.sleep(3600)"
        processes["irec_cell_page"] = subprocess.Popen(
            [sys.executable, "-c", page], stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
    made = Running(processes, port)
    try:
        end = time.monotonic() + START
        wanted = {n.name for n in NODES} - NOT_TRIED
        while missing := wanted - set(made.node.get_node_names()):
            ended = [n for n, p in processes.items() if p.poll() is not None]
            assert not ended, f"{ended} ended: {(folder / f'{ended[0]}.log').read_text()[-1500:]}"
            assert time.monotonic() < end, f"{missing} did not come up"
            rclpy.spin_once(made.node, timeout_sec=0.2)
        until = time.monotonic() + 3.0  # what nodes open after their start
        while time.monotonic() < until:
            rclpy.spin_once(made.node, timeout_sec=0.2)
        yield made
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                process.kill()
        adapter.unplug()
        made.node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("node", [n for n in NODES if n.name not in NOT_TRIED], ids=lambda n: n.name)
def test_a_running_node_opens_what_its_policy_allows(running: Running, node: Node) -> None:
    import rclpy

    def never() -> dict[str, list[str]]:
        """Role -> what the policy allows and the node has not opened (yet)."""
        opened, out = running.opened(node.name), {}
        for role, rules in rules_of(node).items():
            needed = {full_name(r, node.name, "") for r in rules if r not in node.sometimes and r not in OF_EVERY_NODE}
            out[role] = sorted(a for a in needed if not any(matches(n, a) for n in opened[role]))
        return {role: names for role, names in out.items() if names}

    end = time.monotonic() + START
    while missing := never():
        assert time.monotonic() < end, f"{node.name}: the policy allows {missing}, which the node does not open"
        rclpy.spin_once(running.node, timeout_sec=0.2)
    for role, rules in rules_of(node).items():
        allowed = {full_name(r, node.name, "") for r in rules}
        beyond = {n for n in running.opened(node.name)[role] if not any(matches(n, a) for a in allowed)}
        assert not beyond, f"{node.name}: {role} {sorted(beyond)} is not in the policy"


def sockets_of(pid: int) -> list[tuple[str, str, int]]:
    """(protocol, local address as in /proc/net, port) of the sockets of a process that are bound."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            text = os.readlink(link)
        except OSError:
            continue
        if text.startswith("socket:["):
            inodes.add(text[8:-1])
    found = []
    for protocol in ("udp", "tcp", "udp6", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                address, _, port = fields[1].partition(":")
                found.append((protocol, address, int(port, 16)))
    return found


@pytest.mark.ros
@pytest.mark.slow
def test_nothing_listens_beyond_this_machine(running: Running) -> None:
    """Ephemeral ports are those from which DDS sends; nobody can know them, and nothing reads what comes there."""
    for name, process in running.processes.items():
        sockets = [s for pid in (process.pid, *_children(process.pid)) for s in sockets_of(pid)]
        wide = [s for s in sockets if s[1] != LOOPBACK and (s[0] != "udp" or s[2] < EPHEMERAL)]
        assert not wide, f"{name} listens on {wide}"
        assert any(s[1] == LOOPBACK and s[2] in DDS_PORTS for s in sockets), f"{name}: no socket of DDS is seen"


@pytest.mark.ros
@pytest.mark.slow
def test_the_bridge_listens_to_the_controller_where_it_was_told_and_nowhere_else(running: Running) -> None:
    processes = [running.processes["rsi_bridge"].pid, *_children(running.processes["rsi_bridge"].pid)]
    sockets = [s for pid in processes for s in sockets_of(pid) if s[2] == running.rsi_port]
    assert sockets and all(s[:2] == ("udp", LOOPBACK) for s in sockets), sockets
    assert not any(s[0].startswith("tcp") for pid in processes for s in sockets_of(pid))


@pytest.mark.ros
@pytest.mark.parametrize("address", ["0.0.0.0", "0", "[::]", ""])
def test_a_tracker_driver_is_not_made_to_listen_on_every_network(address: str) -> None:
    pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
    from irec_calibration.drivers.tracker_stream import StreamError
    from irec_calibration.nodes.tracker_driver import _source

    with pytest.raises(StreamError, match="source"):
        _source(f"udp://{address}:700")


def test_a_lock_in_a_folder_of_everybody_is_no_link_to_a_file_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sys.path.append(str(ROOT / "tools"))
    from demo_parts import domain

    ours = tmp_path / "ours"
    ours.write_text("kept")
    (tmp_path / "irec-ros-domain-10.lock").symlink_to(ours)
    monkeypatch.setattr(domain.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(domain, "in_use", lambda number: False)
    taken, lock = domain.take_domain(10, 11)
    assert taken == 11 and ours.read_text() == "kept"
    lock.close()


def _children(pid: int) -> list[int]:
    return [int(c) for task in Path(f"/proc/{pid}/task").iterdir() for c in (task / "children").read_text().split()]
