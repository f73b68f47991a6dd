# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions as people write them, made such that a strict parser reads all that they say."""

from __future__ import annotations

import math
from xml.etree import ElementTree

from ..errors import RobotError

LIMITS = ("effort", "velocity")  # required by the format, and often not known; 0 means unknown
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def completed(urdf_text: str, root: ElementTree.Element, source: str) -> str:
    """The description with what the parser demands and may be unknown here: limits of drives that are not stated (N m or N, and
    rad/s or m/s) are 0, and moments of inertia of a mass (kg m^2), which nothing here uses, too. Without them the parser refuses
    the whole, or drops the mass without a word.

    Args:
        root: of the same text. source: where it came from, for messages.

    Raises:
        RobotError: a mass is no number or negative.
    """
    changed = False
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        for name in LIMITS:
            if not math.isfinite(_number(limit.get(name))):
                limit.set(name, "0")
                changed = True
    for link in root.iter("link"):
        inertial = link.find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is None or mass is None:
            continue
        value = _number(mass.get("value"))
        if not math.isfinite(value) or value < 0.0:
            raise RobotError(
                f"{source}: link '{link.get('name')}' has the mass {mass.get('value')!r}; kg, 0 or more, is expected."
                " Where it is not known, leave <inertial> out"
            )
        if inertial.find("inertia") is None:
            ElementTree.SubElement(inertial, "inertia", dict.fromkeys(INERTIA, "0"))
            changed = True
    return ElementTree.tostring(root, encoding="unicode") if changed else urdf_text


def _number(text: str | None) -> float:
    """Not a number where there is none."""
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
