# SPDX-License-Identifier: Apache-2.0
"""Serialized messages without the bytes that follow them."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

_CDR_HEADER = 4  # bytes


def exact_cdr(message: Any) -> bytes:
    """The message as CDR, and nothing after it.

    `serialize_message` gives as many bytes as the middleware has estimated, which is too many where a sequence of doubles
    is empty. What is too many is not initialized, and strict readers refuse it. Takes a few deserializations.
    """
    data = bytes(serialize_message(message))
    end = len(data)
    while end > _CDR_HEADER:
        try:
            deserialize_message(data[: end - 1], type(message))
        except Exception:  # the bindings have no public class for it; too short is all that can be wrong
            break
        end -= 1
    return data[:end]
