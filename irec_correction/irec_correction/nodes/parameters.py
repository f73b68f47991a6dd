# SPDX-License-Identifier: Apache-2.0
"""Parameters of the correction: declared with ranges, read into the settings of the chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from irec_calibration.tool_load import ToolLoad
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from ..conditioning import Cable, FilterSettings
from ..correction import CorrectionSettings
from ..errors import SettingsError
from ..limits import Bounds, OffsetLimits
from ..state import StateTimes
from ..watchdog import WatchdogSettings


@dataclass(frozen=True)
class P:
    """One parameter: default, range of a number, and what it is with its unit."""

    name: str
    default: Any
    text: str
    low: float | None = None
    high: float | None = None


PARAMETERS = (
    P("cell", "", "cell file (irec-cell/1): robot, serial, sensor; empty: robot_description and robot_serial"),
    P("robot_serial", "", "serial of the robot, checked against the model; empty: from the cell file"),
    P("tool", "", "name of the mounted tool, checked against the model where both are named"),
    P("model_path", "", "model.yaml to be put in force when configuring; empty: wait for activate_model"),
    P("autostart", False, "configure and activate without a lifecycle manager"),
    P("rate", 250.0, "ticks of the correction, Hz", 50.0, 1000.0),
    P("rail_joint", "ext_rail", "name of the external axis in joint_states"),
    P("gravity", [0.0, 0.0, -9.81], "free fall in base_link, m/s^2"),
    P("offset_frame", "base_link", "frame of the offset: base_link or tool0"),
    P("with_rotation", False, "correct the orientation of the tool too"),
    P("lead", 0.0, "extrapolate the offset by this measured delay, s", 0.0, 0.1),
    P("lead_smoothing", 0.02, "time constant of the rate that is extrapolated, s", 0.001, 1.0),
    P("lead_limit", 2e-4, "largest extrapolation, m and rad", 0.0, 0.01),
    P("need_envelope", True, "refuse a model that does not say in which range it was identified"),
    P("raw_wrench", False, "take wrench_raw in sensor_frame and remove bias, tool weight and cable here"),
    P("sensor_frame", "ft_sensor", "link in which wrench_raw is measured"),
    P("tool_load.mass", 0.0, "kg behind the sensor", 0.0, 2000.0),
    P("tool_load.com", [0.0, 0.0, 0.0], "its centre of mass in sensor_frame, m"),
    P("tool_load.bias_force", [0.0, 0.0, 0.0], "reading without load, N"),
    P("tool_load.bias_torque", [0.0, 0.0, 0.0], "reading without load, N m"),
    P("tool_load.alignment", [0.0, 0.0, 0.0], "rotation vector from sensor_frame to the true sensor, rad"),
    P("cable.force", [0.0, 0.0, 0.0], "pull of hoses on the tool in base_link, N"),
    P("cable.point", [0.0, 0.0, 0.0], "where they pull in sensor_frame, m"),
    P("wrench_rate", 250.0, "rate of the wrench, Hz: the filters are designed for it", 50.0, 8000.0),
    P("filter.median", 0, "samples of the median against spikes, odd; 0: none", 0, 15),
    P("filter.spindle_speed", 0.0, "1/s (rpm / 60) for the notches; 0: none", 0.0, 1000.0),
    P("filter.harmonics", 2, "notches at harmonics of the spindle", 1, 5),
    P("filter.notch_quality", 5.0, "frequency / bandwidth of a notch", 0.5, 100.0),
    P("filter.cutoff", 40.0, "low-pass, Hz; 0: none", 0.0, 4000.0),
    P("filter.order", 2, "order of the low-pass", 1, 6),
    P("process_feed", 0.07, "m/s, to tell what the filters' delay costs", 0.0, 5.0),
    P("deflection_slope", 1e-3, "change of the deflection per metre of path, m/m, likewise", 0.0, 1.0),
    P("limit.translation", 3e-3, "largest offset, m", 1e-5, 0.02),
    P("limit.translation_rate", 0.02, "m/s", 1e-4, 0.5),
    P("limit.translation_acceleration", 0.5, "m/s^2", 1e-3, 50.0),
    P("limit.rotation", 5e-3, "largest offset, rad", 1e-5, 0.05),
    P("limit.rotation_rate", 0.05, "rad/s", 1e-4, 1.0),
    P("limit.rotation_acceleration", 2.0, "rad/s^2", 1e-3, 100.0),
    P("time.ramp_in", 0.5, "from the present offset to the model's, s", 0.0, 60.0),
    P("time.hold", 0.25, "the last offset is held while an input is missing, s", 0.0, 10.0),
    P("time.fade", 1.0, "from the held offset to zero, s", 0.0, 60.0),
    P("time.recover", 0.05, "an input must be sound for this long before the correction comes back, s", 0.0, 10.0),
    P("watch.wrench_timeout", 0.02, "s without a wrench", 0.001, 5.0),
    P("watch.joints_timeout", 0.05, "s without joint states", 0.001, 5.0),
    P("watch.frozen_after", 0.1, "s with one reading repeated to the last bit", 0.01, 60.0),
    P("watch.force_jump", 400.0, "between two samples, N", 1.0, 1e5),
    P("watch.torque_jump", 100.0, "between two samples, N m", 0.1, 1e5),
    P("watch.jump_samples", 3, "samples after which a jump that stays is believed", 2, 1000),
    P("watch.joint_speed_factor", 1.5, "times the velocity limit: a faster joint is not believed", 1.0, 100.0),
    P("watch.joint_jump", 0.01, "allowed on top of that, rad", 0.0, 1.0),
    P("watch.clock_tolerance", 0.5, "s between a stamp and now", 0.001, 60.0),
    P("watch.force_range", 1e5, "range of the sensor, any axis, N", 1.0, 1e6),
    P("watch.torque_range", 1e5, "range of the sensor, any axis, N m", 1.0, 1e6),
    P("watch.joint_margin", 0.2, "rad beyond the joint angles of the model", 0.0, 7.0),
    P("watch.wrench_factor", 1.3, "times the largest wrench of the model", 1.0, 10.0),
    P("watch.torque_margin", 100.0, "N m on top of it", 0.0, 1e5),
)


def declare(node: Node) -> None:
    """Declare all; a value out of its range is refused with its name and range."""
    for p in PARAMETERS:
        descriptor = ParameterDescriptor(description=p.text)
        if p.low is not None and p.high is not None:
            if isinstance(p.default, int):
                descriptor.integer_range = [IntegerRange(from_value=int(p.low), to_value=int(p.high), step=0)]
            else:
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(p.low), to_value=float(p.high), step=0.0)]
        node.declare_parameter(p.name, p.default, descriptor)


class Values:
    """Declared parameters by name."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def __getitem__(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def three(self, name: str) -> tuple[float, float, float]:
        """A parameter of three numbers. Raises SettingsError."""
        value = self[name]
        if len(value) != 3:
            raise SettingsError(f"parameter '{name}' has {len(value)} numbers, it needs 3")
        return tuple(float(v) for v in value)  # type: ignore[return-value]


def correction_settings(v: Values, wrench_frame: str) -> CorrectionSettings:
    """Settings of the chain. Raises SettingsError."""
    watch = {f: v[f"watch.{f}"] for f in WatchdogSettings.__dataclass_fields__ if f != "wrench_frame"}
    parts = [
        Bounds(v[f"limit.{part}"], v[f"limit.{part}_rate"], v[f"limit.{part}_acceleration"])
        for part in ("translation", "rotation")
    ]
    return CorrectionSettings(
        period=1.0 / v["rate"],
        with_rotation=v["with_rotation"],
        lead=v["lead"],
        lead_smoothing=v["lead_smoothing"],
        lead_limit=v["lead_limit"],
        need_envelope=v["need_envelope"],
        limits=OffsetLimits(*parts),
        times=StateTimes(**{f: v[f"time.{f}"] for f in StateTimes.__dataclass_fields__}),
        watchdog=WatchdogSettings(wrench_frame=wrench_frame, **watch),
    )


def filter_settings(v: Values) -> FilterSettings:
    """Settings of the filters."""
    return FilterSettings(
        rate=v["wrench_rate"], **{f: v[f"filter.{f}"] for f in FilterSettings.__dataclass_fields__ if f != "rate"}
    )  # fmt: skip


def tool_load(v: Values) -> ToolLoad:
    """What is taken off the raw wrench. Raises SettingsError."""
    return ToolLoad(v["tool_load.mass"], *(v.three(f"tool_load.{f}") for f in ("com", "bias_force", "bias_torque", "alignment")))


def cable(v: Values) -> Cable:
    """Pull of hoses. Raises SettingsError."""
    return Cable(v.three("cable.force"), v.three("cable.point"))
