# SPDX-License-Identifier: Apache-2.0
"""`irec joint-stiffness DATA [--profile P]`: timing skew between the encoders, then stiffness, or that it can't be told."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from ..diagnose.result import finite
from ..files import all_or_none, write_file
from ..sensors.joint_recording import read_recordings
from ..sensors.joint_stiffness import Axis, JointStiffness, Trajectory, joint_stiffness


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", help=".mat or .csv recording, or a folder of them (each file is one trajectory)")
    parser.add_argument("--profile", help="mapping file (irec-joints/1) that says which field is which channel")
    parser.add_argument("-o", "--output", help="folder for joint_stiffness.json and a figure (default: nothing is written)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    recordings = read_recordings(args.data, args.profile)
    result = joint_stiffness(recordings)
    data = finite(asdict(result))
    if args.output:
        folder = Path(args.output)
        with all_or_none():
            write_file(folder / "joint_stiffness.json", json.dumps(data, indent=1) + "\n")
            _draw(recordings, result, folder / "joint_stiffness.png")
    print(json.dumps(data) if args.json else in_words(result))
    return 0 if any(a.identified for a in result.axes) else 1


def in_words(r: JointStiffness) -> str:
    """The result for a terminal."""
    lines = [f"{len(r.units)} trajectories: {', '.join(r.units)}"]
    for a in r.axes:
        units = ", ".join(f"{1e3 * s:.2f}" for s in a.skew_by_unit)
        lines.append(
            f"axis {a.number}: the encoders differ by {1e6 * a.spread_rad:.0f} urad rms; {100 * a.skew_share:.1f} % of its "
            "square is"
            f" proportional to velocity: skew {1e3 * a.skew_s.value:.2f} +- {1e3 * a.skew_s.se:.2f} ms ({units})"
        )
    same = "the same on all axes" if not r.same_skew_p < 0.05 else "not the same on all axes"
    lines.append(
        f"timing skew {1e3 * r.common_skew_s.value:.2f} +- {1e3 * r.common_skew_s.se:.2f} ms, {same} (p = {r.same_skew_p:.2f})"
    )
    for a in r.axes:
        lines.append(_stiffness(a))
        by = "; ".join(f"{n}: {1e8 * c.value:.1f} +- {1e8 * c.se:.1f}" for n, c in a.compliance.items())
        lines.append(f"        compliance in 1e-8 rad/(N m), with nuisances {by}")
        lines.append(
            f"        reversal {1e6 * a.reversal_rad.value:.0f} +- {1e6 * a.reversal_rad.se:.0f} urad; left unexplained"
            f" {1e6 * a.residual_rad:.0f} urad rms; torque {a.torque[0]:.0f} .. {a.torque[1]:.0f} N m"
        )
    if r.silent:
        lines.append(f"axes {', '.join(map(str, r.silent))}: no link encoder was logged")
    return "\n".join(lines + [f"note: {n}" for n in r.notes])


def _stiffness(a: Axis) -> str:
    if not a.identified:
        return f"axis {a.number}: stiffness cannot be told from these data: {a.why_not}"
    return (
        f"axis {a.number}: stiffness {1e-6 * a.stiffness:.1f} MN m/rad, between {1e-6 * a.stiffness_low:.1f} and"
        f" {1e-6 * a.stiffness_high:.1f} (scatter over trajectories and choice of nuisances)"
    )


def _draw(recordings: list[Trajectory], r: JointStiffness, path: Path) -> None:
    import numpy as np
    from scipy.signal import savgol_filter

    from ..report.style import pyplot, save

    plt = pyplot()
    figure, axes = plt.subplots(2, len(r.axes), figsize=(4.2 * len(r.axes), 6.4), squeeze=False, layout="constrained")
    for column, a in enumerate(r.axes):
        for t in recordings:
            q = t.motor[:, a.number - 1]
            d = q - t.link[:, a.number - 1]
            v = savgol_filter(q, 11, 3, 1, t.step)
            left = d - a.skew_s.value * v
            axes[0, column].plot(v, 1e6 * (d - d.mean()), ",", alpha=0.6)
            axes[1, column].plot(1e-3 * t.torque[:, a.number - 1], 1e6 * (left - left.mean()), ",", alpha=0.6, label=t.name)
        line = np.array([np.min(v), np.max(v)])
        axes[0, column].plot(line, 1e6 * a.skew_s.value * line, "k-", lw=1)
        axes[0, column].set_title(f"axis {a.number}: skew {1e3 * a.skew_s.value:.2f} ms")
        axes[0, column].set_xlabel("velocity, rad/s")
        axes[1, column].set_xlabel("torque on the link side, kN m")
        low, high = 1e-3 * a.torque[0], 1e-3 * a.torque[1]
        title = f"{1e-6 * a.stiffness:.1f} MN m/rad" if a.identified else "stiffness unknown"
        if a.identified:
            middle = 1e-3 * float(np.mean([t.torque[:, a.number - 1].mean() for t in recordings]))
            ends = np.array([low, high])
            axes[1, column].plot(ends, 1e9 / a.stiffness * (ends - middle), "k-", lw=1)
        axes[1, column].set_title(title)
    axes[0, 0].set_ylabel("motor - link, urad")
    axes[1, 0].set_ylabel("motor - link without the skew, urad")
    save(figure, path, 130)
