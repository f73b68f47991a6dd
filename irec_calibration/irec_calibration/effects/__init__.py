# SPDX-License-Identifier: Apache-2.0
"""The catalogue of physical effects, and how effects of users are found.

An effect is named by its id (catalogue, or an installed package's entry point in the group `irec.effects`).
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from ..errors import EffectError
from .base import Effect, Parameter, absent
from .base_compliance import BaseCompliance
from .counterbalance import Counterbalance
from .creep import Creep
from .encoder_harmonics import EncoderHarmonics
from .external_force import ExternalForce
from .geometry_error import GeometryError
from .joint_backlash import JointBacklash
from .joint_coupling import JointCoupling
from .joint_hysteresis import JointHysteresis
from .joint_settling import JointSettling
from .joint_stiffening import JointStiffening
from .joint_torsion import JointTorsion
from .link_bending import LinkBending
from .marker_offset import MarkerOffset
from .marker_position import MarkerPosition
from .rail_compliance import RailCompliance
from .sensor_alignment import SensorAlignment
from .sensor_gain import SensorGain
from .station_pose import StationPose
from .station_registration import StationRegistration
from .station_shift import StationShift
from .thermal_drift import ThermalDrift
from .tool_compliance import ToolCompliance
from .tool_weight import ToolWeight
from .tracker_scale import TrackerScale

__all__ = ["CATALOGUE", "Effect", "Parameter", "absent", "find_effect", "known_effects", "register"]

CATALOGUE: tuple[type[Effect], ...] = (
    JointTorsion,
    LinkBending,
    ToolCompliance,
    BaseCompliance,
    RailCompliance,
    JointStiffening,
    JointBacklash,
    JointHysteresis,
    Counterbalance,
    JointCoupling,
    SensorGain,
    SensorAlignment,
    ToolWeight,
    StationRegistration,
    TrackerScale,
    StationShift,
    ThermalDrift,
    Creep,
    MarkerOffset,
    GeometryError,
    StationPose,
    MarkerPosition,
    JointSettling,
    EncoderHarmonics,
    ExternalForce,
)

_registered: dict[str, Effect] = {}


@cache
def _installed() -> dict[str, Effect]:
    found: dict[str, Effect] = {}
    for point in entry_points(group="irec.effects"):
        try:
            effect = point.load()()
        except Exception as error:  # whatever a foreign package raises must name that package
            raise EffectError(f"effect '{point.name}' of {point.value}: can't be loaded: {error}") from error
        found[effect.id] = effect
    return found


def register(effect: Effect) -> None:
    """Make an effect of the user known in this process. Raises EffectError where its id is taken by another one."""
    taken = known_effects().get(effect.id)
    if taken is not None and type(taken) is not type(effect):
        raise EffectError(f"effect id '{effect.id}' is taken already by {type(taken).__module__}")
    _registered[effect.id] = effect


def known_effects() -> dict[str, Effect]:
    """All effects by id: the catalogue, installed packages, those registered in this process."""
    return {**{e.id: e() for e in CATALOGUE}, **_installed(), **_registered}


def find_effect(effect_id: str) -> Effect:
    """The effect of an id, or of the dotted path of an installed or registered effect class.

    Raises:
        EffectError: no such effect; names those that exist.
    """
    known = known_effects()
    by_path = {f"{type(e).__module__}.{type(e).__qualname__}": e for e in known.values()}
    if effect_id in by_path:
        return by_path[effect_id]
    if effect_id not in known:
        raise EffectError(f"effect '{effect_id}' is not known; there are {', '.join(known)}; effects of your own: --effects FILE")
    return known[effect_id]
