# SPDX-License-Identifier: Apache-2.0
"""`irec inspect`: what an MCAP recording holds and lacks."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from ..recording import BagReader
from ..recording.survey import CLOCK_OFF, NEEDED_RATES, Survey, TopicSurvey, survey


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, help="an .mcap file or a rosbag2 folder, whole, truncated or from elsewhere")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: read as a whole; 1: parts are lost and named."""
    found = survey(BagReader(args.bag), _progress if sys.stderr.isatty() else None)
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    print(json.dumps(found.as_dict(), indent=2) if args.json else _text(found))
    return 1 if found.losses else 0


def _progress(done: int, total: int) -> None:
    print(f"\rreading {100 * done // max(total, 1)} %", end="", file=sys.stderr, flush=True)


def _text(found: Survey) -> str:
    lines = [f"{found.path}: {sum(t.count for t in found.topics)} messages in {found.duration:.1f} s", ""]
    lines += _table(found.topics)
    irregular = [t for t in found.topics if t.gap_count or t.bursts or t.backwards or t.repeated or t.missing or _off(t)]
    if irregular:
        lines += ["", "Irregular:"]
        lines += [f"  {t.name}: {_irregularities(t)}" for t in irregular]
    if found.attachments or found.metadata:
        lines += ["", f"Attached: {', '.join(found.attachments) or 'nothing'}; metadata: {', '.join(found.metadata) or 'none'}"]
    lines += ["", "Of a session it has:", *(f"  {item}" for item in found.present or ("nothing",))]
    lines += ["", "It lacks:", *(f"  {item}" for item in found.lacking or ("nothing",))]
    if found.losses:
        lines += ["", "Lost:", *(f"  {item}" for item in found.losses)]
    return "\n".join(lines)


def _table(topics: tuple[TopicSurvey, ...]) -> list[str]:
    head = ("topic", "type", "count", "Hz", "log - stamp, ms: min / median / max / std")
    rows = [head]
    for topic in topics:
        skew = "no stamp"
        if topic.skew is not None:
            s = topic.skew
            values = " / ".join(f"{1e3 * v:.1f}" for v in (s.minimum, s.median, s.maximum, s.std))
            skew = values if s.same_clock else f"stamps of another clock, {s.median:.0f} s away"
        rows.append((topic.name, topic.type_name, str(topic.count), f"{topic.rate:.1f}", skew))
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _off(topic: TopicSurvey) -> float:
    """Of readings; a row is stamped with the middle of its window."""
    return topic.skew.off if topic.skew is not None and topic.type_name in NEEDED_RATES else 0.0


def _irregularities(topic: TopicSurvey) -> str:
    parts = []
    if off := _off(topic):
        least = "at least " if off > 0 else ""
        parts.append(
            f"stamps {least}{1e3 * abs(off):.0f} ms {'behind' if off > 0 else 'ahead of'} the times at which they were received,"
            f" limit {1e3 * CLOCK_OFF:.0f} ms: the clocks differ"
        )
    if topic.bursts:
        parts.append("messages come in bursts, so their times are not the times of reading")
    if topic.gap_count:
        spans = ", ".join(f"{1e3 * gap.length:.0f} ms at {gap.start:.2f} s" for gap in topic.gaps)
        more = "" if topic.gap_count <= len(topic.gaps) else f" and {topic.gap_count - len(topic.gaps)} shorter"
        parts.append(f"gaps beyond three intervals of {1e3 * topic.interval:.1f} ms: {spans}{more}")
    if topic.backwards:
        parts.append(f"{topic.backwards} stamps earlier than the one before")
    if topic.repeated:
        parts.append(f"{topic.repeated} stamps the same as the one before")
    if topic.missing:
        parts.append(f"{topic.missing} messages that the file's own statistics count are not there")
    return "; ".join(parts)
