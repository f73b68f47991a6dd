# SPDX-License-Identifier: Apache-2.0
"""Where the time of the correction goes, each figure beside its yardstick from the same run.

`python tools/bench/correction.py [--cycles 100000] [--priority 50] [--json FILE]`; exit code 1 where a target is missed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from irec_calibration.effects import find_effect
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.live import ByDisplacement, LiveForm
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad
from irec_correction.conditioning import Conditioner, FilterSettings, make_filters, sensor_in_tool
from irec_correction.correction import Correction, CorrectionSettings
from irec_correction.deflection import Deflection
from irec_correction.realtime import prefer_thread, settle_memory

ROOT = Path(__file__).parents[2]
CELL = ROOT / "config/cells/afp.yaml"
URDF = ROOT / "config/robots/kr120_r2700_extra_ha.urdf"
Q = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3])
WRENCH = np.array([150.0, -80.0, -900.0, 5.0, 3.0, -1.0])
PERIOD = 0.004
CYCLES_TO_JUDGE_LATE = 100_000  # with fewer the count is chance
LAW = "axis 3: tau * (a * cos(3 * q_3) + b * sin(3 * q_3))"
WARM_UP = 200  # cycles before the count begins; the first packets of a session are not answered
SWAP = 500  # cycles after which the other one is asked first
APART = 0.4  # of a period between the two
TARGET_DEFLECTION_US, TARGET_FASTER, TARGET_TICK_US, TARGET_REPLY = 60.0, 3.0, 150.0, 1.5


def model_18() -> Model:
    """18 DOF with compliances of the usual size."""
    torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(4e-7) for k in range(1, 7)})
    bending = Term(find_effect("link_bending"), {f"c_{k}{v}": Estimate(1e-7) for k in range(1, 7) for v in "ab"})
    sha = Robot.from_urdf(URDF).sha256
    return Model((torsion, bending), "KR120-0001", urdf_sha256=sha, envelope=Envelope((-7.0,) * 6, (7.0,) * 6, 2000.0, 500.0))


class Plain:
    """The same deflection as one would write it down: one Pinocchio call per joint, numpy for the rest, Eq. (2)-(11)."""

    def __init__(self, robot: Robot, c_axis: float, c_virtual: float) -> None:
        self.model = pin.buildModelFromXML(robot.urdf_text)
        self.data = self.model.createData()
        self.tcp = self.model.getFrameId("tool0")
        self.joints = [self.model.getJointId(n) for n in robot.joint_names]
        self.virtual = robot.kinematics(np.zeros(6)).virtual_in_joint
        self.c = np.array([c_axis, c_virtual, c_virtual] * 6)

    def __call__(self, q: np.ndarray, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(self.model, self.data, q)
        tool = pin.updateFramePlacement(self.model, self.data, self.tcp)
        f, m = tool.rotation @ force, tool.rotation @ torque
        J, W = np.empty((3, 18)), np.empty((3, 18))
        for k, joint in enumerate(self.joints):
            placement = self.data.oMi[joint]
            lever = tool.translation - placement.translation
            local = pin.computeJointJacobian(self.model, self.data, q, joint)
            W[:, 3 * k] = placement.rotation @ local[3:, k]
            for v in range(2):
                W[:, 3 * k + 1 + v] = placement.rotation @ self.virtual[k, v]
            for v in range(3):
                J[:, 3 * k + v] = np.cross(W[:, 3 * k + v], lever)
        tau = J.T @ f + W.T @ m
        return J @ (self.c * tau)


def spread(seconds: list[float] | np.ndarray) -> dict[str, float]:
    """Median and tails, us."""
    s = np.asarray(seconds) * 1e6
    return {k: round(float(np.percentile(s, p)), 2) for k, p in (("p50", 50), ("p99", 99), ("p99.9", 99.9), ("max", 100))}


def timed(call: object, n: int) -> list[float]:
    """Seconds of each of n calls."""
    out, clock = [], time.perf_counter
    for _ in range(n):
        t = clock()
        call()  # type: ignore[operator]
        out.append(clock() - t)
    return out


def bench_deflection(n: int) -> dict:
    """Compiled against plain, interleaved."""
    robot = Robot.from_urdf(URDF)
    fast, plain = Deflection(model_18(), robot), Plain(robot, 4e-7, 1e-7)
    f, m = WRENCH[:3], WRENCH[3:]
    difference = float(np.abs(fast(Q, f, m, PERIOD)[0] - plain(Q, f, m)).max())
    if difference > 1e-12:
        raise SystemExit(f"both formulations differ by {difference} m: nothing to compare")
    ours, theirs = [], []
    for _ in range(10):
        ours += timed(lambda: fast(Q, f, m, PERIOD), n // 10)
        theirs += timed(lambda: plain(Q, f, m), n // 10)
    a, b = spread(ours), spread(theirs)
    return {"compiled_us": a, "plain_us": b, "faster": round(b["p50"] / a["p50"], 2), "law": bench_law(robot, n // 10)}


class ByOwnDisplacement(FormulaEffect):
    """A formula without a form of its own for the live correction."""

    def live(self, scene: Scene, theta: np.ndarray) -> LiveForm:
        return ByDisplacement()


def bench_law(robot: Robot, n: int) -> dict:
    """A model with a formula that turns an axis, in its live form against the formula's own displacement, interleaved."""
    values = {"a": Estimate(1e-8), "b": Estimate(2e-8)}
    both = [
        Deflection(replace(model_18(), terms=(*model_18().terms, Term(kind("law_of_axis_3", LAW), values))), robot)
        for kind in (FormulaEffect, ByOwnDisplacement)
    ]
    f, m = WRENCH[:3], WRENCH[3:]
    fast, slow = (each(Q, f, m, PERIOD)[0] for each in both)
    if np.abs(fast - slow).max() > 1e-12:
        raise SystemExit(f"both forms of a formula differ by {np.abs(fast - slow).max()} m: nothing to compare")
    ours, theirs = [], []
    for _ in range(10):
        ours += timed(lambda: both[0](Q, f, m, PERIOD), n // 10)
        theirs += timed(lambda: both[1](Q, f, m, PERIOD), n // 10)
    a, b = spread(ours), spread(theirs)
    return {"live_us": a, "displacement_us": b, "faster": round(b["p50"] / a["p50"], 2)}


def bench_chain(n: int, period: float) -> dict:
    """One tick of the chain with a raw wrench: watchdog, load, filters, model, state, limits."""
    robot = Robot.from_urdf(URDF)
    filters = make_filters(FilterSettings(rate=1.0 / period, median=3, spindle_speed=50.0, harmonics=1))
    load = ToolLoad(120.0, (0.0, 0.0, 0.2), (18.0, -11.0, 25.0), (1.0, 2.0, 3.0))
    chain = Correction(CorrectionSettings(period=period), robot, Conditioner(filters, sensor_in_tool(robot, "ft_sensor"), load))
    chain.put_in_force(model_18(), 0.0)
    noise = np.random.default_rng(0).normal(0.0, 1.0, (n, 6))
    chain.start(10.0)
    spent, clock = [], time.perf_counter
    for i in range(n):
        now = 10.0 + i * period
        t = clock()
        chain.take_joints(now, now, Q)
        chain.take_wrench(now, now, "ft_sensor", WRENCH + noise[i])
        chain.tick(now)
        spent.append(clock() - t)
    return {"tick_us": spread(spent), "state": chain.supervisor.state.name}


# --- RSI -----------------------------------------------------------------------------------------------------------------


def echo(pipe: object, priority: int) -> None:
    """The yardstick: as little as Python needs to answer a datagram."""
    prefer_thread(priority)
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    settle_memory()
    pipe.send(s.getsockname()[1])  # type: ignore[attr-defined]
    while True:
        data, who = s.recvfrom(4096)
        if not data:
            return
        s.sendto(data, who)


def rsi(pipe: object, priority: int, wrench_block: str, latency_block: str, period: float) -> None:
    """The loop with the whole chain in its process."""
    from irec_correction.rsi.loop import Link, RsiLoop
    from irec_correction.rsi.report import KEPT
    from irec_correction.rsi.sources import ChainSettings, ChainSource
    from irec_correction.shared import SharedValues

    prefer_thread(priority)
    source = ChainSource(
        ChainSettings(CorrectionSettings(period=period), FilterSettings(rate=1.0 / period), URDF.read_text(), wrench_block)
    )
    source.put_in_force(model_18(), time.monotonic())
    latency = SharedValues.attach(latency_block, KEPT)
    loop = RsiLoop(Link(port=0), source, latency=latency, cycle_ms=round(1000 * period))
    settle_memory()
    pipe.send(loop.port)  # type: ignore[attr-defined]
    source.start(time.monotonic())
    loop.run(lambda: not pipe.poll(0))  # type: ignore[attr-defined]


def scheduling(pid: int) -> dict[str, float]:
    """What the system did to a process so far: time on a processor and waiting for one (s), switches, page faults."""
    run, wait, _ = (int(v) for v in Path(f"/proc/{pid}/schedstat").read_text().split())
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    stat = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return {
        "on_cpu_s": run * 1e-9, "waiting_for_cpu_s": wait * 1e-9, "preempted": int(status["nonvoluntary_ctxt_switches"]),
        "page_faults": int(stat[7]) + int(stat[9]),
    }  # fmt: skip


def stolen() -> float:
    """Time that the machine under this one took away so far, s, all processors."""
    return int(Path("/proc/stat").read_text().splitlines()[0].split()[8]) / os.sysconf("SC_CLK_TCK")


def late_counts(ours: int, theirs: int) -> dict:
    """Late replies with their 95 % Poisson intervals, and how probable at least that many of the sum are if both are equal."""
    from scipy.stats import binomtest, chi2

    def interval(n: int) -> list[float]:
        return [round(chi2.ppf(0.025, 2 * n) / 2 if n else 0.0, 2), round(chi2.ppf(0.975, 2 * n + 2) / 2, 2)]

    p = binomtest(ours, ours + theirs, 0.5, "greater").pvalue if ours + theirs else 1.0
    return {"late": ours, "late_95": interval(ours), "echo_late": theirs, "echo_late_95": interval(theirs),
            "p_if_equal": round(float(p), 3)}  # fmt: skip


class Line:
    """One controller that asks both in every cycle, as far apart that neither is at work while the other one is asked."""

    def __init__(self, ports: list[int], block: object, period: float) -> None:
        from irec_sim.devices.rsi_controller import RobotState, RsiController

        self._ports, self._block, self._period = ports, block, period
        self._controller = RsiController(("127.0.0.1", ports[0]), period=period, timeout=10**9)
        self._state = RobotState(Q, np.array([1.5, 0.0, 1.2]), np.zeros(3))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.1)
        self._noise = np.random.default_rng(0).normal(0.0, 0.5, (256, 6))
        self.spent: tuple[list[float], list[float]] = ([], [])
        self._due = time.perf_counter()

    def cycle(self, i: int) -> None:
        """Cycle i; which one comes first changes every SWAP cycles."""
        c = self._controller
        self._block.write(np.array([time.monotonic(), i, 0.0, *(WRENCH + self._noise[i % 256])]))  # type: ignore[attr-defined]
        c.ipoc += round(1000 * self._period)
        packet = c.packet(self._state)
        for turn, which in enumerate((0, 1) if i // SWAP % 2 else (1, 0)):
            time.sleep(max(0.0, self._due + turn * APART * self._period - time.perf_counter()))
            spent = self._ask(packet, self._ports[which])
            self.spent[which].append(spent)
            if which == 0:
                c.count(spent <= self._period)
        self._due = max(self._due + self._period, time.perf_counter() - self._period)

    def _ask(self, packet: bytes, port: int) -> float:
        """Time to the answer, s."""
        began = time.perf_counter()
        self._socket.sendto(packet, ("127.0.0.1", port))
        while True:
            try:
                _, who = self._socket.recvfrom(4096)
            except TimeoutError:
                return time.perf_counter() - began
            if who[1] == port:
                return time.perf_counter() - began

    def end(self) -> None:
        """A last packet to each, so that they look whether they should end."""
        self._socket.sendto(self._controller.packet(self._state), ("127.0.0.1", self._ports[0]))
        self._socket.sendto(b"", ("127.0.0.1", self._ports[1]))
        self._socket.close()
        self._controller.close()


def bench_rsi(cycles: int, priority: int, period: float) -> dict:
    """Both answer in every cycle. `inside`: late ones for which the loop itself, from packet to answer, took half a period."""
    from irec_correction.rsi.report import KEPT
    from irec_correction.shared import WRENCH_SIZE, SharedValues

    context = multiprocessing.get_context("spawn")
    block, latency = SharedValues.create(WRENCH_SIZE), SharedValues.create(KEPT)
    processes, ports, pipes = [], [], []
    for target, extra in ((rsi, (block.name, latency.name, period)), (echo, ())):
        ours, theirs = context.Pipe()
        process = context.Process(target=target, args=(theirs, priority, *extra), daemon=True)
        process.start()
        ports.append(ours.recv())
        processes.append(process)
        pipes.append(ours)
    prefer_thread(priority)
    settle_memory()
    line = Line(ports, block, period)
    for i in range(WARM_UP):
        line.cycle(i)
    for spent in line.spent:
        spent.clear()
    before, stolen_before = [scheduling(p.pid) for p in processes], stolen()  # type: ignore[arg-type]
    inside = 0
    for i in range(cycles):
        line.cycle(WARM_UP + i)
        if line.spent[0][-1] > period:  # of the cycles since the last such one, none but this one can have been that long
            inside += bool(latency.numbers.max() > 0.5 * period)
            latency.numbers[:] = 0.0
    own = latency.numbers[latency.numbers > 0.0]
    after = [scheduling(p.pid) for p in processes]  # type: ignore[arg-type]
    pipes[0].send(None)
    line.end()
    for process in processes:
        process.join(2.0)
        if process.is_alive():
            process.kill()
    block.close()
    latency.close()
    reply, plain = (spread(s) for s in line.spent)
    late = [sum(t > period for t in s) for s in line.spent]
    both = sum(a > period and b > period for a, b in zip(*line.spent))
    system = {name: {k: round(z[k] - a[k], 3) for k in a} for name, a, z in zip(("reply", "echo"), before, after)}
    return {"cycles": cycles, "reply_us": reply, "echo_us": plain, "p99_ratio": round(reply["p99"] / plain["p99"], 2),
            **late_counts(*late), "late_in_one_cycle": both, "late_inside_the_loop": inside,
            "packet_to_answer_us": spread(own) if len(own) else {}, "system": system,
            "stolen_s": round(stolen() - stolen_before, 2)}  # fmt: skip


# --- offset topic --------------------------------------------------------------------------------------------------------

FEEDER = """
import sys, time, numpy as np, rclpy
from array import array
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
period, q, wrench = float(sys.argv[1]), {q}, np.array({wrench})
rclpy.init(); node = rclpy.create_node("feeder")
w_out, j_out = node.create_publisher(WrenchStamped, "wrench", 50), node.create_publisher(JointState, "joint_states", 50)
w, j = WrenchStamped(), JointState(name=[f"joint_{{k}}" for k in range(1, 7)] + ["ext_rail"], position=array("d", [*q, 0.0]))
w.header.frame_id = "tool0"; rng = np.random.default_rng(0); due = time.monotonic(); i = 0
while True:
    i += 1
    due += period
    time.sleep(max(0.0, due - time.monotonic()))
    stamp = node.get_clock().now().to_msg()
    if i % 2 == 0:
        j.header.stamp = stamp; j_out.publish(j)
    f = (wrench + rng.normal(0, 0.5, 6)).tolist()
    w.header.stamp = stamp
    w.wrench.force.x, w.wrench.force.y, w.wrench.force.z, w.wrench.torque.x, w.wrench.torque.y, w.wrench.torque.z = f
    w_out.publish(w)
"""
TIMER = """
import sys, rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.experimental import EventsExecutor
rclpy.init(); node = rclpy.create_node("bare_timer")
out = node.create_publisher(TransformStamped, "bare", 10); m = TransformStamped()
node.create_timer(float(sys.argv[1]), lambda: out.publish(m)); ex = EventsExecutor(); ex.add_node(node)
while rclpy.ok(): ex.spin_once(timeout_sec=1.0)
"""


WATCHER = """
import json, os, sys, time, rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.experimental import EventsExecutor
seconds, arrived = float(sys.argv[1]), {"irec/offset": [], "bare": []}
rclpy.init(); node = rclpy.create_node("watcher"); ex = EventsExecutor(); ex.add_node(node)
for topic, times in arrived.items():
    node.create_subscription(TransformStamped, topic, lambda _, t=times: t.append(time.monotonic()), 50, raw=True)
end = time.monotonic() + 60.0
while min(map(len, arrived.values())) < 100 and time.monotonic() < end: ex.spin_once(timeout_sec=0.1)
started = min(map(len, arrived.values())) >= 100
for times in arrived.values(): times.clear()
end = time.monotonic() + seconds
while started and time.monotonic() < end: ex.spin_once(timeout_sec=0.1)
print(json.dumps(arrived), flush=True)
os._exit(0)  # at once: ROS has crashed while it took a node down that others were still sending to
"""


def bench_topic(seconds: float, period: float, priority: int) -> dict:
    """Intervals of irec/offset as they arrive, beside those of a bare timer that publishes the same message."""
    environment = {**os.environ, "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "58"), "IREC_RT_PRIORITY": str(priority)}
    folder = tempfile.mkdtemp(prefix="irec_bench_")
    model = save_model(model_18(), Path(folder) / "model.yaml")
    node = ["-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}", "-p", "autostart:=true", "-p",
            "start_load:=10.0", "-p", f"model_path:={model}", "-p", f"rate:={1 / period}", "-p",
            f"wrench_rate:={1 / period}"]  # fmt: skip
    feeder = FEEDER.format(q=Q.tolist(), wrench=WRENCH.tolist())
    commands = [["-c", TIMER, str(period)], node, ["-c", feeder, str(period)]]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running = [subprocess.Popen([sys.executable, *c], env=environment, **quiet) for c in commands]  # type: ignore[call-overload]
    watcher = [sys.executable, "-c", WATCHER, str(seconds)]
    try:
        heard = subprocess.run(watcher, env=environment, stdout=subprocess.PIPE, timeout=seconds + 120.0, check=True)
    finally:
        for process in running:
            process.kill()
            process.wait()
    arrived = json.loads(heard.stdout)
    if not all(arrived.values()):
        raise SystemExit("offset topic: no messages within 60 s")
    result = {}
    for name, topic in (("offset_interval_us", "irec/offset"), ("timer_interval_us", "bare")):
        result[name] = {**spread(np.diff(arrived[topic])), "messages": len(arrived[topic])}
    return result


def main() -> int:
    """Run all parts; 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=5000, help="RSI cycles of 4 ms (default: 5000)")
    parser.add_argument("--calls", type=int, default=20000, help="evaluations and ticks (default: 20000)")
    parser.add_argument("--seconds", type=float, default=15.0, help="of listening to the offset topic (default: 15)")
    parser.add_argument("--priority", type=int, default=50, help="SCHED_FIFO of loop and yardstick alike, 0: none (default: 50)")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    figures: dict = {"load_average": os.getloadavg()[0], "deflection": bench_deflection(args.calls)}
    figures["chain_250_hz"], figures["chain_1_khz"] = bench_chain(args.calls, PERIOD), bench_chain(args.calls, 0.001)
    figures["topic_250_hz"] = bench_topic(args.seconds, PERIOD, args.priority)
    figures["topic_1_khz"] = bench_topic(args.seconds, 0.001, args.priority)
    figures["rsi_4_ms"] = bench_rsi(args.cycles, args.priority, PERIOD)
    figures["rsi_1_ms"] = bench_rsi(args.cycles, args.priority, 0.001)
    deflection, tick = figures["deflection"], figures["chain_250_hz"]["tick_us"]
    met = {
        f"deflection at most {TARGET_DEFLECTION_US:.0f} us median": deflection["compiled_us"]["p50"] <= TARGET_DEFLECTION_US,
        f"{TARGET_FASTER:.0f} times faster than plain": deflection["faster"] >= TARGET_FASTER,
        f"tick at most {TARGET_TICK_US:.0f} us median": tick["p50"] <= TARGET_TICK_US,
        f"RSI reply p99 at most {TARGET_REPLY} of a bare echo": figures["rsi_4_ms"]["p99_ratio"] <= TARGET_REPLY,
    }
    if args.cycles >= CYCLES_TO_JUDGE_LATE:
        met["no more late replies than the echo"] = figures["rsi_4_ms"]["late"] <= figures["rsi_4_ms"]["echo_late"]
    for part, values in figures.items():
        print(f"{part}: {json.dumps(values)}")
    for text, ok in met.items():
        print(f"{'met   ' if ok else 'MISSED'} {text}")
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps({**figures, "met": met}, indent=2))
    return 0 if all(met.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
