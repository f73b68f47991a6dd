# SPDX-License-Identifier: Apache-2.0
"""The recording of one run of Procedure 1: what belongs to the session beside its messages, and going on with a broken run."""

from __future__ import annotations

import contextlib
import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..cell import LOAD_CASE_NAMES, Cell, Section
from ..errors import CellError, SessionError
from ..files.regular import URDF_LIMIT, read_text
from ..files.yaml_text import YamlProblem, parse_yaml
from ..recording import BagReader, BagWriter, TypeCatalogue
from ..recording.held_file import lock
from ..session import record_message
from ..session.header import FORMAT
from ..session.mcap_io import attach_session
from ..typing import Array
from .resumed import check_places, check_same

ORDER = "for each pose and repeat: numpy.random.default_rng([seed, pose, repeat]).permutation(number of load cases) + 1"


def session_header(cell: Cell, name: str, order_seed: int | None = None) -> dict[str, Any]:
    """Content of session.yaml for a run in a cell; order_seed: see Procedure."""
    sensor = Section(cell.path, "", cell.raw).section("force_sensor")
    header: dict[str, Any] = {
        "format": FORMAT,
        "name": name,
        "kind": "loaded",
        "robot": {"urdf": "robot.urdf", "serial": cell.serial},
        "marker_in_tool0": [float(v) for v in cell.marker_in_tool],
        "stations": [dict(station) for station in cell.raw["stations"]],
        "noise": dict(cell.noise),
        "load_cases": {j: [float(v) for v in f] for j, f in enumerate(cell.forces_in_tool, 1)},
        "load_case_names": dict(enumerate(LOAD_CASE_NAMES, 1)),
        "sensor_axis_in_tool": [float(v) for v in sensor.vector("axis_in_tool0", 3)],
    }
    if cell.without_tracker:
        header["without_tracker"] = True
    if cell.tool_name:
        header["tool"] = cell.tool_name
    if order_seed is not None:
        header["load_case_order"] = {"seed": order_seed, "drawn": ORDER}
    if cell.payload.mass > 0.0:
        header["payload"] = {"mass": cell.payload.mass, "com": [float(v) for v in cell.payload.com]}
    if cell.rail is not None:
        header["ext_axes"] = {"rail": {"kind": "prismatic", "axis": [float(v) for v in cell.rail.axis]}}
    return header


def refuse_changed(cell: Cell) -> None:
    """A run goes by what was read when the node was started; what is written there now would not be what it does.

    Raises:
        CellError: cell file or robot description are not what they were then.
    """
    for path, text, what in (
        (cell.path, cell.text, "the cell file"), (Path(cell.robot.source), cell.robot.urdf_text, "the robot description")
    ):  # fmt: skip
        now = read_text(path, what, CellError, URDF_LIMIT)
        if now != text:
            lines = zip(now.splitlines(), text.splitlines(), strict=False)
            place = next((k for k, (new, old) in enumerate(lines, 1) if new != old), 1 + min(now.count("\n"), text.count("\n")))
            raise CellError(
                f"{path}:{place}: {what} was changed after this node had read it, and a run would go by what it held then;"
                " start the node anew, or put the old file back"
            )


class SessionRecorder:
    """Writes one session recording, from the beginning or going on where a broken run ended.

    Args:
        path: MCAP file to write; its `.part` beside it is used while an earlier recording is copied.
        parameters: of the node, for the record.
        resume: copy what `path` holds already, then go on.
        planned: pose -> joint positions, rad, and rail, m, in contact; what the earlier part measured has to be there.
        order_seed: draws the order of the load cases; that of the earlier part goes on where there is one.

    Attributes:
        done: (pose, repeat) that are complete already.
        time_offset: s that the new part begins after the session's beginning.

    Raises:
        SessionError: the file exists and `resume` is not wanted, or does not exist and it is; another cell recorded it.
        RecordingError: another process records to it.
    """

    def __init__(
        self, path: Path, cell: Cell, parameters: dict[str, Any], catalogue: TypeCatalogue | None = None, resume: bool = False,
        order_seed: int | None = None, planned: Mapping[int, Array] | None = None,
    ) -> None:  # fmt: skip
        self.path, self.order_seed = path, order_seed
        if resume and not path.is_file():
            raise SessionError(f"{path}: there is no recording to go on with; start a new run")
        if not resume and path.exists():
            raise SessionError(f"{path}: exists already; name another file, or ask to resume it")
        with contextlib.ExitStack() as held:
            if resume:  # until the new part has taken its place, which is locked as well
                lock(held.enter_context(open(path, "rb")), path)
            self._begin(cell, parameters, catalogue, BagReader(path) if resume else None, planned or {})

    def _begin(
        self, cell: Cell, parameters: dict[str, Any], catalogue: TypeCatalogue | None, old: BagReader | None,
        planned: Mapping[int, Array],
    ) -> None:  # fmt: skip
        path = self.path
        if old is not None:
            check_same(_header_of(old), session_header(cell, path.stem), str(path), str(cell.path))
            self.order_seed = _seed_of(old, self.order_seed)
        self.done: set[tuple[int, int]] = set()
        self.measured_at: dict[int, tuple[float, ...]] = {}  # joint positions, rad, and rail, m, of each pose that was begun
        self.time_offset = 0.0
        self.losses: list[str] = []
        target = path.with_name(path.name + ".part") if old is not None else path
        if old is not None:
            target.unlink(missing_ok=True)
        self.bag = BagWriter(target, catalogue)
        versions = {"irec": __version__, "python": platform.python_version(), "numpy": np.__version__, "ros": "jazzy"}
        files = {
            "cell.yaml": cell.text,
            "parameters.json": json.dumps(parameters, indent=1, sort_keys=True, default=str),
            "versions.json": json.dumps(versions, indent=1),
        }
        attach_session(self.bag, session_header(cell, path.stem, self.order_seed), cell.robot.urdf_text, files)
        if old is not None:
            try:
                self._copy(old, cell)
                check_places(self.measured_at, planned, str(path))
            except Exception:  # what was recorded so far stays as it is
                self.bag.close()
                target.unlink(missing_ok=True)
                raise
            self.bag.rename(path)
        self._rows = self.bag.add_topic(record_message.TOPIC, record_message.TYPE)
        self._events = self.bag.add_topic(record_message.EVENT_TOPIC, record_message.EVENT_TYPE)

    def _copy(self, old: BagReader, cell: Cell) -> None:
        last = 0.0
        for message in old.messages():
            channel = self.bag.add_topic(message.topic.name, message.topic.type_name)
            self.bag.write(channel, message.data, message.log_time, message.publish_time)
            if message.topic.name == record_message.EVENT_TOPIC:
                self.done |= self._completed(old.decode(message).data)
            elif message.topic.name == record_message.TOPIC:
                row = old.decode(message)
                last = max(last, float(row.time))
                self.measured_at.setdefault(int(row.pose), tuple(row.joint_position))
        self.losses = list(old.losses)
        before = old.attachments.get("robot.urdf", b"").decode("utf-8", "replace")
        if before != cell.robot.urdf_text:
            raise SessionError(f"{self.path}: was recorded with another robot description; start a new run")
        self.time_offset = last + 1.0 if last else 0.0

    def _completed(self, text: str) -> set[tuple[int, int]]:
        """Pose and repeat that an event says are complete, or nothing. Raises SessionError: it is no event of ours."""
        try:
            event = json.loads(text)
            return {(int(event["pose"]), int(event["repeat"]))} if event["kind"] == "complete" else set()
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            problem = f"{self.path}: an event in it can't be read ({error}); start a new run under another name"
            raise SessionError(" ".join(problem.split())) from error

    def write_row(self, data: bytes, log_time: int) -> None:
        """One serialized LoadCaseRecord."""
        self.bag.write(self._rows, data, log_time)

    def write_event(self, event: dict[str, Any], log_time: int) -> None:
        """What happened beside the rows: kind, pose, repeat, load_case, text."""
        self.bag.write(self._events, record_message.encode_event(json.dumps(event)), log_time)

    def add_topic(self, topic: str, type_name: str) -> int:
        """Register a raw topic."""
        return self.bag.add_topic(topic, type_name)

    def write_raw(self, channel: int, data: bytes, log_time: int) -> None:
        """One serialized message of a raw topic."""
        self.bag.write(channel, data, log_time)

    def close(self) -> None:
        """Finish the file. RecordingError if not everything could be written."""
        self.bag.close()


def _seed_of(old: BagReader, new: int | None) -> int | None:
    """The seed of an earlier part of a run; a new one where it has none."""
    try:
        return int(_header_of(old)["load_case_order"]["seed"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return new


def _header_of(old: BagReader) -> dict[str, Any]:
    """Content of the session.yaml of an earlier part of a run; empty where it can't be read."""
    next(old.messages(), None)  # attachments are read on the way to the first message
    try:
        header = parse_yaml(old.attachments.get("session.yaml", b"").decode())[0]  # refuses aliases that explode
    except (YamlProblem, ValueError):
        return {}
    return header if isinstance(header, dict) else {}
