# SPDX-License-Identifier: Apache-2.0
"""Whether recorded forces and TCP poses are in the frames that a session counts in."""

from __future__ import annotations

import struct
from collections.abc import Mapping

# what each message type has to be in, and what that is called
FRAMES = {
    "geometry_msgs/msg/WrenchStamped": ("tool0", "forces of the environment on the robot have"),
    "geometry_msgs/msg/PoseStamped": ("base_link", "the TCP has"),
}
LONGEST_NAME = 200  # characters


def frame_of(data: bytes) -> str:
    """frame_id of a serialized message that begins with a std_msgs/Header (CDR, either byte order); empty where there is none."""
    if len(data) < 17:
        return ""
    (length,) = struct.unpack_from("<I" if data[1] & 1 else ">I", data, 12)
    return data[16 : 16 + min(length, LONGEST_NAME) - 1].decode("utf-8", "replace") if length > 1 else ""


def misplaced(seen: Mapping[str, tuple[str, set[str]]]) -> list[str]:
    """A sentence for each kind of reading that no topic has in its frame; seen: topic -> message type and frames."""
    out = []
    for type_name, (wanted, what) in FRAMES.items():
        frames = {topic: found for topic, (kind, found) in seen.items() if kind == type_name and found}
        if frames and not any(found == {wanted} for found in frames.values()):
            named = ", ".join(f"{t} is in {' and '.join(map(repr, sorted(f)))}" for t, f in sorted(frames.items()))
            out.append(f"frame: {named}; {what} to be in '{wanted}'")
    return out
