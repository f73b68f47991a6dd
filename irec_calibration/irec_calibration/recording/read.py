# SPDX-License-Identifier: Apache-2.0
"""Reading of MCAP recordings, whole or damaged, chunk by chunk.

What is whole is read. What is lost is named in `losses`: where in the file, how many bytes, and which span of time where the
file still tells it. Nothing is guessed from half a chunk.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap_ros2.decoder import DecoderFactory

from ..errors import RecordingError
from ..files import one_line
from .bag_files import CONVERT, files_of
from .unpack import check_definition, unpacked

MAGIC = b"\x89MCAP0\r\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with 0, JSON is text
LARGEST_RECORD = 512 * 1024 * 1024  # bytes
_MOST_LOSSES = 200  # sentences
_MOST_UNKNOWN = 1000  # records of one chunk that MCAP 0 does not define
_PREFIX = 9  # bytes before the content of a record: opcode and length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Topic:
    """One topic of a recording; qos and type_hash as written, empty where the writer left them out."""

    name: str
    type_name: str
    message_encoding: str
    qos: str = ""
    type_hash: str = ""
    schema: records.Schema | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class RawMessage:
    """One message as it was recorded; times in ns, data serialized."""

    topic: Topic
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


class BagReader:
    """Reads an .mcap file or a rosbag2 folder of them.

    Attributes (grow while `messages` runs, complete afterwards):
        files: the MCAP files in order.
        topics: by name, every topic that the files announce.
        attachments: contents by name.
        metadata: named text values by name.
        losses: one sentence for each part that could not be read; empty where the recording is whole.
        expected: messages by topic that a finished recording says it holds; None where it says nothing.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.files = files_of(self.path)
        self.topics: dict[str, Topic] = {}
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.losses: list[str] = []
        self.expected: dict[str, int] | None = None
        self._decoders = DecoderFactory()
        self._checked: set[str] = set()

    def messages(self, topics: Collection[str] | None = None, progress: Progress | None = None) -> Iterator[RawMessage]:
        """Messages in the order of the file, all topics or those named; progress(bytes read, bytes in all) per chunk.

        Raises:
            RecordingError: not MCAP, or messages that are compressed one by one.
        """
        self.losses.clear()
        self.expected = None
        total = sum(file.stat().st_size for file in self.files)
        before = 0
        for file in self.files:
            report = None if progress is None else _shifted(progress, before, total)
            for message in _File(self, file, topics).read(report):
                if message.data.startswith(ZSTD_MAGIC):
                    raise RecordingError(f"{file} is compressed message by message ({message.topic.name}: zstd); {CONVERT}")
                yield message
            before += file.stat().st_size

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with the fields of its type. RecordingError where the definition does not fit."""
        topic = message.topic
        try:
            if topic.name not in self._checked and topic.schema is not None:
                check_definition(topic.schema.data)
                self._checked.add(topic.name)
            decoder = self._decoders.decoder_for(topic.message_encoding, topic.schema)
            if decoder is None:
                encoding = topic.schema.encoding if topic.schema else "none"
                raise RecordingError(
                    f"{self.path}: {topic.name} is encoded as {topic.message_encoding} with a schema in {encoding}; "
                    "only cdr with ros2msg can be read: record it again with rosbag2"
                )
            return decoder(message.data)
        except RecordingError:
            raise
        except Exception as error:  # the decoder is generated from the file's own text and may fail in any way
            raise RecordingError(
                one_line(
                    f"{self.path}: message {message.sequence} of {topic.name} at {message.log_time / 1e9:.9f} s "
                    f"is no {topic.type_name} ({error})"
                )[:1000]
            ) from error


def _shifted(progress: Progress, before: int, total: int) -> Progress:
    return lambda done, _: progress(before + done, total)


class _File:
    """One pass over one file."""

    def __init__(self, bag: BagReader, path: Path, wanted: Collection[str] | None) -> None:
        self.bag, self.path, self.wanted = bag, path, wanted
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, Topic] = {}
        self.finished = False
        self._span = ""  # of time, of the chunk being read

    def read(self, progress: Progress | None) -> Iterator[RawMessage]:
        size = self.path.stat().st_size
        with open(self.path, "rb") as stream:
            try:
                signature = stream.read(len(MAGIC))
            except OSError as error:
                raise RecordingError(f"{self.path} can't be read: {error.strerror}") from error
            if signature != MAGIC:
                raise RecordingError(f"{self.path} is not MCAP: it does not begin with the MCAP signature")
            while not self.finished:
                at = stream.tell()
                head = stream.read(_PREFIX)
                length = int.from_bytes(head[1:], "little")
                if len(head) < _PREFIX or at + _PREFIX + length > size:
                    self._truncated(stream, at, size, head)
                    return
                self._span = ""
                try:
                    if length > LARGEST_RECORD:
                        raise ValueError(f"more than {LARGEST_RECORD} bytes")
                    yield from self._record(head[0], stream, length)
                except Exception as error:  # whatever parser and decompressor make of damaged bytes
                    kind = "chunk" if head[0] == Opcode.CHUNK else "record"
                    self._lost(f"the {kind} at byte {at} ({length} bytes{self._span}) is damaged: {error}")
                stream.seek(at + _PREFIX + length)
                if progress is not None and head[0] in (Opcode.CHUNK, Opcode.FOOTER):
                    progress(stream.tell(), size)

    def _record(self, opcode: int, stream: IO[bytes], length: int) -> Iterator[RawMessage]:
        if opcode == Opcode.CHUNK:
            yield from self._chunk(stream.read(length))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            yield from self._small(opcode, stream.read(length))
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(ReadDataStream(BytesIO(stream.read(length))))
            self.bag.attachments[attachment.name] = attachment.data
        elif opcode == Opcode.METADATA:
            entry = records.Metadata.read(ReadDataStream(BytesIO(stream.read(length))))
            self.bag.metadata[entry.name] = entry.metadata
        elif opcode == Opcode.STATISTICS:
            self._statistics(records.Statistics.read(ReadDataStream(BytesIO(stream.read(length)))))
        elif opcode == Opcode.FOOTER:
            self.finished = True

    def _chunk(self, content: bytes) -> Iterator[RawMessage]:
        """Messages of one chunk; of a chunk that is damaged nothing."""
        chunk = records.Chunk.read(ReadDataStream(BytesIO(content)))
        self._span = _span(chunk.message_start_time, chunk.message_end_time)
        plain = unpacked(chunk)
        if chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc:
            raise ValueError("its checksum does not match")
        place, size, unknown = 0, len(plain), 0
        while place + _PREFIX <= size:
            opcode, length = plain[place], int.from_bytes(plain[place + 1 : place + _PREFIX], "little")
            place += _PREFIX
            if place + length > size:
                raise ValueError(f"a record of {length} bytes begins {size - place} bytes before its end")
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                unknown += 1
                if opcode == 0 or unknown > _MOST_UNKNOWN:
                    raise ValueError(f"it holds records of kind {opcode}, which no chunk has")
            yield from self._small(opcode, plain[place : place + length])
            place += length

    def _small(self, opcode: int, content: bytes) -> Iterator[RawMessage]:
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
            topic = self.channels.get(channel_id)
            if topic is None:
                self._lost(f"message {sequence} belongs to channel {channel_id}, which is not described")
            elif self.wanted is None or topic.name in self.wanted:
                yield RawMessage(topic, log_time, publish_time, sequence, content[_MESSAGE_HEAD.size :])
        elif opcode == Opcode.CHANNEL:
            channel = records.Channel.read(ReadDataStream(BytesIO(content)))
            if channel.id not in self.channels:
                schema = self.schemas.get(channel.schema_id)
                extra = channel.metadata
                topic = Topic(
                    channel.topic,
                    schema.name if schema else "",
                    channel.message_encoding,
                    extra.get("offered_qos_profiles", ""),
                    extra.get("topic_type_hash", ""),
                    schema,
                )
                self.channels[channel.id] = topic
                self.bag.topics.setdefault(channel.topic, topic)
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(ReadDataStream(BytesIO(content)))
            self.schemas[schema.id] = schema

    def _statistics(self, statistics: records.Statistics) -> None:
        expected = self.bag.expected = self.bag.expected or {}
        for channel, count in statistics.channel_message_counts.items():
            if channel in self.channels:
                name = self.channels[channel].name
                expected[name] = expected.get(name, 0) + count

    def _truncated(self, stream: IO[bytes], at: int, size: int, head: bytes) -> None:
        missing = "the index and the end mark are missing"
        if size == at:
            self._lost(f"it ends at byte {size} without an end mark: the writer was stopped, the open chunk is lost; {missing}")
            return
        detail = ""
        if len(head) == _PREFIX and head[0] == Opcode.CHUNK:
            times = stream.read(16)
            if len(times) == 16:
                detail = _span(int.from_bytes(times[:8], "little"), int.from_bytes(times[8:], "little"))
        self._lost(f"it is cut at byte {size}: the last {size - at} bytes{detail} are part of a record and lost; {missing}")

    def _lost(self, sentence: str) -> None:
        losses = self.bag.losses
        if len(losses) < _MOST_LOSSES:
            losses.append(one_line(f"{self.path.name}: {sentence}")[:1000])
        elif len(losses) == _MOST_LOSSES:
            losses.append(f"{self.path.name}: and more, which are not listed")


def _span(first: int, last: int) -> str:
    return f", messages from {first / 1e9:.3f} s to {last / 1e9:.3f} s"
