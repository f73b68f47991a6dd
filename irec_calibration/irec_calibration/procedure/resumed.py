# SPDX-License-Identifier: Apache-2.0
"""Whether a run may go on with the recording of an earlier one: what rows mean, and where poses are, has to be the same."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ..errors import SessionError
from ..typing import Array

MAY_DIFFER = ("format", "name", "noise", "load_case_order", "load_case_names", "robot.urdf")  # of which no row depends
SAME_PLACE = 0.1  # rad or m between the planned angles of a pose and those that were read there: contact, sag, deflection


def check_same(old: Mapping[str, Any], new: Mapping[str, Any], recording: str, cell_file: str) -> None:
    """Compare two session.yaml.

    Args:
        old, new: of the recording, and of the cell file now. recording, cell_file: their names, for the message.

    Raises:
        SessionError: something differs that the rows depend on; names it with both values.
    """
    if (old.get("without_tracker") is True) != (new.get("without_tracker") is True):
        was, is_ = ("with", "without") if new.get("without_tracker") is True else ("without", "with")
        raise SessionError(
            f"{recording}: was recorded {was} a tracker, the cell is {is_} one now (procedure.without_tracker); start a new run"
        )
    found = next(_differences("", old, new), None)
    if found is None:
        return
    name, before, now = found
    raise SessionError(
        f"{recording}: was recorded with {name} {_said(before)}, {cell_file} says {_said(now)}; rows of both can't be in one"
        " session: start a new run, or go on with the cell file of then"
    )


def check_places(measured_at: Mapping[int, Iterable[float]], planned: Mapping[int, Array], recording: str) -> None:
    """Compare where poses were measured with where they are planned.

    Args:
        measured_at: pose -> joint positions and rail, rad and m. planned: pose -> likewise, in contact. recording: its name.

    Raises:
        SessionError: a pose number stands for another place.
    """
    for pose, measured in measured_at.items():
        if pose not in planned:
            continue
        was, now = np.array(list(measured)), planned[pose]
        if len(was) != len(now):
            raise SessionError(f"{recording}: pose {pose} has {len(was)} axes, the pose list {len(now)}; start a new run")
        off = np.abs(was - now)
        worst = int(off.argmax())
        if not off[worst] <= SAME_PLACE:
            raise SessionError(
                f"{recording}: pose {pose} was measured with axis {worst + 1} at {was[worst]:.3f}, the pose list has it"
                f" at {now[worst]:.3f} (rad or m, limit {SAME_PLACE:g} apart): the numbers stand for other poses; start a new run"
            )


def _differences(name: str, old: Any, new: Any) -> Iterator[tuple[str, Any, Any]]:
    if name in MAY_DIFFER:
        return
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys((*old, *new)):
            yield from _differences(f"{name}.{key}" if name else str(key), old.get(key), new.get(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from _differences(f"{name}[{k}]", a, b)
    elif old != new:
        yield name, old, new


def _said(value: Any) -> str:
    return "nothing" if value is None else repr(value)
