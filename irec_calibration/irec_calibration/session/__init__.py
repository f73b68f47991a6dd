# SPDX-License-Identifier: Apache-2.0
"""Sessions: read, check, write; as a table (`session.yaml` + `samples.csv`) and as MCAP."""

from __future__ import annotations

from pathlib import Path

from ..errors import SessionError
from .data import ExternalAxis, Marker, Noise, Session, Station
from .table import read_table, write_table

__all__ = ["ExternalAxis", "Marker", "Noise", "Session", "Station", "is_bag", "read_session", "read_table", "write_table"]

BAGS = (".mcap", ".mcap.zstd", ".mcap.lz4", ".db3", ".db3.zstd")  # ends of names; of those that can't be read the reader says why


def is_bag(path: Path) -> bool:
    """Whether a file is a recording by its name, or a folder holds one: MCAP, or one that has to be converted first."""
    names = [p.name for p in path.iterdir()] if path.is_dir() else [path.name]
    return any(name.endswith(BAGS) for name in names)


def read_session(path: str | Path) -> Session:
    """Read a session in either form: folder of the table, its session.yaml, MCAP file, or rosbag2 folder.

    Raises:
        SessionError: nothing there, or not a valid session; names file, line and column.
    """
    path = Path(path)
    if not path.exists():
        raise SessionError(f"{path}: no such file or folder")
    if path.is_dir() and (path / "session.yaml").exists():
        return read_table(path)
    if path.name == "session.yaml":
        return read_table(path.parent)
    if is_bag(path):
        from .mcap_io import read_mcap  # needs the MCAP reader, not wanted for tables

        return read_mcap(path)
    raise SessionError(f"{path}: neither a table (session.yaml + samples.csv) nor an MCAP recording")
