# SPDX-License-Identifier: Apache-2.0
"""Policies of SROS 2, one enclave per process: `python tools/security/policies.py -o out/security [--namespace cell_a]`.

Writes irec.policy.xml, which `ros2 security generate_artifacts -k KEYSTORE -p irec.policy.xml` turns into keys and permissions.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

sys.path.insert(0, str(Path(__file__).resolve().parent))

from interfaces import NODES, Node

ENCLAVES = {  # nodes that share a process share its keys
    "procedure": ("procedure_node",),
    "calibration": ("calibration_node", "calibration_node_listener"),
    "recorder": ("recorder",),
    "tf": ("tf_node",),
    "correction": ("correction_node",),
    "rsi_bridge": ("rsi_bridge",),
    "can_ft": ("can_ft_node",),
    "cell": ("cell", "simulator"),
    "workbench": ("irec_cell_page",),
    "ros2_control_driver": ("driver",),
    "tracker": ("tracker",),
}


def policy(namespace: str = "") -> ET.Element:
    """The tree of one policy file; namespace: of the cell, without slashes at its ends."""
    by_name = {node.name: node for node in NODES}
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    for name, nodes in ENCLAVES.items():
        enclave = ET.SubElement(enclaves, "enclave", path="/".join(("", "irec", *filter(None, [namespace]), name)))
        profiles = ET.SubElement(enclave, "profiles")
        for node in nodes:
            _profile(profiles, by_name[node], namespace)
    return root


def _profile(parent: ET.Element, node: Node, namespace: str) -> None:
    profile = ET.SubElement(parent, "profile", ns=f"/{namespace}", node=node.name)
    for kind, role, names in (
        ("topic", "publish", node.publishes), ("topic", "subscribe", node.subscribes), ("service", "reply", node.serves),
        ("service", "request", node.call), ("action", "execute", node.execute), ("action", "call", node.send),
    ):  # fmt: skip
        if names:
            group = ET.SubElement(profile, f"{kind}s", {role: "ALLOW"})
            for name in sorted(names):
                ET.SubElement(group, kind).text = full_name(name, node.name, namespace, clock=True)


def full_name(name: str, node: str, namespace: str, clock: bool = False) -> str:
    """As a policy names it; the launch files remap /clock into the namespace of a simulated cell."""
    space = f"/{namespace}" if namespace else ""
    if name.startswith("~/"):
        return f"{space}/{node}/{name[2:]}"
    if clock and name == "/clock":
        return f"{space}/clock"
    return name if name.startswith("/") else f"{space}/{name}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/security"))
    parser.add_argument("--namespace", default="", help="of the cell, as given to the launch files")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    tree = ET.ElementTree(policy(args.namespace.strip("/")))
    ET.indent(tree)
    path = args.out / "irec.policy.xml"
    tree.write(path, encoding="utf-8", xml_declaration=True)
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
