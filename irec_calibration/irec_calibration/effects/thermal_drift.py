# SPDX-License-Identifier: Apache-2.0
"""Links and tracker stand drift between the reference and the loaded sample."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .station_shift import turned_about_station
from .traits import Cause, Family

AXES = ("x", "y", "z")
OF_ARM = " of the arm"  # what a course drives there, in the name of its part
LEANING = ", leaning"  # the tracker's stand, likewise
SLOWER = 5.0  # times as long as what warms up first takes what does so beside it


class ThermalDrift(Effect):
    id = "thermal_drift"
    label = "thermal drift"
    physics = (
        "Links and tracker stand grow while the cell warms up: v T (1 - exp(-t/T)), which is v t for a long T, beside it what "
        "takes five times as long, w in place of v, where longer is 1, or in proportion to a logged temperature. The arm does so "
        "too: in absolute sessions it grows from base_link outwards, in loaded ones each link from one joint to the next, and "
        "links that bow turn what is beyond (turn_k). In absolute sessions a stand that leans is seen, too. Missing, the "
        "residual grows with the time since the reference and is blind to force."
    )
    family = Family.TIME
    cause = Cause.TIME
    needs = ("time",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = _of_driver(scene, "v", "s", 1e-6, 1e-4, "time")
        for name in usable_temperatures(scene):
            # a thermometer may go through a small part of what the drifting part does: then the drift has a limit, not the value
            most = max(LARGEST_PER_KELVIN, LARGEST / max(float(np.ptp(scene.temperature[name])), 1e-3))
            out += _of_driver(scene, f"k_{name}", "K", STEEL, most, f"temp_{name}")
        out += [Parameter(f"w_{a}", "m/s", 1e-6, plausible=(-1e-4, 1e-4), group="time") for a in AXES]
        return (
            *out,
            Parameter("longer", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0), kinds=True),
            Parameter("T", "s", 1000.0, 10.0, 1e6, start=STEADY, grid=(300.0, 1000.0, 3000.0, STEADY)),
        )

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        by_warmth = any(n.startswith("k_") for n in values)  # beside it, how fast a drift in time ends says little
        if by_warmth or "T" not in values or values["T"][0] >= QUICKEST:
            return ""
        T = values["T"][0]
        return f"it would be over within minutes (T = {T:.0f} s), and what grows warm takes longer ({QUICKEST:.0f} s at least)"

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, theta) @ theta[:-2]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        ways = _ways(scene)
        by_T = _by_constant(scene, theta[-1])[:, None] * (ways @ theta[: ways.shape[2]])
        if theta[-2] >= 0.5:
            by_T += SLOWER * _by_constant(scene, SLOWER * theta[-1])[:, None] * theta[-5:-2]
        by_shape = [np.zeros((len(scene), 3, 1)), by_T[:, :, None]]
        return np.concatenate([self._columns(scene, theta), *by_shape], axis=2)

    def _columns(self, scene: Scene, theta: Array) -> Array:
        longer, T = theta[-2:]
        drivers = [_course(scene, T)] + [scene.temperature[n] - REFERENCE_TEMPERATURE for n in usable_temperatures(scene)]
        beside = _course(scene, SLOWER * T)[:, None, None] * np.eye(3) * (longer >= 0.5)
        return np.concatenate([*(d[:, None, None] * _ways(scene) for d in drivers), beside], axis=2)


def _course(scene: Scene, T: float) -> Array:
    """What grows at a rate of one at first and ends after T, (n,), s."""
    return np.asarray(-T * np.expm1(-scene.stamp / T))


def _by_constant(scene: Scene, T: float) -> Array:
    """Its derivative by T, (n,)."""
    share = scene.stamp / T
    return np.asarray(-np.expm1(-share) - share * np.exp(-share))


def _of_driver(scene: Scene, name: str, per: str, scale: float, most: float, group: str) -> list[Parameter]:
    """Parameters of what one course (time, a temperature) drives, as the columns of `_ways`."""
    out = [Parameter(f"{name}_{a}", f"m/{per}", scale, plausible=(-most, most), group=group) for a in AXES]
    growth, at = most / REACH, f"{group}{OF_ARM}"
    if scene.kind != "absolute":
        links = [(f"link_{k + 1}", f"1/{per}") for k in _links(scene)] + [(f"turn_{k + 1}", f"rad/{per}") for k in _bowed(scene)]
        return out + [Parameter(f"{name}_{n}", u, scale / REACH, plausible=(-growth, growth), group=at) for n, u in links]
    out.append(Parameter(f"{name}_growth", f"1/{per}", scale / REACH, plausible=(-growth, growth), group=at))
    if _watches_base(scene):
        out += [Parameter(f"{name}_{a}_arm", f"m/{per}", scale, plausible=(-most, most), group=at) for a in AXES]
    leans = f"{group}{LEANING}"
    return out + [
        Parameter(f"{name}_lean_{a}", f"rad/{per}", scale / REACH, plausible=(-growth, growth), group=leans) for a in AXES
    ]


def _ways(scene: Scene) -> Array:
    """How each row moves by one unit of a course: all that the station sees along x, y, z; in absolute sessions an arm that grows
    in all directions from base_link, where markers on the base tell the stand from the arm the arm alone along x, y, z, and a
    stand that leans about x, y, z; in loaded ones the links of the arm, each by its length, and those that bow."""
    along = np.tile(np.eye(3), (len(scene), 1, 1))
    if scene.kind != "absolute":
        grown = np.diff(scene.kin.origin, axis=1)[:, _links(scene)].swapaxes(1, 2) * scene.moves_with_arm[:, None, None]
        return np.concatenate([along, grown, scene.J[:, :, _bowed(scene)]], axis=2)
    arm = scene.moves_with_arm[:, None, None]
    ways = [along, arm * scene.p_observed[:, :, None]]
    if _watches_base(scene):
        ways.append(arm * along)
    return np.concatenate([*ways, turned_about_station(scene)], axis=2)


def _links(scene: Scene) -> list[int]:
    """Joints of the arm, counted from 0, from which a link leads to the next joint, long enough to show what it grows by."""
    ways = np.diff(scene.kin.origin, axis=1)
    far = np.linalg.norm(ways, axis=2).max(axis=0, initial=0.0)
    return [int(k) for k in np.flatnonzero(far > SHORTEST * max(float(far.sum()), 1e-9))]


def _bowed(scene: Scene) -> list[int]:
    """Joints of the arm, counted from 0, beyond the first one and before the wrist, about which a link that bows turns what is
    beyond it."""
    return [k for k in range(1, scene.n_joints) if k not in scene.wrist and not scene.kin.is_prismatic[k]]


def _watches_base(scene: Scene) -> bool:
    return not bool(scene.moves_with_arm.all())


STEEL = 3e-5  # m/K, an arm of steel of 2.5 m
REACH = 2.5  # m
SHORTEST = 0.1  # of the length of all links; what a shorter one grows by is no more than rounding beside them
LARGEST_PER_KELVIN = 1e-3  # m/K
LARGEST = 2e-3  # m over a session; arms that warm up drift by 0.1 to 0.5 mm
QUICKEST = 300.0  # s; arms and stands warm up with time constants of half an hour and more
STEADY = 1e5  # s; a warm-up this slow is a steady drift
REFERENCE_TEMPERATURE = 20.0  # degC, ISO 1


def usable_temperatures(scene: Scene) -> list[str]:
    """Names of the temperatures that were measured in every row."""
    return [n for n, values in scene.temperature.items() if np.isfinite(values).all()]
