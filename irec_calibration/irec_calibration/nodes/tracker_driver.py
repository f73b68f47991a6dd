# SPDX-License-Identifier: Apache-2.0
"""Tracker driver of the contract for point streams over TCP or UDP, and for topics that are stamped late and in bursts.

    ros2 run irec_calibration tracker_driver --ros-args -p source:=tcp://192.168.0.1:700 -p format:=emscon -p station:=A
    ... -p source:=udp://192.168.0.5:10000 -p format:=lines -p columns:=time,x,y,z -p unit:=mm -p station:=A
    ... -p source:=topic:leica/point -p period:=0.1 -p station:=A

Reads only: nothing is sent to the tracker. The address of udp:// is this machine's on the tracker's network. The stamp of a point
is the time of its measurement, by the tracker's clock or its place in the stream; diagnostics say how late it came.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from urllib.parse import urlsplit

from geometry_msgs.msg import PointStamped
from irec_ros.diagnostics import ERROR, OK, WARN, Diagnostics, status
from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_node
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ..drivers.stamps import Restamper
from ..drivers.tracker_stream import UNITS, EmScon, Lines, Reading, StreamError
from ..errors import IrecError

RETRY = 1.0  # s between two tries to connect
QUIET = 0.2  # s that a read waits, so that the node can end
EVERYWHERE = ("0.0.0.0", "0", "::")
NO_POINTS = 2.0  # s without a point that are worth a warning
SENSORS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
EITHER = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
PARAMETERS = (
    P("source", "", "tcp://HOST:PORT (connects), udp://ADDRESS:PORT (listens at this own address), topic:NAME of PointStamped"),
    P("format", "lines", "of a socket's bytes: lines, or emscon (Leica)"),
    P("columns", "x,y,z", "what stands where in a line: x, y, z, time, station, -; separated by commas"),  # a list: y is true
    P("unit", "mm", f"of the coordinates of a socket: {', '.join(UNITS)}"),
    P("time_unit", "s", "of column time: s, ms, us"),
    P("station", "", "name of the station in the cell file; empty: as the stream names it"),
    P("period", 0.0, "between readings of a stream that sends no time; 0: stamped when they come", 0.0, 10.0, "s"),
    P("delay", 0.0, "least delay of the way from tracker to this machine, e.g. from irec align", 0.0, 2.0, "s"),
    P("longest_burst", 0.5, "readings may be held up together for so long", 0.01, 10.0, "s"),
)


class TrackerDriver(GuardedNode):
    """One stream to `tracker/point`. Parameters: see PARAMETERS."""

    def __init__(self) -> None:
        super().__init__("tracker")
        p = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        self._station = p["station"]
        self._kind, self._where = _source(p["source"])
        self._columns = tuple(name.strip() for name in p["columns"].split(","))
        if self._kind != "topic" and p["format"] == "lines" and not self._station and "station" not in self._columns:
            raise StreamError("parameter 'station' is empty, and no column of the lines names it")
        self._settings = p
        self._parser = self._new_parser()
        self._stamps = Restamper(p["period"], p["delay"], p["longest_burst"])
        self._health = Diagnostics(self)
        self._out = self.create_publisher(PointStamped, "tracker/point", SENSORS)
        self.sent, self._left_out, self._last_arrival, self._problem = 0, 0, time.monotonic(), ""
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        if self._kind == "topic":
            if self.resolve_topic_name(self._where) == self.resolve_topic_name("tracker/point"):
                raise StreamError("source and tracker/point are one topic; remap one of them")
            self.create_subscription(PointStamped, self._where, self._on_point, EITHER)
        else:
            self._thread = threading.Thread(target=self._read, name="tracker", daemon=True)
            self._thread.start()
        self.create_timer(1.0, self._publish_status, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _new_parser(self) -> Lines | EmScon:
        p = self._settings
        if p["format"] == "emscon":
            return EmScon(p["unit"])
        if p["format"] != "lines":
            raise StreamError(f"parameter 'format' is '{p['format']}'; lines or emscon is needed")
        return Lines(self._columns, p["unit"], p["time_unit"])

    def close(self) -> None:
        """End the reading thread."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(2.0)

    def _on_point(self, m: PointStamped) -> None:
        p = m.point
        station = self._station or m.header.frame_id
        # a period says that the stamps are worth nothing; else they are the source's own clock
        t = None if self._stamps.period > 0.0 else m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        self._take(self._arrival(), Reading((p.x, p.y, p.z), t, station))

    def _arrival(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _take(self, arrival: float, reading: Reading) -> None:
        self._last_arrival, self._problem = time.monotonic(), ""
        stamp = self._stamps.stamp(arrival, reading.t)
        if stamp is None:
            self._left_out += 1
            return
        m = PointStamped()
        nanoseconds = max(round(1e9 * stamp), 1)
        m.header.stamp.sec, m.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
        m.header.frame_id = self._station or reading.station
        m.point.x, m.point.y, m.point.z = reading.p
        if not self._ending.is_set():
            self._out.publish(m)
            self.sent += 1

    def _read(self) -> None:
        host, port = self._where.rsplit(":", 1)
        while not self._ending.is_set():
            try:
                self._read_one(host, int(port))
            except (OSError, StreamError) as error:
                self._problem = f"{self._kind}://{self._where}: {error}"
                self._ending.wait(RETRY)
            except Exception as error:  # a thread has nobody above it; the node goes on and says so
                self._problem = f"unexpected error, please report it: {type(error).__name__}: {error}"
                self.get_logger().error(self._problem)
                self._ending.wait(RETRY)

    def _read_one(self, host: str, port: int) -> None:
        """Until the connection ends; raises OSError, StreamError."""
        parser = self._parser = self._new_parser()
        datagrams = self._kind == "udp"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if datagrams else socket.SOCK_STREAM) as s:
            s.settimeout(QUIET if datagrams else 3.0)
            if datagrams:
                s.bind((host, port))
            else:
                s.connect((host, port))
                s.settimeout(QUIET)
            while not self._ending.is_set():
                try:
                    data = s.recv(65536)
                except TimeoutError:
                    continue
                if not data and not datagrams:
                    raise OSError("the tracker's side has closed the connection")
                arrival = self._arrival()
                for reading in parser.feed(data + b"\n" if datagrams and isinstance(parser, Lines) else data):
                    self._take(arrival, reading)

    def _publish_status(self) -> None:
        quiet = time.monotonic() - self._last_arrival
        values = {"points": self.sent, "left out": self._left_out, "not readable": self._parser.bad}
        if self._problem:
            level, text = ERROR, self._problem
        elif quiet > NO_POINTS:
            level, text = WARN, f"no point for {quiet:.0f} s: beam broken, or not measuring"
        elif self._parser.bad:
            level, text = WARN, f"{self._parser.bad} lines or packets could not be read, the newest: {self._parser.last_bad}"
        else:
            level, text = OK, self._stamps.lateness_text()
        self._health.publish(status(self, "tracker", level, text, values, self._station))


def _source(text: str) -> tuple[str, str]:
    """Kind, and topic or HOST:PORT. StreamError."""
    if text.startswith("topic:") and len(text) > len("topic:"):
        return "topic", text.removeprefix("topic:")
    try:
        parts = urlsplit(text)
        if parts.scheme == "udp" and parts.hostname in EVERYWHERE:
            raise StreamError(
                f"parameter 'source' is '{text}', which listens on every network; name the address on the tracker's one"
            )
        if parts.scheme in ("tcp", "udp") and parts.hostname and parts.port:
            return parts.scheme, f"{parts.hostname}:{parts.port}"
    except ValueError:
        pass
    raise StreamError(f"parameter 'source' is '{text}'; tcp://HOST:PORT, udp://ADDRESS:PORT or topic:NAME is needed")


def main() -> int:
    """Until SIGINT, SIGTERM or SIGHUP; 2 where a parameter is wrong."""
    return run_process("tracker_driver", _work, IrecError)


def _work(asked_to_stop: threading.Event) -> None:
    node = TrackerDriver()
    try:
        spin_node(node, asked_to_stop)
    finally:
        node.close()


if __name__ == "__main__":
    sys.exit(main())
