# SPDX-License-Identifier: Apache-2.0
"""`irec modes BAG...`: modes of arm and head from recordings of a tap or a swept force on the standing robot."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..sensors.motion_recording import read_force_and_motion
from ..sensors.structure import Structure, find_structure


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, nargs="+", help="recordings, one for each posture")
    parser.add_argument("--wrench", default="wrench", metavar="TOPIC", help="wrench at the TCP in tool0 (default: wrench)")
    parser.add_argument("--pose", default="tcp_pose", metavar="TOPIC", help="TCP by the controller (default: tcp_pose)")
    parser.add_argument("--tracker", default="tracker/point", metavar="TOPIC", help="tracker (default: tracker/point)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def structure_of(bag: Path, wrench: str = "wrench", pose: str = "tcp_pose", tracker: str = "tracker/point") -> Structure:
    """Modes from one recording. Raises RecordingError."""
    data = read_force_and_motion(bag, wrench, pose, tracker)
    if len(data.tracker) < 2:
        raise RecordingError(f"{bag}: no message on '{tracker}'; modes need the motion of the tool, not of the motors")
    begin, end = max(data.force_stamp[0], data.tracker_stamp[0]), min(data.force_stamp[-1], data.tracker_stamp[-1])
    rate = float(1.0 / np.median(np.diff(data.tracker_stamp)))
    t = np.arange(begin, end, 1.0 / rate)
    force, motion = (
        np.stack([np.interp(t, stamp, x[:, k]) for k in range(3)], axis=1)
        for stamp, x in ((data.force_stamp, data.force), (data.tracker_stamp, data.tracker))
    )
    return find_structure(force, motion, rate)


def run(args: argparse.Namespace) -> int:
    """0: found."""
    found = {str(bag): structure_of(bag, args.wrench, args.pose, args.tracker) for bag in args.bag}
    if args.json:
        print(json.dumps({bag: _plain(s) for bag, s in found.items()}, indent=2))
        return 0
    for bag, s in found.items():
        print(f"{bag}: {len(s.modes)} modes, the fit leaves {100 * s.left:.0f} % of the response")
        for m in s.modes:
            axis = ", ".join(f"{x:+.2f}" for x in m.direction)
            print(
                f"  {m.frequency:6.2f} Hz  damping {m.damping:.3f}  {100 * m.share:5.1f} % of the static "
                f"deflection  along ({axis})"
            )
    return 0


def _plain(s: Structure) -> dict[str, object]:
    return {
        "left": s.left,
        "delay_s": s.delay,
        "modes": [
            {"frequency_hz": m.frequency, "damping": m.damping, "share": m.share, "direction": m.direction.tolist()}
            for m in s.modes
        ],
    }
