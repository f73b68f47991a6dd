# SPDX-License-Identifier: Apache-2.0
"""Damaged, altered and hostile files are refused in one line: no trace, no hang, no gigabyte (`make fuzz`: an hour)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).resolve().parents[1] / "tools" / "fuzz" / "run.py"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("seconds", "fewest"), [(20, 5), pytest.param(60, 100, marks=pytest.mark.long)], ids=["some seconds", "a minute"]
)
def test_no_reader_fails_on_mutated_files(tmp_path, seconds, fewest):
    command = [sys.executable, RUN, "--seconds", str(seconds), "--keep", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert int(done.stdout.splitlines()[-1].split()[0]) > fewest, done.stdout
