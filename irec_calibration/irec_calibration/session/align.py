# SPDX-License-Identifier: Apache-2.0
"""A foreign recording (joint states and tracker points as topics, no load cases) to an `absolute` session.

Each tracker point becomes a row with the joint angles at its time. Times are header stamps; whether the two sources agree
about time is found from the motion itself and reported: a delay between them looks like a geometric error that follows the
velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from ..errors import SessionError
from ..files import read_document
from ..joint_states import contradiction, named_twice
from ..recording import BagReader
from ..robot import Robot
from ..typing import Array, IntArray, Json
from .columns import Columns
from .data import Session
from .header import FORMAT as SESSION_FORMAT
from .header import described, parse_header
from .table import session_from_columns

FORMAT = "irec-align/1"
LONGEST_DELAY = 0.3  # s, either way
GRID = 61
BLOCKS = 8  # the recording is cut into as many parts for the error of the delay
BURSTY = 0.2  # share of intervals far below the mean from which stamps are those of bursts
MOVING = 0.02  # rad/s, fastest joint; slower, a delay does not show
TYPES = {"joints": "sensor_msgs/msg/JointState", "marker": "geometry_msgs/msg/PointStamped"}


@dataclass(frozen=True)
class Delay:
    """How far the joint states lag behind the tracker by their stamps: q(stamp + value) belongs to the point at stamp.

    Attributes:
        value_s, se_s: NaN where the robot does not move enough.
        rms_before_m, rms_after_m: residual of the free linear fit without and with it.
        log_minus_stamp_s: smallest and largest, of joints and of points.
        bursts_s: largest distance of a point's stamp from regular sampling where points came in bursts, else 0.
    """

    value_s: float
    se_s: float
    rms_before_m: float
    rms_after_m: float
    log_minus_stamp_s: dict[str, tuple[float, float]]
    bursts_s: float = 0.0


class _TextColumns(Columns):
    """Columns made from a recording; places are named by tracker point."""

    def __init__(self, path: Path, text: dict[str, list[str]]) -> None:
        self.path, self.names, self._text = path, list(text), text
        self.lines = list(range(1, len(next(iter(text.values()))) + 1))
        self.used: set[str] = set()

    def where(self, row: int, name: str) -> str:
        return f"{self.path}: tracker point {self.lines[row]}: {name}"


def align_bag(path: str | Path, profile: str | Path) -> tuple[Session, Delay]:
    """Read a foreign recording.

    Args:
        path: MCAP file or rosbag2 folder.
        profile: mapping file (`irec-align/1`): `session:` (content of session.yaml, URDF relative to the profile), and optionally
            `joints: {topic:, names: [...]}`, `marker: {topic:, scale: metres per unit}`, `delay: seconds` (found from the motion
            where absent).

    Raises:
        SessionError: topics or joints missing; names them.
    """
    path, profile = Path(path), Path(profile)
    mapping = _mapping(profile)
    bag = BagReader(path)
    read = _read(bag, mapping, path, _number(mapping.get("marker") or {}, "scale", 1.0, profile))
    header_data = {"format": SESSION_FORMAT, "kind": "absolute", **mapping["session"]}
    urdf = profile.parent / str(mapping["session"]["robot"].get("urdf", ""))
    robot = described(urdf, profile)
    t_q, q = read["joints"]
    t_p, p = read["marker"]
    if q.shape[1] != robot.n_joints:
        raise SessionError(
            f"{path}: {q.shape[1]} joints are recorded, {urdf} has {robot.n_joints}; name them in the profile: joints: names"
        )
    t_p, bursts = _without_bursts(t_p)
    inside = (t_p > t_q[0] + LONGEST_DELAY) & (t_p < t_q[-1] - LONGEST_DELAY)
    if inside.sum() < 10:
        raise SessionError(f"{path}: only {inside.sum()} tracker points lie within the time of the joint states")
    t_p, p = t_p[inside], p[inside]
    try:
        delay = replace(_delay(robot, t_q, q, t_p, p, read["log"]), bursts_s=bursts)
    except np.linalg.LinAlgError as error:
        raise SessionError(f"{path}: no delay between joint states and tracker points is found ({error}): odd values?") from error
    applied = _number(mapping, "delay", delay.value_s if np.isfinite(delay.value_s) else 0.0, profile)
    rows = _at(t_q, q, t_p + applied)
    columns: dict[str, list[str]] = {
        "pose": [str(i + 1) for i in range(len(t_p))],
        "stamp": [repr(float(t - t_p[0])) for t in t_p],
        **{f"joint_{k + 1}": [repr(float(v)) for v in rows[:, k]] for k in range(robot.n_joints)},
        **{f"marker_{a}": [repr(float(v)) for v in p[:, i]] for i, a in enumerate("xyz")},
    }
    header = parse_header(header_data, f"{profile}: session", profile.parent)
    session = session_from_columns(header, robot, _TextColumns(path, columns), path)
    return session, delay


def in_words(delay: Delay) -> list[str]:
    """What is to be known about the timing, as sentences."""
    out = [
        f"{name}: written to the file {1e3 * low:.1f} .. {1e3 * high:.1f} ms after the header stamp"
        for name, (low, high) in delay.log_minus_stamp_s.items()
    ]
    if delay.bursts_s > 0.0:
        out.append(
            f"tracker points come in bursts: their stamps are times of arrival, up to {1e3 * delay.bursts_s:.0f} ms off "
            "regular sampling; regular times are taken instead"
        )
    if not np.isfinite(delay.value_s):
        return [*out, "the robot hardly moves: a delay between joint states and tracker does not show and none is applied"]
    when = "after" if delay.value_s > 0 else "before"
    out.append(
        f"skew: a tracker point belongs to the joint states stamped {1e3 * abs(delay.value_s):.1f} "
        f"+- {1e3 * delay.se_s:.1f} ms {when} it; "
        f"taken out, the misfit falls from {1e3 * delay.rms_before_m:.2f} to {1e3 * delay.rms_after_m:.2f} mm rms"
    )
    return out


def _mapping(profile: Path) -> Json:
    return dict(read_document(profile, FORMAT, "profile", SessionError).data)


def _number(mapping: Json, key: str, default: float, profile: Path) -> float:
    value = mapping.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SessionError(f"{profile}: {key} is {value!r}; a number is needed")
    return float(value)


def _read(bag: BagReader, mapping: Json, path: Path, scale: float) -> dict[str, Any]:
    list(bag.messages(()))  # topics are known only after the files were walked through
    topic = {}
    for key, type_name in TYPES.items():
        given = (mapping.get(key) or {}).get("topic")
        of_type = [t.name for t in bag.topics.values() if t.type_name == type_name]
        if given is None and len(of_type) != 1:
            raise SessionError(
                f"{path}: {len(of_type)} topics of type {type_name} ({', '.join(of_type) or 'none'}); name one: {key}: topic"
            )
        topic[key] = given or of_type[0]
        if topic[key] not in bag.topics:
            raise SessionError(f"{path}: there is no topic {topic[key]}; there are {', '.join(sorted(bag.topics))}")
        if (found := bag.topics[topic[key]].type_name) != type_name:
            raise SessionError(f"{path}: topic {topic[key]} is of type {found}, {type_name} is needed for {key}")
    names = (mapping.get("joints") or {}).get("names")
    stamps: dict[str, list[tuple[float, float, list[float]]]] = {"joints": [], "marker": []}
    for message in bag.messages(set(topic.values())):
        content = bag.decode(message)
        at = content.header.stamp.sec + 1e-9 * content.header.stamp.nanosec
        if message.topic.name == topic["joints"]:
            wanted = names or list(content.name)
            missing = [n for n in wanted if n not in content.name]
            if missing:
                raise SessionError(f"{path}: {topic['joints']} has no joint '{missing[0]}'; it has {', '.join(content.name)}")
            if why := contradiction(named_twice(content.name, wanted), content.position):
                raise SessionError(f"{path}: {topic['joints']}: {why}")
            values = [float(content.position[list(content.name).index(n)]) for n in wanted]
            stamps["joints"].append((at, 1e-9 * message.log_time, values))
        else:
            stamps["marker"].append((at, 1e-9 * message.log_time, [content.point.x, content.point.y, content.point.z]))
    out: dict[str, Any] = {"log": {}}
    for key, items in stamps.items():
        if len(items) < 10:
            raise SessionError(f"{path}: only {len(items)} messages on {topic[key]}")
        t = np.array([i[0] for i in items])
        order = np.argsort(t, kind="stable")
        keep = order[np.concatenate([[True], np.diff(t[order]) > 0])]
        values = np.array([i[2] for i in items])[keep] * (scale if key == "marker" else 1.0)
        late = np.array([i[1] for i in items]) - t
        out[key] = (t[keep], values)
        out["log"][topic[key]] = (float(late.min()), float(late.max()))
    return out


def _without_bursts(t: Array) -> tuple[Array, float]:
    """Times of regular sampling for points that were stamped in bursts; the stamps themselves otherwise."""
    step = np.diff(t)
    if len(t) < 10 or (step < 0.3 * step.mean()).mean() < BURSTY:
        return t, 0.0
    n = np.arange(len(t))
    slope, start = np.polyfit(n, t, 1)
    regular = start + slope * n
    return regular, float(np.abs(t - regular).max())


def _at(t_q: Array, q: Array, t: Array) -> Array:
    return np.stack([np.interp(t, t_q, q[:, k]) for k in range(q.shape[1])], axis=1)


def _delay(robot: Robot, t_q: Array, q: Array, t_p: Array, p: Array, log: dict[str, tuple[float, float]]) -> Delay:
    """Delay that lets a free linear map from (p_tcp, R_tool) to the tracker's points fit best."""
    # kinematics on the joint states once; interpolating positions and rotations of neighbouring samples is exact enough
    kin = robot.kinematics(q)
    features = np.column_stack([np.ones(len(q)), kin.p_tcp, kin.R_tool.reshape(len(q), 9)])

    def misfit(delay: float, rows: IntArray | slice = slice(None)) -> float:
        A = _at(t_q, features, t_p[rows] + delay)
        scale = np.maximum(np.abs(A).max(axis=0), 1e-12)
        x = np.linalg.lstsq(A / scale, p[rows], rcond=1e-8)[0]
        return float(np.sqrt(((p[rows] - A / scale @ x) ** 2).sum(axis=1).mean()))

    speed = np.abs(np.gradient(_at(t_q, q, t_p), t_p, axis=0)).max()
    if speed < MOVING:
        return Delay(float("nan"), float("nan"), misfit(0.0), misfit(0.0), log)

    def best(rows: IntArray | slice = slice(None)) -> float:
        grid = np.linspace(-LONGEST_DELAY, LONGEST_DELAY, GRID)
        at = float(grid[int(np.argmin([misfit(d, rows) for d in grid]))])
        step = grid[1] - grid[0]
        return float(minimize_scalar(lambda d: misfit(d, rows), bounds=(at - step, at + step), method="bounded").x)

    value = best()
    part = np.arange(len(t_p)) * BLOCKS // len(t_p)
    without = np.array([best(np.flatnonzero(part != b)) for b in range(BLOCKS)])
    se = float(np.sqrt((BLOCKS - 1) / BLOCKS * ((without - without.mean()) ** 2).sum()))
    return Delay(value, se, misfit(0.0), misfit(value), log)
