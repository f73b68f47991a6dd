# SPDX-License-Identifier: Apache-2.0
"""Which files a recording consists of, and which recordings of rosbag2 can't be read as they are."""

from __future__ import annotations

from pathlib import Path

from ..errors import RecordingError
from ..files import one_line, read_text
from ..files.yaml_text import YamlProblem, parse_yaml

CONVERT = "convert it with ros2 bag convert"
OTHER_BAGS = (".db3", ".zstd", ".lz4")  # of rosbag2: SQLite, whole files compressed


def files_of(path: Path) -> tuple[Path, ...]:
    """The MCAP files of an .mcap file or a rosbag2 folder, in order.

    Raises:
        RecordingError: not there, or of a kind that has to be converted first.
    """
    if path.is_file():
        if path.suffix != ".mcap":
            raise RecordingError(f"{path} is no .mcap file; {CONVERT}")
        return (path,)
    if not path.is_dir():
        raise RecordingError(f"{path} does not exist")
    index = path / "metadata.yaml"
    if index.is_file():
        names = _names_in(index)
        missing = [name for name in names if not (path / name).is_file()]
        if missing:
            raise RecordingError(f"{index} names {missing[0]}, which is not there; restore it or remove metadata.yaml")
        if any(not name.endswith(".mcap") for name in names):
            raise RecordingError(f"{path} is a rosbag2 folder without MCAP ({names[0]}); {CONVERT}")
        return tuple(path / name for name in names)
    files = tuple(sorted(path.glob("*.mcap")))
    if not files:
        others = sorted(other.name for other in path.iterdir() if other.suffix in OTHER_BAGS)
        raise RecordingError(f"{path} holds no .mcap file" + (f" ({others[0]}); {CONVERT}" if others else ""))
    return files


def _names_in(index: Path) -> list[str]:
    """The files that a metadata.yaml names: plain names beside it, never a path that leads elsewhere.

    Raises:
        RecordingError: it is no metadata of rosbag2, or says that the messages are compressed one by one.
    """
    try:
        data, _ = parse_yaml(read_text(index, "metadata of a rosbag2 folder", RecordingError))
    except YamlProblem as error:
        raise RecordingError(f"{index}:{error.line}: {error.text}; remove the file to read without") from None
    information = data.get("rosbag2_bagfile_information") if isinstance(data, dict) else None
    information = information if isinstance(information, dict) else {}
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise RecordingError(f"{index} is no metadata of a rosbag2 folder (relative_file_paths); remove it to read without")
    if str(information.get("compression_mode")).upper() == "MESSAGE":
        form = one_line(str(information.get("compression_format")))[:20]
        raise RecordingError(f"{index.parent} is compressed message by message ({form}); {CONVERT}")
    for name in names:
        if Path(name).name != name or not name.isprintable():
            raise RecordingError(one_line(f"{index} names {name!r}; only files beside it are read: correct relative_file_paths"))
    return [str(name) for name in names]
