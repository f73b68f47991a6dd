# SPDX-License-Identifier: Apache-2.0
"""The AFP cell with faster ways between the poses, for tests that ask for what happens there and not for how long it takes."""

from __future__ import annotations

from pathlib import Path

CELL = Path(__file__).parents[2] / "config" / "cells" / "afp.yaml"
CHANGES = {
    "home_speed: 0.5": "home_speed: 1.0",
    "linear_speed: 0.15": "linear_speed: 0.5",
    "urdf: ../robots": f"urdf: {CELL.parents[1] / 'robots'}",
    "poses: afp_poses.yaml": f"poses: {CELL.parent / 'afp_poses.yaml'}",
}


def quick_cell(folder: Path) -> Path:
    """Path of the cell file, written into a folder; everything that is measured is as in `CELL`."""
    text = CELL.read_text()
    for old, new in CHANGES.items():
        if old not in text:
            raise ValueError(f"{CELL} has no {old!r} to be changed")
        text = text.replace(old, new)
    path = folder / "quick_cell.yaml"
    path.write_text(text)
    return path
