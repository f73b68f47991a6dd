# SPDX-License-Identifier: Apache-2.0
"""Fixtures: the session with a hidden effect, made once; a browser."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.session.mcap_io import write_mcap
from synthetic import session
from workbench_server import CHROMIUM, FLAGS, hardening, write_hidden


@pytest.fixture(scope="session")
def hidden_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_hidden(tmp_path_factory.mktemp("sessions") / "hidden")


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """Headless Chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")
    with playwright.sync_playwright() as run:
        made = run.chromium.launch(executable_path=shutil.which(CHROMIUM), args=FLAGS)
        yield made
        made.close()


@pytest.fixture(scope="session")
def growing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, bytes]]:
    """Where a recording is being written, and what is on the disk after so many poses: without its end until it is closed."""
    folder, whole = tmp_path_factory.mktemp("growing"), session(11, seed=3, extra=hardening)
    states = {}
    for n in (2, 8, 10, 11):
        content = write_mcap(whole.select_poses(np.arange(1, n + 1)), folder / f"{n}.mcap").read_bytes()
        states[n] = content if n == 11 else content[:-100]
    return folder / "run.mcap", states
