# SPDX-License-Identifier: Apache-2.0
"""The one table of the demo, beside the paper's."""

from __future__ import annotations

# Table 1 of the paper, robotized AFP: absolute value of lateral deviation, mm; reduction in %
PAPER_WITHOUT = {"mean": 0.570, "max": 0.956, "std": 0.100}
PAPER_WITH = {"mean": 0.061, "max": 0.285, "std": 0.046}
PAPER_REDUCTION = {"mean": 89.30, "max": 70.19, "std": 54.00}


def table(without: dict[str, float], corrected: dict[str, float], reduction: dict[str, float]) -> str:
    """Rows mean, max, standard deviation; columns of this run and of the paper."""
    lines = [
        "",
        "  lateral deviation of the TCP          this run (simulated)             paper, Table 1 (real)",
        "  along a loaded course [mm]        without     with    reduction     without     with   reduction",
        "  " + "-" * 92,
    ]
    for key, name in (("mean", "mean"), ("max", "maximum"), ("std", "standard deviation")):
        lines.append(
            f"  {name:31} {without[key]:8.3f} {corrected[key]:8.3f}   {reduction[key]:7.2f} %"
            f"    {PAPER_WITHOUT[key]:8.3f} {PAPER_WITH[key]:8.3f}  {PAPER_REDUCTION[key]:7.2f} %"
        )
    lines += [
        "",
        "  This plant is an easy one: no mass, little friction, no delay to speak of, steady forces, the truth as measurement.",
        "  make case-afp and make case-machining set the same correction against plants as hard as the paper's real cells.",
    ]
    return "\n".join([*lines, ""])
