# SPDX-License-Identifier: Apache-2.0
"""The pictures of workbench and report in README and tutorial, drawn anew in headless Chromium: `make pictures`."""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from irec_calibration.cli import main as irec
from PIL import Image

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
TESTS = ROOT / "irec_calibration" / "test"  # the server of the tests' browser
LONG = 200_000  # ms: a machine with other work
RIGHT_PANEL = {"x": 1078, "y": 380, "width": 360, "height": 480}  # its lower end, where the formula is typed
COLOURS = 256
WRONG = "axis 4: c * temp_oil * tau"


def draw(session: Path, cell: Path) -> None:
    """Open a session with a hidden effect, try what is named, keep it, type a formula; then the report of the session."""
    sys.path.insert(0, str(TESTS))
    from playwright.sync_api import sync_playwright
    from workbench_server import CHROMIUM, FLAGS, Server

    if not CHROMIUM:
        raise SystemExit("the pictures of workbench and report need Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as run:
        folder = Path(place)
        server = Server(folder, str(session), "--cell", str(cell))
        browser = run.chromium.launch(executable_path=shutil.which(CHROMIUM), args=FLAGS)
        try:
            page = browser.new_page(viewport={"width": 1440, "height": 860})
            page.set_default_timeout(LONG)
            page.goto(server.url)
            page.get_by_test_id("version-1").wait_for()
            page.wait_for_timeout(2500)
            _keep(page, "workbench-opened")
            page.get_by_test_id("verdict").wait_for()
            page.get_by_test_id("try-joint_stiffening").first.click()
            page.wait_for_function("!document.querySelector('[data-testid=keep]').disabled")
            page.get_by_test_id("keep").click()
            page.get_by_test_id("version-2").wait_for()
            page.wait_for_timeout(2500)
            _keep(page, "workbench-kept")
            box = page.get_by_label("formula of an effect")
            box.click()
            box.press_sequentially(WRONG, delay=20)
            page.get_by_test_id("formula-message").wait_for()
            page.wait_for_timeout(1500)
            _keep(page, "workbench-formula", clip=RIGHT_PANEL)
            with contextlib.chdir(session.parent):  # the page tells the commands with the session's path as it was given
                irec(["report", session.name, "-o", str(folder / "report")])
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.goto((folder / "report" / "report.html").as_uri())
            page.wait_for_timeout(1000)
            _keep(page, "report")
        finally:
            browser.close()
            server.kill()


def _keep(page: Any, name: str, **part: Any) -> None:
    """A screenshot of few colours, which is a third as large."""
    file = IMAGES / f"{name}.png"
    page.screenshot(path=file, **part)
    with Image.open(file) as taken:
        few = taken.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(file, optimize=True)
