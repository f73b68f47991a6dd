# SPDX-License-Identifier: Apache-2.0
"""A self-contained HTML page: text, tables and figures in one file that can be mailed."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import IrecError

TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ page.title }}</title>
<style>
:root { color-scheme: light; --ink: #20242a; --quiet: #667; --line: #dde1e7; --ok: #2f855a; --bad: #c05621; --unknown: #6b46c1; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line) }
.verdict { border-left: .4rem solid var(--quiet); padding: .6rem 1rem; background: #f6f7f9; margin: 1rem 0; font-size: 1.05rem }
.verdict.adequate { border-color: var(--ok) } .verdict.missing_effect { border-color: var(--bad) }
.verdict.unexplained { border-color: var(--unknown) }
figure { margin: 1rem 0 } img { max-width: 100% } figcaption, .quiet { color: var(--quiet); font-size: .9rem }
table { border-collapse: collapse; font-size: .92rem; margin: .8rem 0; display: block; overflow-x: auto }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top }
td.number { text-align: right; font-variant-numeric: tabular-nums }
</style></head><body>
<h1>{{ page.title }}</h1><p class="quiet">{{ page.subtitle }}</p>
{% if page.verdict %}<div class="verdict {{ page.status }}">{{ page.verdict }}</div>{% endif %}
{% for s in page.sections %}<h2>{{ s.heading }}</h2>
{% for text in s.paragraphs %}<p>{{ text }}</p>{% endfor %}
{% for f in s.figures %}<figure><img alt="{{ f.caption }}" src="data:image/png;base64,{{ encode(f.path) }}">
<figcaption>{{ f.caption }}</figcaption></figure>{% endfor %}
{% for t in s.tables %}<table><thead><tr>{% for h in t.header %}<th>{{ h }}</th>{% endfor %}</tr></thead><tbody>
{% for row in t.rows %}<tr>
{% for cell in row %}<td{% if cell is number %} class="number"{% endif %}>{{ show(cell) }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table>{% endfor %}
{% endfor %}
<p class="quiet">{{ page.footer }}</p>
</body></html>
"""


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


@dataclass(frozen=True)
class Section:
    """A heading with paragraphs, figures and tables, in this order."""

    heading: str
    paragraphs: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()


@dataclass(frozen=True)
class Page:
    """A report. `status` colours the verdict: adequate, missing_effect, unexplained or empty."""

    title: str
    subtitle: str = ""
    verdict: str = ""
    status: str = ""
    sections: Sequence[Section] = field(default_factory=tuple)
    footer: str = "irec: not a safety-rated function. The calibration method is covered by patent WO2016151360."


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page with its figures inside. Raises IrecError where jinja2 is not installed."""
    try:
        from jinja2 import Environment
    except ImportError as error:
        raise IrecError("reports need jinja2: pip install 'irec_calibration[report]'") from error

    def encode(file: Path) -> str:
        return base64.b64encode(Path(file).read_bytes()).decode()

    def show(cell: Any) -> str:
        return f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell)

    text = Environment(autoescape=True).from_string(TEMPLATE).render(page=page, encode=encode, show=show)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
    return path
