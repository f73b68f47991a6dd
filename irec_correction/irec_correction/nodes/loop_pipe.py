# SPDX-License-Identifier: Apache-2.0
"""The pipe from `rsi_bridge`'s node to its loop: commands and answers, and the end of the loop, which may come first."""

from __future__ import annotations

import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from ..errors import SettingsError
from ..rsi.bridge import BridgeSetup

ANSWER_WAIT = 2.0  # s for the loop to carry out a command


class LoopPipe:
    """What is sent after the loop has ended goes nowhere, and nothing raises for that.

    Attributes:
        ended: None: it has not; otherwise why, empty where it was asked to by a signal.
    """

    def __init__(self, pipe: Connection, take: Callable[[str, Any], None]) -> None:
        """Args: take: called with kind and content of what the loop tells by itself."""
        self._pipe, self._take = pipe, take
        self._answers: list[str] = []
        self.ended: str | None = None

    def begin(self, setup: BridgeSetup) -> tuple[int, list[str]]:
        """Send the setup; the port that is open and what the system refused. Raises SettingsError where the loop can't begin."""
        self._send(setup)
        kind, content = self._receive()
        while kind not in ("ready", "failed", "ended"):  # what a loop that was released still had to say may come first
            kind, content = self._receive()
        if kind == "ready":
            port, refused = content
            return port, refused
        raise SettingsError(str(content) or "the RSI loop was asked to end")

    def ask(self, command: str, argument: Any = None, wait: float = ANSWER_WAIT) -> str:
        """Empty, or why the loop did not do it within so many s."""
        self.listen(0.0)  # an answer that came too late is not that of this command
        self._answers.clear()
        self._send((command, argument))
        end = time.monotonic() + wait
        while not self._answers:
            if self.ended is not None:
                return self.ended or "the RSI loop has ended"
            if time.monotonic() > end:
                return f"the RSI loop did not answer within {wait:g} s"
            self.listen(0.05)
        return self._answers.pop()

    def tell(self, kind: str, content: Any) -> None:
        """What the loop does not answer."""
        self._send((kind, content))

    def listen(self, timeout: float) -> None:
        """Take what has come, up to an answer."""
        while self.ended is None and self._pipe.poll(timeout):
            kind, content = self._receive()
            if kind == "answer":
                self._answers.append(content)
                return
            if kind != "ended":
                self._take(kind, content)

    def _send(self, message: Any) -> None:
        if self.ended is None:
            try:
                self._pipe.send(message)
            except OSError:  # whether it said goodbye is still in the pipe
                pass

    def _receive(self) -> tuple[str, Any]:
        try:
            kind, content = self._pipe.recv()
        except (EOFError, OSError):
            text = "the RSI loop has ended without being asked to: the controller gets no answers; start rsi_bridge again"
            kind, content = "ended", text
        if kind == "ended":
            self.ended = content
        return kind, content
