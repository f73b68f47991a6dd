# SPDX-License-Identifier: Apache-2.0
"""The effects that irec brings along, in the order in which they are listed."""

from __future__ import annotations

from .base import Effect
from .base_compliance import BaseCompliance
from .bending_place import BendingPlace
from .counterbalance import Counterbalance
from .creep import Creep
from .disc_compliance import DiscCompliance
from .encoder_harmonics import EncoderHarmonics
from .external_force import ExternalForce
from .geometry_error import GeometryError
from .joint_backlash import JointBacklash
from .joint_coupling import JointCoupling
from .joint_hysteresis import JointHysteresis
from .joint_ripple import JointRipple
from .joint_settling import JointSettling
from .joint_stiffening import JointStiffening
from .joint_torsion import JointTorsion
from .link_bending import LinkBending
from .linkage_compliance import LinkageCompliance
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

CATALOGUE: tuple[type[Effect], ...] = (
    JointTorsion,
    LinkBending,
    BendingPlace,
    LinkageCompliance,
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
    DiscCompliance,
    StationShift,
    ThermalDrift,
    Creep,
    MarkerOffset,
    GeometryError,
    StationPose,
    MarkerPosition,
    JointSettling,
    EncoderHarmonics,
    JointRipple,
    ExternalForce,
)
