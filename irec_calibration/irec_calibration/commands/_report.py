# SPDX-License-Identifier: Apache-2.0
"""Reports of commands: written where the extra `report` is installed, else said in one line."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path


def report(write: Callable[[], list[Path]]) -> list[Path]:
    """Files of a report, the page first; none where the libraries for figures are missing."""
    missing = [name for name in ("matplotlib", "jinja2") if importlib.util.find_spec(name) is None]
    if missing:
        print(f"note: no report, {' and '.join(missing)} missing: pip install 'irec_calibration[report]'", file=sys.stderr)
        return []
    return write()
