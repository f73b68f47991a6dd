# SPDX-License-Identifier: Apache-2.0
"""Message definitions as rosbag2 stores them: the text of a type followed by the texts of all types in it.

The texts are the .msg files that every ROS interface package installs in share/<package>/msg; no ROS import is needed.
"""

from __future__ import annotations

import json
import os
import re
from collections import deque
from collections.abc import Callable
from pathlib import Path

from ..errors import RecordingError

PRIMITIVES = frozenset(
    (
        *("bool", "byte", "char", "string", "wstring", "float32", "float64"),
        *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    )
)
_SEPARATOR = "=" * 80
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9]*")
_EVENT = re.compile(r"([a-z][a-z0-9_]*)/srv/([A-Za-z][A-Za-z0-9]*)_Event")  # what a service with introspection publishes


def share_of_prefixes(package: str) -> Path:
    """Share folder of an interface package, found in AMENT_PREFIX_PATH. RecordingError where there is none."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in prefixes:
        share = Path(prefix, "share", package)
        if share.is_dir():
            return share
    raise RecordingError(
        f"package {package} is in none of the {len(prefixes)} prefixes of AMENT_PREFIX_PATH; "
        "source the setup file of the workspace that has it"
    )


class TypeCatalogue:
    """Definitions and hashes of message types, cached."""

    def __init__(self, share: Callable[[str], Path] = share_of_prefixes) -> None:
        self._share = share
        self._definitions: dict[str, str] = {}

    def definition(self, type_name: str) -> str:
        """Concatenated definition (schema encoding ros2msg) of `package/msg/Type`."""
        if type_name not in self._definitions:
            event = _EVENT.fullmatch(type_name)
            self._definitions[type_name] = self._collect_event(event[1], event[2]) if event else self._collect(type_name)
        return self._definitions[type_name]

    def type_hash(self, type_name: str) -> str:
        """RIHS01 hash of the type as in `ros2 topic info --verbose`; empty where the package installs none."""
        event = _EVENT.fullmatch(type_name)
        path = self._share(event[1]) / "srv" / f"{event[2]}.json" if event else self._file(type_name, ".json")
        if not path.is_file():
            return ""
        for entry in json.loads(path.read_text(encoding="utf-8")).get("type_hashes", []):
            if entry.get("type_name") == type_name:
                return str(entry["hash_string"])
        return ""

    def _collect_event(self, package: str, service: str) -> str:
        """Definition of the event of a service: who called, and request or reply, as rosbag2 stores it."""
        path = self._share(package) / "srv" / f"{service}.srv"
        if not path.is_file():
            raise RecordingError(f"{path} is missing; install the interface package of {package}/srv/{service}")
        request, _, reply = path.read_text(encoding="utf-8").partition("---")
        parts = {
            f"{package}/srv/{service}_Event": "service_msgs/msg/ServiceEventInfo info\n"
            f"{package}/srv/{service}_Request[<=1] request\n{package}/srv/{service}_Response[<=1] response\n",
            f"{package}/srv/{service}_Request": request.strip() + "\n",
            f"{package}/srv/{service}_Response": reply.strip() + "\n",
        }
        names = list(parts)
        used = dict.fromkeys(["service_msgs/msg/ServiceEventInfo"])
        for text in (parts[names[1]], parts[names[2]]):
            used |= dict.fromkeys(_types_in(text, package))
        out = parts[names[0]] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{parts[name]}" for name in names[1:])
        seen: set[str] = set()
        for name in used:
            text = f"MSG: {name.replace('/msg/', '/')}\n{self.definition(name)}"
            for block in re.split(rf"^{_SEPARATOR}\n", text, flags=re.MULTILINE):
                head = block.split("\n", 1)[0]
                if head not in seen:
                    seen.add(head)
                    out += f"{_SEPARATOR}\n{block}"
        return out

    def _file(self, type_name: str, suffix: str) -> Path:
        if not _TYPE.fullmatch(type_name):
            raise RecordingError(f"'{type_name}' is not a message type; write package/msg/Type")
        package, _, name = type_name.split("/")
        return self._share(package) / "msg" / f"{name}{suffix}"

    def _collect(self, type_name: str) -> str:
        parts: list[str] = []
        seen, queue = {type_name}, deque([type_name])
        while queue:
            current = queue.popleft()
            path = self._file(current, ".msg")
            if not path.is_file():
                raise RecordingError(f"{path} is missing; install the interface package of {current}")
            text = path.read_text(encoding="utf-8").rstrip("\n") + "\n"
            heading = "" if current == type_name else f"{_SEPARATOR}\nMSG: {current.replace('/msg/', '/')}\n"
            parts.append(heading + text)
            for used in _types_in(text, current.split("/")[0]):
                if used not in seen:
                    seen.add(used)
                    queue.append(used)
        return "".join(parts)


def _types_in(text: str, package: str) -> list[str]:
    """Types of the fields of one .msg text that are not primitive, as package/msg/Type."""
    found: list[str] = []
    for line in text.splitlines():
        code = line.split("#", 1)[0].strip()
        if not code:
            continue
        field = re.sub(r"(<=\d+|\[[^\]]*\])+$", "", code.split()[0])
        if field in PRIMITIVES:
            continue
        owner, _, name = field.rpartition("/")
        found.append(f"{owner.removesuffix('/msg') or package}/msg/{name}")
    return found
