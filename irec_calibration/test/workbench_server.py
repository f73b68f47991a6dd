# SPDX-License-Identifier: Apache-2.0
"""A session with a hidden effect, and a running workbench, for the tests of the page."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
from irec_calibration.effects.scene import Scene
from irec_calibration.session import write_table
from synthetic import session

POSES = 14
HARDENING = -4e-14  # rad/(N m)^3 about axis 1: the gear gives way less and less
CHROMIUM = next((p for p in ("chromium", "chromium-browser", "google-chrome") if shutil.which(p)), "")
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip


def hardening(scene: Scene) -> np.ndarray:
    """A gear of axis 1 that stiffens with the third power of its torque; not by the catalogue's law."""
    return scene.J[:, :, 0] * (HARDENING * scene.tau[:, 0] ** 3)[:, None]


def write_hidden(folder: Path) -> Path:
    """The session with the hidden effect as a table."""
    return Path(write_table(session(POSES, seed=3, extra=hardening), folder))


class Server:
    """`irec workbench` in a process of its own on a free port of this machine."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.arguments = arguments
        self.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start it and wait until it answers."""
        command = [sys.executable, "-m", "irec_calibration.cli", "workbench", *self.arguments, "--no-browser"]
        command += ["--port", str(self.port), "-o", str(self.folder / "out")]
        package = Path(__file__).parents[1]
        environment = os.environ | {
            "XDG_STATE_HOME": str(self.folder / "state"), "PYTHONPATH": f"{package}:{os.environ.get('PYTHONPATH', '')}",
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NICEGUI_SCREEN_TEST_PORT": "",
        }  # fmt: skip
        for name in [n for n in environment if n.startswith(("NICEGUI", "PYTEST"))]:
            del environment[name]
        with open(self.folder / "server.log", "ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, start_new_session=True)
        deadline = time.monotonic() + 240.0
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                break
            try:
                self.get("/open")
                return
            except (urllib.error.URLError, ConnectionError, TimeoutError):
                time.sleep(0.2)
        raise AssertionError((self.folder / "server.log").read_text())

    def get(self, path: str, **headers: str) -> tuple[int, str]:
        """Status and body of a request."""
        request = urllib.request.Request(self.url + path, headers={k.replace("_", "-"): v for k, v in headers.items()})
        try:
            with urllib.request.urlopen(request, timeout=20.0) as answer:
                return int(answer.status), answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def kill(self) -> None:
        """End it without a word, as a crash does."""
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait(10.0)
