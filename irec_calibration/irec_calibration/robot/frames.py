# SPDX-License-Identifier: Apache-2.0
"""A vendor's robot description with the two frames that irec needs: base_link and tool0."""

from __future__ import annotations

from xml.etree import ElementTree

from ..errors import RobotError


def with_frames(
    text: str,
    source: str,
    base_frame: str = "base_link",
    tool_frame: str = "tool0",
    tool_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tool_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
    effort: tuple[float, ...] | None = None,
) -> str:
    """The description with the link `base_frame` called base_link and a frame tool0 fixed to `tool_frame`.

    Args:
        text, source: URDF (the output of xacro, not its input) and where it came from.
        base_frame: link that positions are to refer to, on the way to the tool.
        tool_frame: link that carries the TCP.
        tool_xyz, tool_rpy: TCP in that link, m and rad; its z points out of the tool.
        effort: rated torques of the joints from base to tool, N m, where the description states none or others.

    Raises:
        RobotError: not a URDF, or a frame is not there; names those that are.
    """
    if "<xacro:" in text:
        raise RobotError(f"{source}: is the input of xacro; give its output: xacro {source} > robot.urdf")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotError(f"{source}: not a robot description (URDF): {error}") from error
    names = [link.get("name", "") for link in root.findall("link")]
    for frame, option in ((base_frame, "--base-frame"), (tool_frame, "--tool-frame")):
        if frame not in names:
            raise RobotError(f"{source}: there is no link {frame!r}; name another by {option}: {', '.join(names)}")
    path = _path(root, tool_frame, base_frame, source)
    moved = any(tool_xyz) or any(tool_rpy)
    if base_frame == "base_link" and tool_frame == "tool0" and not moved and effort is None:
        return text
    if tool_frame != "tool0" or moved:
        if "tool0" in names:
            _rename(root, "tool0", "vendor_tool0")
            tool_frame = "vendor_tool0" if tool_frame == "tool0" else tool_frame
        ElementTree.SubElement(root, "link", name="tool0")
        joint = ElementTree.SubElement(root, "joint", name="irec_tool0", type="fixed")
        ElementTree.SubElement(joint, "parent", link=tool_frame)
        ElementTree.SubElement(joint, "child", link="tool0")
        ElementTree.SubElement(joint, "origin", xyz=" ".join(map(str, tool_xyz)), rpy=" ".join(map(str, tool_rpy)))
    if base_frame != "base_link":
        if "base_link" in names:
            _rename(root, "base_link", "vendor_base_link")
        _rename(root, base_frame, "base_link")
    if effort is not None:
        moving = [joint for joint in path if joint.get("type") != "fixed"]
        if len(effort) != len(moving):
            raise RobotError(f"{source}: {len(effort)} rated torques were given, there are {len(moving)} joints")
        for joint, value in zip(moving, effort, strict=True):
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
            limit.set("effort", f"{value:g}")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _path(root: ElementTree.Element, tool: str, base: str, source: str) -> list[ElementTree.Element]:
    """Joints from base to tool."""
    above = {}
    for joint in root.findall("joint"):
        child = joint.find("child")
        if child is not None:
            above[child.get("link", "")] = joint
    found: list[ElementTree.Element] = []
    link = tool
    while link != base:
        parent = above[link].find("parent") if link in above else None
        if parent is None or len(found) > 200:
            raise RobotError(f"{source}: {base!r} is not on the way from {tool!r} to the root; it stops at {link!r}")
        found.append(above[link])
        link = parent.get("link", "")
    return found[::-1]


def _rename(root: ElementTree.Element, old: str, new: str) -> None:
    for element in root.iter():
        if element.tag == "link" and element.get("name") == old:
            element.set("name", new)
        if element.tag in ("parent", "child") and element.get("link") == old:
            element.set("link", new)
