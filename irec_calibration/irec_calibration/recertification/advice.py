# SPDX-License-Identifier: Apache-2.0
"""What the person at the cell does now: the last part of every text of a recertification, behind a mark of its own.

The texts cross ROS as one string each. Who composes one and who takes one apart agree by what is here.
"""

from __future__ import annotations

NOW = "Do this now:"
RESUME = "call irec/recertify with resume"  # for programs; a page has something to tick for it


def with_advice(found: str, now: str) -> str:
    """One text of what was found and of what to do now, both whole sentences without the mark."""
    return f"{found.strip()} {NOW} {now.strip()}"


def apart(text: str) -> tuple[str, str]:
    """What was found, and what to do now; that is empty where the text does not say it."""
    found, _, now = text.partition(NOW)
    return found.strip(), now.strip()


def asks_to_resume(now: str) -> bool:
    """Whether what to do now ends in going on with the run that was stopped."""
    return RESUME in now
