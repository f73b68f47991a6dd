# SPDX-License-Identifier: Apache-2.0
"""A self-contained HTML page: text, tables and figures in one file that can be mailed."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import IrecError
from ..files import write_file

TEMPLATE = (Path(__file__).parent / "page.html.j2").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Figure:
    """A PNG file with its caption."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Table:
    """A header and rows of text or numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]

    @property
    def wide(self) -> bool:
        """Whether a cell holds a sentence."""
        return any(isinstance(cell, str) and len(cell) > 40 for row in self.rows for cell in row)


@dataclass(frozen=True)
class Section:
    """A heading with paragraphs, figures and tables, in this order; `html` is trusted markup, shown on screens only."""

    heading: str
    paragraphs: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    html: str = ""


@dataclass(frozen=True)
class Page:
    """A report. Its first screen is the verdict, one figure that shows it, and what to do next.

    Attributes:
        status: colours the verdict: adequate, missing_effect, unexplained or empty.
        hero: the one figure; todo: what to do next, (sentence, command) each, the command may be empty.
    """

    title: str
    subtitle: str = ""
    verdict: str = ""
    status: str = ""
    sections: Sequence[Section] = field(default_factory=tuple)
    hero: Figure | None = None
    todo: Sequence[tuple[str, str]] = ()
    footer: str = "irec: not a safety-rated function. The calibration method is covered by patent WO2016151360."


def shown(cell: Any) -> str:
    """A cell of a table: numbers with three figures, no exponent where a person can do without."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return ""
    if isinstance(cell, float):
        return f"{cell:.0f}" if abs(cell) >= 100.0 else f"{cell:.3g}"
    return str(cell)


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page with its figures inside. Raises IrecError: jinja2 is not installed, or it can't be written."""
    try:
        from jinja2 import Environment
    except ImportError as error:
        raise IrecError("reports need jinja2: pip install 'irec_calibration[report]'") from error

    def encode(file: Path) -> str:
        return base64.b64encode(Path(file).read_bytes()).decode()

    def show(cell: Any) -> str:
        return shown(cell)

    text = Environment(autoescape=True).from_string(TEMPLATE).render(page=page, encode=encode, show=show)
    return write_file(path, text)
