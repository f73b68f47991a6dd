# SPDX-License-Identifier: Apache-2.0
"""`irec latency BAG`: how late the robot follows the force, for parameter `lead` of the correction."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..sensors.latency import find_latency
from ..sensors.motion_recording import read_force_and_motion


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, help="recording of a course with the correction in force")
    parser.add_argument("--wrench", default="wrench", metavar="TOPIC", help="wrench at the TCP in tool0 (default: wrench)")
    parser.add_argument("--pose", default="tcp_pose", metavar="TOPIC", help="TCP by the controller (default: tcp_pose)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: found."""
    data = read_force_and_motion(args.bag, args.wrench, args.pose, "")
    found = find_latency(data.force_stamp, data.force, data.pose_stamp, data.p)
    figures = {"latency_s": found.delay, "standard_error_s": found.se, "explained": found.explained}
    if args.json:
        print(json.dumps(figures, indent=2))
    else:
        print(
            f"the TCP follows the force {1e3 * found.delay:.1f} +- {1e3 * found.se:.1f} ms late"
            f" ({100 * found.explained:.0f} % of its unsteady motion explained)\n"
            f"for the correction: lead: {min(found.delay, 0.1):.4f}\n"
            "what passes in the sensor before the wrench is stamped does not show in this"
        )
    return 0
