# SPDX-License-Identifier: Apache-2.0
"""What the figures share: colours, light and dark, layout, what is said of a sample that one points at.

Colours are Okabe and Ito's, which colour-blind readers tell apart; a quantity is never told by colour alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model import EIGHTEEN_DOF, GEOMETRIC
from ...typing import Array
from ..plain import SessionView, Version

BLUE, ORANGE, GREEN, VERMILLION, SKY, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7"
BY_RESIDUAL = "residual"
Figure = dict[str, Any]
CONFIG: Figure = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["toImage", "sendDataToCloud"]}


@dataclass(frozen=True)
class Look:
    """Light or dark."""

    dark: bool = False

    @property
    def ink(self) -> str:
        return "#e8e8e8" if self.dark else "#20242a"

    @property
    def quiet(self) -> str:
        return "#9aa3ad" if self.dark else "#6b7280"

    @property
    def grid(self) -> str:
        return "#3a4048" if self.dark else "#dde1e7"

    @property
    def paper(self) -> str:
        return "#1d2126" if self.dark else "#ffffff"


def colour_values(view: SessionView, version: Version, residual: Array, by: str) -> tuple[Array, str]:
    """Value of each observed sample and the title of its colour bar."""
    if by in view.columns:
        unit = view.units.get(by, "")
        return view.columns[by][version.rows], by + (f" [{unit}]" if unit else "")
    if by == "residual / noise":
        return np.linalg.norm(residual, axis=1) / np.maximum(version.sigma, 1e-9), "residual / noise"
    return 1e6 * np.linalg.norm(residual, axis=1), "residual [um]"


def hover(view: SessionView, version: Version, residual: Array) -> list[str]:
    size = 1e6 * np.linalg.norm(residual, axis=1)
    return [
        f"pose {view.pose[r]}, load case {view.case_names[r]}"
        + (f", repeat {view.repeat[r]}" if view.repeat[r] else "")
        + f"<br>residual {size[i]:.0f} um, noise {1e6 * version.sigma[i]:.0f} um"
        for i, r in enumerate(version.rows)
    ]


def layout_of(look: Look, height: int | None = None) -> Figure:
    out: Figure = {
        "paper_bgcolor": look.paper,
        "plot_bgcolor": look.paper,
        "font": {"color": look.ink, "size": 12, "family": "system-ui, sans-serif"},
        "margin": {"l": 55, "r": 10, "t": 10, "b": 40},
        "autosize": True,
    }
    if height:
        out["height"] = height
    return out


def um(metres: float) -> float | None:
    return round(1e6 * metres, 2) if np.isfinite(metres) else None


def short(name: str) -> str:
    """The name of a version with the usual models abbreviated."""
    return name.replace(" + ".join(EIGHTEEN_DOF), "18 DOF").replace(" + ".join(GEOMETRIC), "geometric")
