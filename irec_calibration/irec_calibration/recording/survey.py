# SPDX-License-Identifier: Apache-2.0
"""What a recording holds: topics, rates, gaps, stamps against log times, and what it lacks to be a session."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..errors import IrecError, RecordingError
from ..files.yaml_text import YamlProblem, parse_yaml
from ..robot import Robot
from ..typing import Array
from .frames import FRAMES, frame_of, misplaced
from .read import BagReader, RawMessage, Topic

GAP_FACTOR = 3.0  # an interval this many times the usual one is a gap
BURST_FACTOR = 5.0  # a mean interval this many times the median one means that messages come in bursts
SAME_CLOCK = 3600.0  # s; stamps further from the log time than this come from another clock
CLOCK_OFF = 0.3  # s between stamps and log times, by which the clocks differ; delays alone are less, for some of the messages
_LARGEST_GAPS = 5
MOST_FRAMES = 4  # of one topic that are told
# Hz, by message type: below the first a window of the procedure (0.4 s) has too few readings; the second is what a driver
# of the correction delivers
NEEDED_RATES = {
    "sensor_msgs/msg/JointState": (50.0, 100.0),
    "geometry_msgs/msg/WrenchStamped": (100.0, 250.0),
    "geometry_msgs/msg/PointStamped": (50.0, 100.0),
    "geometry_msgs/msg/PoseStamped": (50.0, 100.0),
}


@dataclass(frozen=True)
class Skew:
    """Log time minus header stamp, s: how late messages were when they were recorded, and how steadily."""

    minimum: float
    median: float
    maximum: float
    std: float

    @property
    def same_clock(self) -> bool:
        return abs(self.median) < SAME_CLOCK

    @property
    def off(self) -> float:
        """By how much the stamps are behind (positive) or ahead of the log times, s, where no delay explains it; else 0.

        The least lag counts: what held some messages up did not hold all of them up.
        """
        if not self.same_clock:
            return 0.0
        return self.minimum if self.minimum > CLOCK_OFF else self.median if self.median < -CLOCK_OFF else 0.0


@dataclass(frozen=True)
class Gap:
    """An interval without messages: start in s since the first message of the recording, length in s."""

    start: float
    length: float


@dataclass(frozen=True)
class TopicSurvey:
    """One topic. Times by header stamp where the type has one (`stamped`), else by log time.

    rate in Hz; interval: the usual one in s; bursts: several come at once, so their times are not the times of reading;
    backwards, repeated: stamps earlier than, or the same as, the one before; missing: messages that the file's statistics
    count and that could not be read.
    """

    name: str
    type_name: str
    count: int
    stamped: bool
    rate: float
    interval: float
    gaps: tuple[Gap, ...]
    gap_count: int
    bursts: bool
    backwards: int
    repeated: int
    skew: Skew | None
    missing: int


@dataclass(frozen=True)
class Survey:
    """A whole recording. duration in s of log time; losses as in BagReader."""

    path: str
    files: tuple[str, ...]
    duration: float
    topics: tuple[TopicSurvey, ...]
    attachments: tuple[str, ...]
    metadata: dict[str, dict[str, str]]
    losses: tuple[str, ...]
    present: tuple[str, ...]
    lacking: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass
class _Series:
    topic: Topic
    header_stamp: bool
    first: RawMessage
    log: list[int] = field(default_factory=list)
    stamp: list[int] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)


def survey(bag: BagReader, progress: Callable[[int, int], None] | None = None) -> Survey:
    """Read the whole recording once. RecordingError where it is not MCAP at all."""
    series: dict[str, _Series] = {}
    for message in bag.messages(progress=progress):
        entry = series.get(message.topic.name)
        if entry is None:
            entry = series[message.topic.name] = _Series(message.topic, _begins_with_header(message.topic), message)
        entry.log.append(message.log_time)
        if entry.header_stamp:
            entry.stamp.append(_header_stamp(message.data) if len(message.data) >= 12 else message.log_time)
            if message.topic.type_name in FRAMES and len(entry.frames) < MOST_FRAMES:
                entry.frames.add(frame_of(message.data))
    start = min((entry.log[0] for entry in series.values()), default=0)
    end = max((max(entry.log) for entry in series.values()), default=0)
    expected = bag.expected or {}
    topics = [_survey_topic(entry, start, expected.get(name)) for name, entry in sorted(series.items())]
    for name, topic in bag.topics.items():
        if name not in series:
            absent = expected.get(name, 0)
            topics.append(TopicSurvey(name, topic.type_name, 0, False, 0.0, 0.0, (), 0, False, 0, 0, None, absent))
    present, lacking = _for_a_session(bag, series)
    lacking += misplaced({name: (entry.topic.type_name, entry.frames) for name, entry in series.items()})
    lacking += _slow(topics)
    return Survey(
        path=str(bag.path),
        files=tuple(file.name for file in bag.files),
        duration=(end - start) * 1e-9,
        topics=tuple(topics),
        attachments=tuple(sorted(bag.attachments)),
        metadata=dict(bag.metadata),
        losses=tuple(bag.losses),
        present=tuple(present),
        lacking=tuple(lacking),
    )


def _begins_with_header(topic: Topic) -> bool:
    if topic.message_encoding != "cdr" or topic.schema is None or topic.schema.encoding != "ros2msg":
        return False
    for line in topic.schema.data.decode("utf-8", "replace").splitlines():
        code = line.split("#", 1)[0].split()
        if code:
            return code[0] in ("std_msgs/Header", "std_msgs/msg/Header", "Header")
    return False


def _header_stamp(data: bytes) -> int:
    """Stamp in ns of a serialized message that begins with a std_msgs/Header (CDR, either byte order)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _survey_topic(entry: _Series, start: int, expected: int | None) -> TopicSurvey:
    log = np.array(entry.log, dtype=np.int64)
    stamp = np.array(entry.stamp, dtype=np.int64) if entry.header_stamp else log
    step = np.diff(stamp)
    time = np.unique(stamp)
    intervals: Array = np.diff(time) * 1e-9
    rate = intervals.size / float(intervals.sum()) if intervals.size else 0.0
    interval = float(np.median(intervals)) if intervals.size else 0.0
    bursts = intervals.size > 2 and BURST_FACTOR * interval * rate < 1.0
    if bursts:
        interval = 1.0 / rate
    wide = np.flatnonzero(intervals > GAP_FACTOR * interval) if intervals.size > 2 else np.zeros(0, dtype=np.int64)
    largest = sorted(wide[np.argsort(-intervals[wide])][:_LARGEST_GAPS])
    late = (log - stamp) * 1e-9
    skew = Skew(float(late.min()), float(np.median(late)), float(late.max()), float(late.std())) if entry.header_stamp else None
    origin = start
    if skew is not None and not skew.same_clock:
        origin = int(time[0])
    return TopicSurvey(
        name=entry.topic.name,
        type_name=entry.topic.type_name,
        count=len(log),
        stamped=entry.header_stamp,
        rate=rate,
        interval=interval,
        gaps=tuple(Gap((int(time[i]) - origin) * 1e-9, float(intervals[i])) for i in largest),
        gap_count=len(wide),
        bursts=bursts,
        backwards=int((step < 0).sum()),
        repeated=int((step == 0).sum()),
        skew=skew,
        missing=max((expected or 0) - len(log), 0),
    )


def clocks_apart(topics: Sequence[TopicSurvey]) -> list[str]:
    """A sentence for each topic whose stamps are of another clock than those of most others: its readings are of other moments.

    What all of them are off by alike is the difference to whoever recorded, and puts nothing beside anything else.
    """
    known = [(t, t.skew) for t in topics if t.type_name in NEEDED_RATES and t.skew is not None and t.skew.same_clock]
    if len(known) < 3:  # of two nobody knows which
        return []
    least, middle = (float(np.median([getattr(s, name) for _, s in known])) for name in ("minimum", "median"))
    out = []
    for topic, skew in known:
        apart = min(skew.minimum - least, skew.median - middle, key=abs)
        if abs(apart) > CLOCK_OFF and (skew.minimum - least) * (skew.median - middle) > 0.0:
            out.append(
                f"the stamps of {topic.name} are {1e3 * abs(apart):.0f} ms {'behind' if apart > 0 else 'ahead of'} those of the"
                f" other topics, by the times at which they were received, limit {1e3 * CLOCK_OFF:.0f} ms: its readings are of"
                " other moments than those that stand beside them; let the clocks agree (chrony, PTP) and record again"
            )
    return out


def _slow(topics: list[TopicSurvey]) -> list[str]:
    """A sentence for each topic that comes too seldom for what it is needed for."""
    out = []
    for topic in topics:
        least, usual = NEEDED_RATES.get(topic.type_name, (0.0, 0.0))
        if topic.count > 2 and topic.rate < least:
            out.append(
                f"rate: {topic.name} comes at {topic.rate:.1f} Hz; the procedure needs {least:g} Hz, a driver gives {usual:g} Hz"
                " (a session of standing poses can be made from less)"
            )
        elif topic.type_name == "geometry_msgs/msg/WrenchStamped" and topic.count > 2 and topic.rate < 0.9 * usual:
            out.append(f"rate: {topic.name} comes at {topic.rate:.1f} Hz; the live correction needs {usual:g} Hz")
    return out


def _for_a_session(bag: BagReader, series: dict[str, _Series]) -> tuple[list[str], list[str]]:
    """What of a calibration session is there and what is not, one sentence each, by message type and not by topic name."""
    present: list[str] = []
    lacking: list[str] = []

    def topics_of(type_name: str) -> list[str]:
        return sorted(name for name, entry in series.items() if entry.topic.type_name == type_name)

    def note(type_name: str, found: str, absent: str) -> list[str]:
        names = topics_of(type_name)
        if names:
            present.append(f"{found}: {', '.join(names)}")
        else:
            lacking.append(absent)
        return names

    for name in note("sensor_msgs/msg/JointState", "joint angles", "joint angles: no sensor_msgs/JointState"):
        try:
            joints = [str(joint) for joint in bag.decode(series[name].first).name]
        except (RecordingError, AttributeError, TypeError) as error:
            lacking.append(f"joint angles that can be read: {error}")
            continue
        if "joint_1" not in joints and not _says_itself(bag, joints):
            lacking.append(
                f"{name} names its joints {', '.join(joints)}; a session calls them joint_1 to joint_n: "
                "list them from base to tool in the mapping file (joints: names) or as robot.joint_names of session.yaml"
            )
    note(
        "geometry_msgs/msg/PointStamped",
        "marker positions",
        "marker positions: no geometry_msgs/PointStamped of a tracker (irec solve --without-tracker needs none)",
    )
    note(
        "geometry_msgs/msg/WrenchStamped",
        "forces",
        "forces: no geometry_msgs/WrenchStamped (only an absolute session does without)",
    )
    if not topics_of("geometry_msgs/msg/PoseStamped"):
        lacking.append("TCP pose by the controller: no geometry_msgs/PoseStamped (can be computed from a robot description)")
    else:
        present.append(f"TCP pose by the controller: {', '.join(topics_of('geometry_msgs/msg/PoseStamped'))}")
    described = any(name.endswith(".urdf") for name in bag.attachments) or any("robot_description" in n for n in series)
    (present if described else lacking).append(
        "robot description" if described else "robot description: neither an attached .urdf nor /robot_description"
    )
    if any(name == "session.yaml" for name in bag.attachments):
        present.append("station poses, marker, noise and load cases: session.yaml")
    else:
        lacking.append("pose of the tracker station, marker in tool0, noise and load cases: no attached session.yaml")
    note(
        "irec_msgs/msg/LoadCaseRecord",
        "poses and load cases",
        "which samples belong to which pose and load case: no irec_msgs/LoadCaseRecord",
    )
    return present, lacking


def _says_itself(bag: BagReader, joints: list[str]) -> bool:
    """Whether session.yaml and robot description, attached, say which of these joints is which, as a session is read."""
    try:
        listed = parse_yaml(bag.attachments["session.yaml"].decode("utf-8-sig"))[0]["robot"].get("joint_names")
        names = listed or Robot(bag.attachments["robot.urdf"].decode("utf-8-sig"), "robot.urdf").joint_names
        return set(names) <= set(joints)
    except (KeyError, TypeError, AttributeError, UnicodeDecodeError, YamlProblem, IrecError):  # of those `irec check` tells
        return False
