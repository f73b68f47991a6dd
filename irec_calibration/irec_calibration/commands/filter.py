# SPDX-License-Identifier: Apache-2.0
"""`irec filter BAG... -o filter.csv`: a filter of the wrench for the measured spectrum of the force, for `filter.file`."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
from scipy import signal

from ..errors import RecordingError
from ..files import check_replaceable, write_file
from ..files.outputs import TAPS
from ..sensors.latency import find_latency
from ..sensors.look_ahead import Design, design, spectrum
from ..sensors.motion_recording import ForceAndMotion, read_force_and_motion
from ..typing import Array

RATE = 250.0  # Hz
_LEFT_OUT = 0.5  # s at either end of the contact


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, nargs="+", help="recordings of courses with the correction in force")
    parser.add_argument("-o", "--output", type=Path, default=Path("filter.csv"), help="table (default: filter.csv)")
    parser.add_argument("--lead", type=float, help="s to look ahead, without the low-pass (default: as the first recording says)")
    parser.add_argument("--cutoff", type=float, default=40.0, help="low-pass that was in force, Hz; 0: none (default: 40)")
    parser.add_argument("--compliance", type=float, default=2e-6, help="largest of the TCP, m/N (default: 2e-6)")
    parser.add_argument("--acceleration", type=float, default=0.5, help="limit of the offset: m/s^2 (default: 0.5)")
    parser.add_argument("--taps", type=int, default=60, help="samples that it looks back (default: 60)")
    parser.add_argument("--wrench", default="wrench", metavar="TOPIC", help="wrench at the TCP in tool0 (default: wrench)")
    parser.add_argument("--pose", default="tcp_pose", metavar="TOPIC", help="TCP by the controller (default: tcp_pose)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: written."""
    for name, value, low, high in (
        ("--cutoff", args.cutoff, 0.0, 0.49 * RATE), ("--compliance", args.compliance, 1e-9, 1e-3),
        ("--acceleration", args.acceleration, 1e-3, 50.0), ("--lead", args.lead or 0.0, 0.0, 0.1),
    ):  # fmt: skip
        if not low <= value <= high:
            raise RecordingError(f"{name} is {value:g}; {low:g} .. {high:g} is possible")
    recorded = [read_force_and_motion(bag, args.wrench, args.pose, "") for bag in args.bag]
    force = np.concatenate([in_contact(bag, data) for bag, data in zip(args.bag, recorded, strict=True)])
    lead = args.lead if args.lead is not None else _lead(recorded[0], args.cutoff)
    noise = floor(force)
    # a third of the limit, so that the limit itself acts rarely
    found = design(force, RATE, lead, noise, args.taps, cutoff=args.cutoff or 0.45 * RATE, compliance=args.compliance,
                   acceleration=args.acceleration / 3.0)  # fmt: skip
    taps = found.taps / found.taps.sum()
    rows = ["force_x,force_y,force_z", *(",".join([f"{x:.10g}"] * 3) for x in taps)]
    check_replaceable(args.output, "a table of a filter", TAPS, RecordingError)
    write_file(args.output, "\n".join(rows) + "\n", error=RecordingError)
    _tell(args, found, noise, len(force) / RATE)
    return 0


def in_contact(bag: Path, data: ForceAndMotion) -> Array:
    """Force (n, 3), N, at 250 Hz while the tool is in contact: above half of what it is for most of the time.

    Raises:
        RecordingError: for less than 5 s.
    """
    t = np.arange(data.force_stamp[0], data.force_stamp[-1], 1.0 / RATE)
    force = np.stack([np.interp(t, data.force_stamp, x) for x in data.force.T], axis=1)
    wide = round(0.2 * RATE)
    slow = np.convolve(np.linalg.norm(force, axis=1), np.ones(wide) / wide, "same")
    there = np.flatnonzero(slow > 0.5 * np.quantile(slow, 0.7))
    out = round(_LEFT_OUT * RATE)
    if len(there) < 5.0 * RATE + 2 * out:
        raise RecordingError(f"{bag}: the tool is in contact for {len(there) / RATE:.1f} s; 6 s or more are needed")
    return force[there[0] + out : there[-1] - out]


def floor(force: Array) -> float:
    """Noise of the sensor per sample and axis, N: what the spectrum of a force (n, 3) is near half the sampling rate."""
    f, density = spectrum(force, RATE)
    return math.sqrt(float(np.median(density[f > 0.36 * RATE])) * RATE / 6.0)


def _lead(data: ForceAndMotion, cutoff: float) -> float:
    """Latency without the delay of the low-pass, whose place the filter takes, s."""
    delay = find_latency(data.force_stamp, data.force, data.pose_stamp, data.p).delay
    if cutoff > 0.0:
        w, h = signal.sosfreqz(signal.butter(2, cutoff, fs=RATE, output="sos"), worN=[1e-3, 2e-3])
        delay += float(np.diff(np.unwrap(np.angle(h)))[0] / (w[1] - w[0])) / RATE
    return float(np.clip(delay, 0.0, 0.1))


def _tell(args: argparse.Namespace, found: Design, noise: float, seconds: float) -> None:
    if args.json:
        figures = {"lead_s": found.lead, "noise_n": noise, "left": found.left, "left_by_low_pass": found.before}
        print(json.dumps({**figures, "acceleration_m_s2": found.acceleration, "table": str(args.output)}, indent=2))
        return
    print(
        f"{seconds:.0f} s of force; the sensor's noise is {noise:.1f} N; the filter looks {1e3 * found.lead:.1f} ms ahead\n"
        f"of the unsteady deviation it leaves {100 * found.left:.0f} %, a low-pass {100 * found.before:.0f} %"
        f" (acceleration of the offset {found.acceleration:.2f} m/s^2 RMS)\n"
        f"written: {args.output}\n"
        f"for the correction: filter.file: {args.output}, lead: 0.0"
    )
