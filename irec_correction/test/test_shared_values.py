# SPDX-License-Identifier: Apache-2.0
"""A block of shared memory has one owner: a second cell on one computer can't take the first one's."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from pathlib import Path

import numpy as np
import pytest
from irec_correction.errors import CorrectionError
from irec_correction.shared import SharedValues


@pytest.mark.parametrize("name", ["../irec_test", "/etc/passwd", "a/b", "..", "a\nb"])
def test_a_name_that_leads_elsewhere_is_refused_before_anything_is_removed(name: str) -> None:
    for made in (lambda: SharedValues.create(3, name), lambda: SharedValues.attach(name, 3)):
        with pytest.raises(CorrectionError, match="a plain name"):
            made()


@pytest.mark.parametrize("link", [False, True])
def test_a_block_that_others_can_write_is_not_read(tmp_path: Path, link: bool) -> None:
    block = SharedValues.create(3)
    path, other = Path("/dev/shm") / block.name, f"irec_test_{uuid.uuid4().hex}"
    try:
        if link:
            (path.parent / other).symlink_to(path)
        else:
            path.chmod(0o622)
        with pytest.raises(CorrectionError, match="the same user"):
            SharedValues.attach(other if link else block.name, 3)
    finally:
        (path.parent / other).unlink(missing_ok=True)
        block.close()


MAKE = """
import sys
from irec_correction.shared import SharedValues
block = SharedValues.create(3, sys.argv[1])
print("made", flush=True)
"""


def test_a_block_in_use_is_not_replaced_and_one_of_a_dead_process_is() -> None:
    name = f"irec_test_{uuid.uuid4().hex}"
    code = MAKE + "sys.stdin.read()\nimport os\nos._exit(0)\n"
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    owner = subprocess.Popen([sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env)
    assert owner.stdout is not None and owner.stdin is not None
    assert owner.stdout.readline() == b"made\n"
    with pytest.raises(CorrectionError, match="belongs to another process that is running"):
        SharedValues.create(3, name)
    owner.stdin.close()
    owner.wait(20.0)
    mine = SharedValues.create(3, name)
    mine.write(np.array([1.0, 2.0, 3.0]))
    read = np.zeros(3)
    assert SharedValues.attach(name, 3).read(read) and read[2] == 3.0
    mine.close()
