# SPDX-License-Identifier: Apache-2.0
"""Writing of rosbag2-compatible MCAP in a thread of its own.

Compressing a chunk takes milliseconds, which no control or message loop may wait for: `write` only queues. What has
reached the disk is always a run of whole chunks, so a killed process loses the open chunk and nothing else.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from mcap.writer import CompressionType, Writer

from ..errors import RecordingError
from .definitions import TypeCatalogue
from .held_file import HeldFile

CHUNK_BYTES = 64 * 1024
DRAIN_PERIOD = 0.05  # s; draining in batches costs far fewer thread switches than waking for each message
QUEUE_LIMIT = 500_000  # messages; a disk this far behind does not catch up
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Qos:
    """The part of the offered quality of service that a recording keeps, as rosbag2 names it."""

    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = 50

    def as_rosbag2(self) -> dict[str, Any]:
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass
class _Count:
    type_name: str
    type_hash: str
    qos: Qos
    messages: int = 0


class BagWriter:
    """One MCAP file (profile ros2, schemas ros2msg, messages cdr, zstd chunks of 64 KiB).

    The methods may be called from any thread. They raise RecordingError once writing has failed (disk full, ...), or the
    file was removed, replaced or changed by somebody else; `close` always raises the first such error. As a context manager it
    closes itself. The file is locked (flock) until then, so that no other process goes on with it.

    Attributes:
        rescued: where the recording was written to when its file had gone; None where it had not.
    """

    def __init__(self, path: Path, catalogue: TypeCatalogue | None = None) -> None:
        self.path = Path(path)
        self._catalogue = catalogue or TypeCatalogue()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self.path, "x+b")
        except FileExistsError:
            raise RecordingError(f"{self.path} exists; recordings are never overwritten: choose another name") from None
        except OSError as error:
            raise RecordingError(f"{self.path} can't be written: {error.strerror}") from error
        self._held = HeldFile(self._file)
        self._held.lock(self.path)
        self.rescued: Path | None = None  # where the recording was written to when its file had gone
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="irec")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[int, _Count] = {}
        self._first = self._last = 0
        self._lock = threading.Lock()  # between registering topics and writing; messages pass through the queue alone
        self._queue: queue.SimpleQueue[tuple[int, int, int, bytes] | Callable[[], None]] = queue.SimpleQueue()
        self._error: Exception | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bag-writer", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, qos: Qos | None = None) -> int:
        """Register a topic; returns the id that `write` takes. The same topic again returns the same id."""
        self._check()
        qos = qos or Qos()
        if topic in self._channels:
            channel = self._channels[topic]
            if self._counts[channel].type_name != type_name:
                raise RecordingError(f"{topic} is {self._counts[channel].type_name} in {self.path} and can't be {type_name} too")
            return channel
        definition = self._catalogue.definition(type_name).encode()
        type_hash = self._catalogue.type_hash(type_name)
        metadata = {"offered_qos_profiles": yaml.safe_dump([qos.as_rosbag2()], sort_keys=False)}
        if type_hash:
            metadata["topic_type_hash"] = type_hash
        with self._lock:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", definition)
            channel = self._writer.register_channel(topic, "cdr", self._schemas[type_name], metadata)
            self._channels[topic] = channel
            self._counts[channel] = _Count(type_name, type_hash, qos)
            self._flush()  # a chunk may have become full by this
        return channel

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int | None = None) -> None:
        """Queue one serialized (CDR) message. Times in ns."""
        self._check()
        self._queue.put((channel, log_time, log_time if publish_time is None else publish_time, data))

    def attach(self, name: str, data: bytes, media_type: str = "text/plain") -> None:
        """Store a file (robot description, cell file, parameters, ...) inside the recording."""
        self._check()
        now = time.time_ns()
        self._queue.put(partial(self._writer.add_attachment, now, now, name, media_type, data))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store named text values (versions, serial number, ...) inside the recording."""
        self._check()
        self._queue.put(partial(self._writer.add_metadata, name, dict(values)))

    @property
    def message_count(self) -> int:
        """Messages handed to the file so far."""
        return sum(count.messages for count in self._counts.values())

    def rename(self, path: Path) -> None:
        """Go on under another name, in place of what is there. OSError."""
        with self._lock:
            os.replace(self.path, path)
            self.path = Path(path)

    def close(self) -> None:
        """Write what is queued and the index, close the file. A second call does nothing."""
        if not self._closing.is_set():
            self._closing.set()
            self._thread.join()
        if self._error is not None:
            where = f"; what was recorded is in {self.rescued}" if self.rescued else ""
            raise RecordingError(f"{self.path} is incomplete: {self._error}{where}") from self._error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def write_bag_metadata(self) -> Path:
        """metadata.yaml (version 9) beside the closed file: the folder is then a bag that `ros2 bag` opens."""
        target = self.path.with_name("metadata.yaml")
        target.write_text(self._metadata_text(root=True), encoding="utf-8")
        return target

    def _metadata_text(self, root: bool) -> str:
        """What rosbag2 says about a recording (version 9); in metadata.yaml it stands below a root key."""
        duration = {"nanoseconds": self._last - self._first}
        start = {"nanoseconds_since_epoch": self._first}
        total = self.message_count
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": self._counts[channel].type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [self._counts[channel].qos.as_rosbag2()],
                    "type_description_hash": self._counts[channel].type_hash,
                },
                "message_count": self._counts[channel].messages,
            }
            for topic, channel in sorted(self._channels.items())
        ]
        file = {"path": self.path.name, "starting_time": start, "duration": duration, "message_count": total}
        information = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": total,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [file],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
        return yaml.dump({"rosbag2_bagfile_information": information} if root else information, Dumper=_Dumper, sort_keys=False)

    def _check(self) -> None:
        if self._error is not None:
            raise RecordingError(f"{self.path} can't be written any more: {self._error}") from self._error
        if self._closing.is_set():
            raise RecordingError(f"{self.path} is closed")

    def _run(self) -> None:
        try:
            while not self._closing.wait(DRAIN_PERIOD):
                with self._lock:
                    self._look()
                    self._drain()
            with self._lock:
                self._look()
                self._drain()
                # rosbag2 keeps the content of metadata.yaml in the file too, for readers that get only the file
                self._writer.add_metadata("rosbag2", {"serialized_metadata": self._metadata_text(root=False)})
                self._writer.finish()
                self._file.flush()
                if self._held.has_gone(self.path):
                    self.rescued = self._held.rescue(self.path)
        except Exception as error:
            self._error = self._error or error
        finally:
            try:
                self._file.close()
            except OSError as error:
                self._error = self._error or error

    def _look(self) -> None:
        """A file that was removed is written to its end, to be kept under another name; one that was changed is no recording."""
        if self._held.is_changed():
            raise RecordingError(f"somebody else has written to it or cut it: {self._held.change}")
        if self._error is None and self._held.has_gone(self.path):
            self._error = RecordingError("the file was removed or replaced while it was recorded")

    def _drain(self) -> None:
        if self._queue.qsize() > QUEUE_LIMIT:
            raise RecordingError(f"the disk is {self._queue.qsize()} messages behind (limit {QUEUE_LIMIT})")
        while True:
            try:
                item = self._queue.get_nowait()
            except queue.Empty:
                break
            if callable(item):
                item()
                continue
            channel, log_time, publish_time, data = item
            count = self._counts[channel]
            count.messages += 1
            if not self._first or log_time < self._first:
                self._first = log_time
            self._last = max(self._last, log_time)
            self._writer.add_message(channel, log_time, data, publish_time, sequence=count.messages)
        self._flush()

    def _flush(self) -> None:
        self._file.flush()
        self._held.written()


class _Dumper(yaml.SafeDumper):
    """Writes every value in full: anchors would only puzzle the reader."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
