# SPDX-License-Identifier: Apache-2.0
"""Sentences and tables of the page: one sample, a group of samples, parameters. For people: um, mm, degrees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..identification.validation import rms
from ..lengths import length
from ..model import NO_UNIT
from ..report.addition import probability
from ..typing import Array, BoolArray
from .plain import ParameterEntry, SessionView, Version

NEIGHBOURS = 3


def number(value: float, digits: int = 3) -> str:
    """A number as far as it is known; of a usual size without a power of ten."""
    if not math.isfinite(value):
        return "-"
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if 10**digits <= abs(rounded) < 1e6 else f"{rounded:.{digits}g}"


def scaled(p: ParameterEntry) -> tuple[float, str]:
    """Factor and unit in which a parameter of rad or m is a number of usual size: urad/(N m) rather than 1e-6 rad/(N m)."""
    if p.unit in (*NO_UNIT, "by formula"):
        return 1.0, ""
    size = max(abs(p.value), p.se if math.isfinite(p.se) else 0.0)
    if p.unit.split("/")[0] in ("rad", "m") and 0.0 < size < 0.1:
        for factor, prefix in ((1e3, "m"), (1e6, "u"), (1e9, "n")):
            if factor * size >= 0.1:
                return factor, prefix + p.unit
    return 1.0, p.unit


def parameter(p: ParameterEntry) -> dict[str, str]:
    """One row of the table of parameters."""
    factor, unit = scaled(p)
    p = replace(p, value=factor * p.value, se=factor * p.se, lower=factor * p.lower, upper=factor * p.upper)
    digits = 3
    if math.isfinite(p.se) and p.se > 0.0 and p.value:
        digits = int(np.clip(math.floor(math.log10(abs(p.value))) - math.floor(math.log10(p.se)) + 2, 1, 6))
    known = "" if p.identified else "only in a sum" if not math.isfinite(p.se) else "weakly known"
    low, high = (
        ("-∞" if not math.isfinite(p.lower) else number(p.lower)),
        ("∞" if not math.isfinite(p.upper) else number(p.upper)),
    )
    return {
        "name": p.name,
        "value": number(p.value, digits),
        "se": f"± {number(p.se, 2)}" if math.isfinite(p.se) else "",
        "unit": unit,
        "bounds": f"{low} … {high}",
        "known": known if p.plausible else f"{known} implausible".strip(),
    }


def sample(view: SessionView, version: Version, residual: Array, i: int) -> list[tuple[str, str]]:
    """What there is to say of one observed sample: name and value."""
    r = int(version.rows[i])
    norm = float(np.linalg.norm(residual[i]))
    out = [
        ("pose", f"{view.pose[r]}, load case {view.case_names[r]}" + (f", repeat {view.repeat[r]}" if view.repeat[r] else "")),
        ("row, time", f"{r + 1} of the session, {view.stamp[r]:.1f} s"),
        ("station", view.station[r] if view.station else "-"),
        ("force in tool0", f"{_vector(view.force[r], 1)} N"),
        ("torque in tool0", f"{_vector(view.torque[r], 1)} N m"),
        ("torque about the axes", f"{_vector(view.tau[r], 0)} N m"),
        ("measured", f"{_vector(1e3 * version.measured[i], 3)} mm"),
        ("predicted", f"{_vector(1e3 * version.predicted[i], 3)} mm"),
        (
            "residual",
            f"{_vector(1e6 * residual[i], 0)} um, {length(norm)}, {norm / max(float(version.sigma[i]), 1e-9):.1f} x noise",
        ),
    ]
    same = np.flatnonzero((view.pose[version.rows] == view.pose[r]) & (view.load_case[version.rows] == view.load_case[r]))
    if len(same) > 1:
        out.append(("repeats", ", ".join(length(float(np.linalg.norm(residual[j]))) for j in same)))
    gap = np.linalg.norm(view.p_tcp[version.rows] - view.p_tcp[r], axis=1)
    gap[(view.load_case[version.rows] != view.load_case[r]) | (view.pose[version.rows] == view.pose[r])] = np.inf
    near = [j for j in np.argsort(gap)[:NEIGHBOURS] if np.isfinite(gap[j])]
    if near:
        text = [f"pose {view.pose[version.rows[j]]} ({gap[j]:.2f} m): {_vector(1e6 * residual[j], 0)} um" for j in near]
        out.append(("neighbours, same load case", "; ".join(text)))
    return out


def group(view: SessionView, version: Version, residual: Array, chosen: BoolArray) -> list[str]:
    """What the views say of a group of samples against all others."""
    inside, outside = residual[chosen], residual[~chosen]
    if not len(inside):
        return ["The group is empty."]
    total = float((residual**2).sum()) or 1.0
    out = [
        f"{int(chosen.sum())} of {len(chosen)} samples, {100 * float((inside**2).sum()) / total:.0f} % of the squared residual:"
        f" {length(rms(inside))} rms" + (f", the others {length(rms(outside))}." if len(outside) else ".")
    ]
    mean = inside.mean(axis=0)
    error = math.sqrt(float(np.mean(version.sigma[chosen] ** 2)) / 3.0 / len(inside))
    if np.linalg.norm(mean) > 4.0 * error:
        share = float(mean @ mean) / max(rms(inside) ** 2, 1e-30)
        out.append(
            f"They share a direction: mean {_vector(1e6 * mean, 0)} um along base x, y, z ({100 * share:.0f} % of their square)."
        )
    rows, others = version.rows[chosen], version.rows[~chosen]
    cases = {view.case_names[r] for r in rows}
    if len(cases) == 1 and len(set(view.case_names)) > 2:
        out.append(f"All are of load case {next(iter(cases))}.")
    differ = []
    for name, column in view.columns.items():
        a, b = column[rows], column[others]
        spread = float(np.nanstd(column[version.rows])) or 1.0
        if len(b) and name not in ("pose", "load case", "stamp"):
            differ.append(
                ((float(np.nanmean(a)) - float(np.nanmean(b))) / spread, name, float(np.nanmean(a)), float(np.nanmean(b)))
            )
    differ.sort(key=lambda d: -abs(d[0]))
    for size, name, here, there in differ[:3]:
        if abs(size) > 0.8:
            value = f"{number(here)} {view.units.get(name, '')}".rstrip()
            out.append(f"{name} is {value} on average, {number(there)} in the others.")
    return out


CLAIMS = {
    "tracker_m": ("tracker {:g} um", 1e6), "tracker_m_per_m": ("{:g} um per m of distance", 1e6),
    "force_n": ("force {:g} N", 1.0), "settling_m": ("standing still {:g} um", 1e6),
    "robot_m": ("robot {:g} um", 1e6), "robot_rad": ("robot {:g} urad", 1e6),
}  # fmt: skip


def claims(noise: dict[str, float]) -> str:
    """The noise that a session claims, for people."""
    return ", ".join(CLAIMS[k][0].format(float(f"{v * CLAIMS[k][1]:.3g}")) for k, v in noise.items() if k in CLAIMS and v)


def noise_lines(version: Version, claimed: dict[str, float], inferred: dict[str, object] | None) -> list[str]:
    """The noise as claimed and as the data show it."""
    said = claims(claimed) or "nothing"
    per_sample = inferred.get("claimed_m") if inferred else None
    out = [f"Claimed in the session: {said}; that is {length(float(per_sample or version.noise_m))} per sample."]  # type: ignore[arg-type]
    if math.isfinite(version.repeat_m):
        out.append(f"Repeats scatter by {length(version.repeat_m)}.")
    else:
        out.append("Nothing was repeated, so repeats can't check the claim.")
    if inferred and isinstance(inferred.get("inferred_m"), float):
        low, high = inferred.get("inferred_low_m"), inferred.get("inferred_high_m")
        between = f" ({length(low)} to {length(high)})" if isinstance(low, float) and isinstance(high, float) else ""
        out.append(f"The data show {length(float(inferred['inferred_m']))}{between}, from {inferred.get('source', 'the data')}.")  # type: ignore[arg-type]
    return out


def candidate(c: dict[str, object], base_m: float) -> str:
    """What a candidate promises, in a line."""
    trial = c.get("cv_rms_m")
    promise = f"{length(base_m)} → {length(float(trial))}" if isinstance(trial, float) else "no error on held-out poses"
    p = c.get("p_value")
    return f"{promise}, {probability(float(p))}" if isinstance(p, float) else promise


def _vector(v: Array, digits: int) -> str:
    return " ".join(f"{x:.{digits}f}" for x in v)
