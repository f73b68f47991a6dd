# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can mend. The message says what was wrong, where, the value, the limit, and what to do."""

from __future__ import annotations


def one_line(text: str) -> str:
    """Without line ends and control characters: what stands in a file must not break the line that names it."""
    return text if text.isprintable() else "".join(c if c.isprintable() else " " for c in " ".join(text.split()))


class IrecError(Exception):
    """Base of every error that is reported to the user in one line (exit code 2) instead of a stack trace.

    Attributes:
        problems: where several things are wrong at once, one line for each; empty otherwise.
    """

    problems: tuple[str, ...] = ()

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


class RobotError(IrecError):
    """The robot description can't be used."""


class SessionError(IrecError):
    """A recording is not a valid session; names file, line and column."""


class ImplausibleSession(SessionError):
    """A session that can be read and can't be what it says; exit code 2, as every input that can't be used.

    Attributes:
        doubts: each reason as a sentence.
    """

    def __init__(self, message: str, doubts: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.doubts = doubts


class RecordingError(IrecError):
    """A recording (MCAP) can't be written or read."""


class ModelError(IrecError):
    """A model file is wrong or does not fit the robot or session."""


class EffectError(IrecError):
    """An effect is unknown, badly defined, or can't act on this session."""


class CellError(IrecError):
    """A cell file is wrong."""


class SolveError(IrecError):
    """The data can't determine what was asked for."""


class PlanError(IrecError):
    """Poses can't be planned as asked for."""


class Cancelled(IrecError):
    """The user cancelled a long computation."""
