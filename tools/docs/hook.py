# SPDX-License-Identifier: Apache-2.0
"""Adds a page for each effect to the site, generated from the code with a plot of its signature (mkdocs calls this)."""

from __future__ import annotations

import atexit
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FOLDER = Path(tempfile.mkdtemp(prefix="irec-docs-"))  # of this build alone: two may run at a time
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)


def on_config(config: Any) -> Any:
    """Generate the pages and name them in the navigation, and with them every page that nobody has given a place there."""
    sys.path[:0] = [str(HERE), *(str(ROOT / p) for p in ("irec_calibration", "irec_sim"))]
    import effect_pages

    pages = effect_pages.write(FOLDER)
    for entry in config["nav"]:
        if isinstance(entry, dict) and "Effects" in entry:
            entry["Effects"] = [f"effects/{name}" for name in pages]
    placed = set(_pages_of(config["nav"]))
    found = sorted(str(p.relative_to(config["docs_dir"])) for p in Path(config["docs_dir"]).rglob("*.md"))
    more = [p for p in found if p not in placed]
    if more:
        config["nav"].append({"More": more})
    return config


def _pages_of(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [p for item in (entry.values() if isinstance(entry, dict) else entry) for p in _pages_of(item)]


def on_files(files: Files, config: Any) -> Files:
    """Hand the generated pages and pictures to mkdocs."""
    for path in sorted(FOLDER.iterdir()):
        files.append(File.generated(config, f"effects/{path.name}", abs_src_path=str(path)))
    return files
