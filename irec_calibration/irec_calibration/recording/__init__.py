# SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2-compatible MCAP written from serialized messages, and read back whatever their condition."""

from __future__ import annotations

from .definitions import TypeCatalogue, share_of_prefixes
from .read import BagReader, RawMessage, Topic
from .writer import BagWriter, Qos

__all__ = ["BagReader", "BagWriter", "Qos", "RawMessage", "Topic", "TypeCatalogue", "share_of_prefixes"]
