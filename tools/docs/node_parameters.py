# SPDX-License-Identifier: Apache-2.0
"""Writes config/nodes/correction.yaml, config/nodes/rsi.yaml and docs/node-parameters.md from what the nodes declare.

    . tools/env.sh && python tools/docs/node_parameters.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from irec_calibration.nodes import (
    calibration_node,
    check_driver,
    procedure_node,
    recorder_node,
    ros2_control_driver,
    tf_node,
    tracker_driver,
)
from irec_correction.nodes.parameters import CAN_FT, CORRECTION, LINKS, RSI
from irec_ros.parameters import P
from irec_sim.nodes import cell_parameters, course_side

ROOT = Path(__file__).resolve().parents[2]
HEAD = "# SPDX-License-Identifier: Apache-2.0\n# Written from irec_correction/nodes/parameters.py; range in brackets. "
COLUMN = 44  # of the comments
RSI_TEXT = "All parameters of correction_node too, all of them read-only; `rate` does nothing."
NODES: tuple[tuple[str, str, tuple[P, ...], str], ...] = (  # package, executable, parameters, note
    ("irec_calibration", "procedure_node", procedure_node.PARAMETERS, ""),
    ("irec_calibration", "calibration_node", calibration_node.PARAMETERS, ""),
    ("irec_calibration", "recorder_node", recorder_node.PARAMETERS, ""),
    ("irec_calibration", "check_driver", check_driver.PARAMETERS, ""),
    ("irec_calibration", "ros2_control_driver", ros2_control_driver.PARAMETERS, ""),
    ("irec_calibration", "tracker_driver", tracker_driver.PARAMETERS, ""),
    ("irec_calibration", "tf_node", tf_node.PARAMETERS, ""),
    ("irec_correction", "correction_node", (*CORRECTION, *LINKS), ""),
    ("irec_correction", "rsi_bridge", RSI, RSI_TEXT),
    ("irec_correction", "can_ft_node", CAN_FT, ""),
    ("irec_sim", "cell_node", (*cell_parameters.PARAMETERS, *course_side.PARAMETERS), ""),
)


def files() -> dict[str, str]:
    """Path below the root of the repository -> text."""
    return {
        "config/nodes/correction.yaml": HEAD
        + "All parameters of correction_node with their defaults.\n"
        + _section("correction_node", (*CORRECTION, *LINKS)),
        "config/nodes/rsi.yaml": HEAD
        + "What rsi_bridge has beyond the parameters of correction_node, and can_ft_node.\n"
        + _section("rsi_bridge", RSI)
        + _section("can_ft_node", CAN_FT),
        "docs/node-parameters.md": _page(),
    }


def _section(node: str, table: Iterable[P]) -> str:
    lines = [f"/**/{node}:  # in any namespace", "  ros__parameters:", "    use_sim_time: false"]
    group = ""
    for p in table:
        *parents, name = p.name.split(".")
        if parents and parents[0] != group:
            lines.append(f"    {parents[0]}:")
        group = parents[0] if parents else ""
        entry = f"{'      ' if parents else '    '}{name}: {_value(p.default)}"
        lines.append(f"{entry:<{COLUMN}}# {_text(p)}")
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return str(value)


def _text(p: P) -> str:
    unit = f", {p.unit}" if p.unit else ""
    bounds = f" [{p.low:g} .. {p.high:g}]" if p.low is not None and p.high is not None else ""
    return f"{p.text}{unit}{bounds}{'; can be set at run time' if p.settable else ''}"


def _page() -> str:
    out = [
        "# Parameters of the nodes",
        "",
        "Written from what the nodes declare by `python tools/docs/node_parameters.py`. A value out of its range is refused by",
        "name, and so is a name that the node does not have. What can't be set at run time is read-only: give it at the start,",
        "`-p name:=value` or in a file.",
    ]
    for package, node, table, note in NODES:
        out += ["", f"## {node}", "", f"`ros2 run {package} {node}`", "", *([note, ""] if note else [])]
        out += ["| name | default | unit | range | at run time | what it is |", "| --- | --- | --- | --- | --- | --- |"]
        for p in table:
            bounds = f"{p.low:g} .. {p.high:g}" if p.low is not None and p.high is not None else ""
            cells = (f"`{p.name}`", f"`{_value(p.default)}`", p.unit, bounds, "yes" if p.settable else "", p.text)
            out.append("| " + " | ".join(cells) + " |")
    return "\n".join(out) + "\n"


def main() -> int:
    """Write all files."""
    for name, text in files().items():
        (ROOT / name).write_text(text, encoding="utf-8")
        print(ROOT / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
