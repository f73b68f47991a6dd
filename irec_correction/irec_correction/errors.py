# SPDX-License-Identifier: Apache-2.0
"""Errors of the correction. The message says what was wrong, where, the value, the limit, and what to do."""

from __future__ import annotations

from irec_calibration.errors import IrecError


class CorrectionError(IrecError):
    """Base of what the correction refuses."""


class SettingsError(CorrectionError):
    """A setting is out of its range or contradicts another one."""


class ActivationError(CorrectionError):
    """A model can't be put in force: other robot, other tool, an effect that can't act in real time."""


class ProtocolError(CorrectionError):
    """A packet or frame of a device can't be read."""
