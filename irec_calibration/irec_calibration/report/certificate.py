# SPDX-License-Identifier: Apache-2.0
"""The certificate of a recertification: one page, HTML and PDF, that is signed and kept."""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import IrecError
from ..files import write_file
from ..recertification.trend import TrendPoint
from ..recertification.verdict import Kind, kind_of
from .style import pyplot

FOOTER = (
    "irec has no safety-rated function. The calibration method is covered by patent WO2016151360. A calibration belongs to this"
    " robot with this tool, in the range of poses and loads that it was measured in."
)
TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ c.title }}</title><style>
@page { size: A4; margin: 14mm }
body { font: 10.5pt/1.35 system-ui, sans-serif; color: #20242a; max-width: 182mm; margin: 8mm auto }
h1 { font-size: 16pt; margin: 0 } h2 { font-size: 11.5pt; margin: 9pt 0 3pt }
.quiet { color: #5a6270; margin: .1rem 0 .6rem } table { border-collapse: collapse; width: 100% } img { width: 100% }
td, th { padding: 2pt 6pt; border-bottom: .5pt solid #cdd3db; text-align: left; vertical-align: top }
th { width: 34%; font-weight: 500 } td { white-space: pre-line }
.verdict { border-left: 5pt solid {{ colour }}; background: #f4f6f8; padding: 6pt 9pt; margin: 6pt 0 }
.sign { display: flex; gap: 10mm; margin-top: 12mm }
.sign div { flex: 1; border-top: .6pt solid #20242a; padding-top: 2pt; font-size: 9pt }
footer { font-size: 8pt; color: #5a6270; margin-top: 6mm }
</style></head><body><h1>{{ c.title }}</h1><p class="quiet">{{ c.subtitle }}</p>
<div class="verdict"><b>{{ c.verdict }}</b><br>{{ c.text }}</div>
<h2>What was done and found</h2><table>
{% for name, value in c.rows %}<tr><th>{{ name }}</th><td>{{ value }}</td></tr>
{% endfor %}</table>
{% if picture %}<h2>Trend</h2>
<img alt="Deflection of the tool under the rated load, and compliance of the axes, over all calibrations and passed checks"
 src="data:image/png;base64,{{ picture }}">{% endif %}
<div class="sign"><div>Operator: {{ c.operator }}<br>Date, signature</div><div>Released by<br>Date, signature</div></div>
<footer>{{ footer }}</footer></body></html>
"""
COLOURS = {"pass": "#0072b2", "recalibrated": "#0072b2", "investigate": "#e69f00", "failed": "#d55e00"}


@dataclass(frozen=True)
class Certificate:
    """What is written on it. rows: (name, value) in the order of the page; a value may have several lines."""

    title: str
    subtitle: str
    verdict: str
    text: str
    operator: str
    rows: Sequence[tuple[str, str]]
    points: Sequence[TrendPoint] = field(default_factory=tuple)


def write_certificate(c: Certificate, folder: str | Path, name: str = "certificate") -> tuple[Path, Path]:
    """Write `<name>.html` and `<name>.pdf`; returns both paths.

    Raises:
        IrecError: matplotlib or jinja2 is not installed, or one of the two can't be written.
    """
    try:
        from jinja2 import Environment
    except ImportError as error:
        raise IrecError("certificates need jinja2: pip install 'irec_calibration[report]'") from error
    folder = Path(folder)
    picture = base64.b64encode(trend_png(c.points)).decode() if len(c.points) > 1 else ""
    html = Environment(autoescape=True).from_string(TEMPLATE)
    text = html.render(c=c, picture=picture, colour=_colour(c.verdict), footer=FOOTER)
    page = folder / f"{name}.html"
    write_file(page, text)
    pdf = folder / f"{name}.pdf"
    write_file(pdf, _pdf(c))
    return page, pdf


def trend_png(points: Sequence[TrendPoint]) -> bytes:
    """The trend of all calibrations as a PNG."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(7.4, 2.5))
    draw_trend(axes, points)
    figure.tight_layout()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    plt.close(figure)
    return buffer.getvalue()


def draw_trend(axes: Any, points: Sequence[TrendPoint]) -> None:
    """Draw deflection (left) and axis compliances (right) of the calibrations into two matplotlib axes.

    A check that was passed has found nothing anew: a hollow mark where its calibration is, and a bar up to where the axis would
    have been found softer. A calibration that somebody has to look at stands beside the lines, as a cross: its model lacks what
    has happened, and puts it on axes that may be sound.
    """
    when = range(len(points))
    checks = {i for i, p in enumerate(points) if p.event == "checked"}
    doubtful = {i for i, p in enumerate(points) if kind_of(p.verdict) is Kind.INVESTIGATE}
    names = [f"{'check' if i in checks else p.calibration}\n{p.at[:10]}" for i, p in enumerate(points)]
    left, right = axes
    sound = [i for i in when if i not in doubtful]
    left.plot(sound, [1e3 * points[i].deflection_m for i in sound], "-", color="#0072b2")
    for i, p in enumerate(points):
        mark = "X" if i in doubtful else "o"
        left.plot([i], [1e3 * p.deflection_m], mark, color="#0072b2", mfc="white" if i in checks else "#0072b2")
    if doubtful:
        left.plot([], [], "X", color="#0072b2", label="to be looked at")
    if checks:
        left.plot([], [], "o", color="#0072b2", mfc="white", label="confirmed by a check")
    for i, p in enumerate(points):
        if p.in_force:
            left.plot([i], [1e3 * p.deflection_m], "o", ms=11, mfc="none", mec="#d55e00", label="in force")
    left.set_ylabel("mean deflection at\nrated load, mm")
    left.set_ylim(0.0, 1.15e3 * max(p.deflection_m for p in points))
    left.legend(frameon=False, fontsize=7, loc="lower right")
    for k, axis in enumerate(sorted({n for p in points for n in p.compliance})):
        at = [(i, p.compliance[axis].value, p.compliance[axis].se) for i, p in enumerate(points) if axis in p.compliance]
        x, y, se = zip(*at, strict=True)
        shift = 0.03 * (k - 2)
        kept = [j for j, i in enumerate(x) if i not in doubtful]
        (line,) = right.plot([x[j] + shift for j in kept], [1e6 * y[j] for j in kept], "-", label=f"axis {axis + 1}")
        for i, value, error in zip(x, y, se, strict=True):
            softer = points[i].softer_below.get(axis, 0.0)
            bars = [[0.0], [1e6 * softer * value]] if i in checks else [[2e6 * error], [2e6 * error]]
            colour = line.get_color()
            style = {"fmt": "X" if i in doubtful else "o", "ms": 4 if i in doubtful else 3, "capsize": 2, "color": colour}
            right.errorbar([i + shift], [1e6 * value], bars, mfc="white" if i in checks else colour, **style)
    of_checks = ";\nof a check: less than" if checks else ""
    right.set_ylabel(f"compliance, urad/(N m)\n(bars: 2 std. errors{of_checks})")
    right.margins(y=0.15)
    right.set_ylim(bottom=0.0)
    if right.get_legend_handles_labels()[0]:
        right.legend(frameon=False, fontsize=7)
    for ax in axes:
        ax.set_xticks(list(when), names, fontsize=7)
        ax.set_xlim(-0.4, len(points) - 0.6)
        ax.tick_params(axis="y", labelsize=7)
        ax.yaxis.label.set_size(8)


def _colour(verdict: str) -> str:
    return COLOURS.get(verdict.partition(":")[0].lower(), "#5a6270")


def _pdf(c: Certificate) -> bytes:
    """The same page as PDF, A4."""
    plt = pyplot()
    figure = plt.figure(figsize=(8.27, 11.69))
    left, y = 0.08, 0.955

    def write(text: str, size: float, dy: float, x: float = left, **style: Any) -> None:
        nonlocal y
        figure.text(x, y, text, fontsize=size, va="top", **style)
        y -= dy

    write(c.title, 16, 0.028, weight="bold")
    write(c.subtitle, 9, 0.030, color="#5a6270")
    lines = textwrap.wrap(c.text, 106)
    height = 0.030 + 0.0165 * len(lines)
    figure.patches.append(plt.Rectangle((left, y - height), 0.84, height, transform=figure.transFigure, fc="#f4f6f8", ec="none"))
    figure.patches.append(
        plt.Rectangle((left, y - height), 0.008, height, transform=figure.transFigure, fc=_colour(c.verdict), ec="none")
    )
    y -= 0.006
    write(c.verdict, 10.5, 0.020, left + 0.02, weight="bold")
    for line in lines:
        write(line, 9, 0.0165, left + 0.02)
    y -= 0.02
    write("What was done and found", 11, 0.024, weight="bold")
    for name, value in c.rows:
        wrapped = [part for line in value.split("\n") for part in textwrap.wrap(line, 77)] or [""]
        figure.text(left, y, name, fontsize=8.5, va="top", color="#5a6270")
        for line in wrapped:
            write(line, 8.5, 0.0155, left + 0.27)
        y -= 0.002
    if len(c.points) > 1:
        y -= 0.008
        write("Trend", 11, 0.024, weight="bold")
        bottom = max(y - 0.165, 0.16)
        draw_trend((figure.add_axes((0.16, bottom, 0.32, 0.15)), figure.add_axes((0.60, bottom, 0.32, 0.15))), c.points)
    for x, who in ((left, f"Operator: {c.operator}"), (0.54, "Released by")):
        figure.add_artist(plt.Line2D((x, x + 0.36), (0.105, 0.105), color="#20242a", lw=0.7))
        figure.text(x, 0.10, f"{who}\nDate, signature", fontsize=8, va="top")
    figure.text(left, 0.045, "\n".join(textwrap.wrap(FOOTER, 125)), fontsize=7, va="top", color="#5a6270")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", bbox_inches=figure.bbox_inches)  # the whole sheet, not what is drawn on it
    plt.close(figure)
    return buffer.getvalue()
