# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes, each declared once: config/nodes/correction.yaml, rsi.yaml there and docs/node-parameters.md are
written from these tables (`python tools/docs/node_parameters.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from irec_calibration.cell import Cell
from irec_calibration.model.plausibility import LARGEST_OFFSET
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad
from irec_ros.parameters import P, Parameters

from ..conditioning import Cable, FilterSettings, make_filters
from ..correction import CorrectionSettings
from ..errors import SettingsError
from ..fir import read_taps
from ..limits import Bounds, OffsetLimits
from ..link_angles import LinkAngles, read_dry_drive
from ..links import LATE, Links
from ..preview import ForceProfile, Preview, read_profile
from ..state import StateTimes
from ..watchdog import RailRange, WatchdogSettings

ANY_RAIL = 100.0  # m

CORRECTION = (
    P("cell", "", "cell file (irec-cell/1): robot, serial, sensor; empty: robot_description and robot_serial"),
    P("robot_serial", "", "serial of the robot, checked against the model; empty: from the cell file"),
    P("tool", "", "name of the mounted tool; empty: that of the cell file. A model of another one, or of none, is refused"),
    P("model_path", "", "model.yaml to be put in force when configuring; empty: wait for activate_model"),
    P("calibrations", "", "calibrations beside the cell file, to take the one in force; empty: not looked for"),
    P("autostart", False, "configure without a lifecycle manager; activate with a model of model_path or activate_model"),
    P("rate", 250.0, "ticks of the correction", 50.0, 1000.0, unit="Hz"),
    P("rail_joint", "ext_rail", "name of the external axis in joint_states"),
    P("gravity", [0.0, 0.0, -9.81], "free fall in base_link", unit="m/s^2"),
    P("output", "offset", "offset: irec/offset; joint_offset: irec/joint_offset, for each joint; both"),
    P("offset_frame", "base_link", "frame of the offset: base_link or tool0"),
    P("with_rotation", False, "correct the orientation of the tool too"),
    P("lead", 0.0, "extrapolate the offset by this measured delay", 0.0, 0.1, unit="s"),
    P("lead_smoothing", 0.02, "time constant of the rate that is extrapolated", 0.001, 1.0, unit="s"),
    P("lead_limit", 2e-4, "largest extrapolation", 0.0, 0.01, unit="m and rad"),
    P("need_envelope", True, "refuse a model that does not say in which range it was identified"),
    P("raw_wrench", False, "take wrench_raw in sensor_frame and remove bias, tool weight and cable here"),
    P("sensor_frame", "ft_sensor", "link in which wrench_raw is measured"),
    P("tool_load.mass", 0.0, "mass behind the sensor", 0.0, 2000.0, unit="kg"),
    P("tool_load.com", [0.0, 0.0, 0.0], "its centre of mass in sensor_frame", unit="m"),
    P("tool_load.bias_force", [0.0, 0.0, 0.0], "reading without load", unit="N"),
    P("tool_load.bias_torque", [0.0, 0.0, 0.0], "reading without load", unit="N m"),
    P("tool_load.alignment", [0.0, 0.0, 0.0], "rotation vector from sensor_frame to the true sensor", unit="rad"),
    P("cable.force", [0.0, 0.0, 0.0], "pull of hoses on the tool in base_link", unit="N"),
    P("cable.point", [0.0, 0.0, 0.0], "where they pull in sensor_frame", unit="m"),
    P("wrench_rate", 250.0, "rate of the wrench, for which the filters are designed", 50.0, 8000.0, unit="Hz"),
    P("filter.median", 0, "samples of the median against spikes, odd; 0: none", 0, 15),
    P("filter.spindle_speed", 0.0, "revolutions per second (rpm / 60) for the notches; 0: none", 0.0, 1000.0, unit="1/s"),
    P("filter.harmonics", 2, "notches at harmonics of the spindle", 1, 5),
    P("filter.notch_quality", 5.0, "frequency / bandwidth of a notch", 0.5, 100.0),
    P("filter.cutoff", 40.0, "low-pass; 0: none", 0.0, 4000.0, unit="Hz"),
    P("filter.order", 2, "order of the low-pass", 1, 6),
    P("filter.taps", [1.0], "designed filter in place of the low-pass, newest sample first; [1.0]: none", -50.0, 50.0),
    P("filter.file", "", "table of a designed filter in place of filter.taps: force_x, force_y, force_z; empty: none"),
    P("preview.file", "", "table of the force that is known along this course: stamp, joint angles, force; empty: none"),
    P("preview.lead", 0.0, "from a reading to the motion that it causes (irec latency)", 0.0, 0.2, unit="s"),
    P("preview.slack", 0.0, "by which the force may come sooner or later than in the table (irec profile)", 0.0, 0.2, unit="s"),
    P("process_feed", 0.07, "feed by which the log tells what the filters' delay costs", 0.0, 5.0, unit="m/s"),
    P("deflection_slope", 1e-3, "change of the deflection per metre of path, likewise", 0.0, 1.0, unit="m/m"),
    P("limit.translation", 3e-3, "largest offset", 1e-5, 0.02, unit="m", settable=True),
    P("limit.translation_rate", 0.02, "fastest change of the offset", 1e-4, 0.5, unit="m/s", settable=True),
    P("limit.translation_acceleration", 0.5, "largest acceleration of the offset", 1e-3, 50.0, unit="m/s^2", settable=True),
    P("limit.rotation", 5e-3, "largest rotation of the offset", 1e-5, 0.05, unit="rad", settable=True),
    P("limit.rotation_rate", 0.05, "fastest change of the offset's rotation", 1e-4, 1.0, unit="rad/s", settable=True),
    P("limit.rotation_acceleration", 2.0, "largest acceleration of the offset's rotation", 1e-3, 100.0, "rad/s^2", settable=True),
    P("predicted_limit", LARGEST_OFFSET, "largest deflection that a model may predict within its envelope", 1e-4, 0.5, unit="m"),
    P("start_load", 0.15, "share of the model's largest force with which the correction may begin: more is a contact", 0.0, 10.0),
    P("time.ramp_in", 0.5, "from the present offset to the model's", 0.0, 60.0, unit="s"),
    P("time.hold", 0.25, "the last offset is held while an input is missing", 0.0, 10.0, unit="s"),
    P("time.fade", 1.0, "from the held offset to zero", 0.0, 60.0, unit="s"),
    P("time.recover", 0.05, "an input must be sound for this long before the correction comes back", 0.0, 10.0, unit="s"),
    P("watch.wrench_timeout", 0.02, "longest time without a wrench", 0.001, 5.0, unit="s"),
    P("watch.joints_timeout", 0.05, "longest time without joint states", 0.001, 5.0, unit="s"),
    P("watch.frozen_after", 0.1, "longest time with one reading repeated to the last bit", 0.01, 60.0, unit="s"),
    P("watch.force_jump", 400.0, "between two samples", 1.0, 1e5, unit="N"),
    P("watch.torque_jump", 100.0, "between two samples", 0.1, 1e5, unit="N m"),
    P("watch.jump_samples", 3, "samples after which a jump that stays is believed", 2, 1000),
    P("watch.joint_speed_factor", 1.5, "times the velocity limit: a faster joint is not believed", 1.0, 100.0),
    P("watch.joint_jump", 0.01, "allowed on top of that (of the rail: m)", 0.0, 1.0, unit="rad"),
    P("watch.rail_speed", 5.0, "fastest the rail can be: a faster one is not believed", 1e-3, 20.0, unit="m/s"),
    P("watch.rail_margin", 0.1, "margin beyond the range of the rail in the cell file", 0.0, 10.0, unit="m"),
    P("watch.clock_tolerance", 0.5, "largest distance of a stamp from now: beyond, the clocks differ", 0.001, 60.0, unit="s"),
    P("watch.age_limit", 0.15, "an input that is older when it comes in is stale; of simulated time: any", 0.01, 60.0, unit="s"),
    P("watch.force_range", 1e5, "range of the sensor, any axis", 1.0, 1e6, unit="N"),
    P("watch.torque_range", 1e5, "range of the sensor, any axis", 1.0, 1e6, unit="N m"),
    P("watch.joint_margin", 0.2, "margin beyond the joint angles of the model", 0.0, 7.0, unit="rad"),
    P("watch.wrench_factor", 1.3, "times the largest wrench of the model", 1.0, 10.0),
    P("watch.torque_margin", 100.0, "margin on top of it", 0.0, 1e5, unit="N m"),
)

# what correction_node has beyond the table above; rsi_bridge can't take them
LINKS = (
    P("links.topic", "", "joint states behind the gears (secondary encoders); empty: none. The model is one of what lies beyond"),
    P("links.file", "", "table of the course without process (irec links); empty: the windup at the start is taken off"),
    P("links.rate", 250.0, "rate of these messages, for which their low-pass is designed", 10.0, 8000.0, unit="Hz"),
    P("links.cutoff", 3.0, "low-pass of the windup, well below the lowest mode of the arm; 0: none", 0.0, 4000.0, unit="Hz"),
    P("links.timeout", LATE, "longest time without a windup that can be believed", 0.001, 5.0, unit="s"),
)

# what rsi_bridge has beyond CORRECTION; the rate is that of RSI
RSI = (
    P("autostart", True, "configure, and activate as soon as there is a model; false: wait for the lifecycle services"),
    P("address", "127.0.0.1", "address of this machine on the robot's network"),
    P("port", 59152, "UDP port that the controller sends to", 0, 65535),
    P("peer", "127.0.0.1", "address of the controller; packets of others are dropped"),
    P("sentype", "IREC", "SENTYPE of the controller's ethernet XML"),
    P("cycle_ms", 4, "4 (IPO_FAST) or 12 (IPO)", 4, 12, unit="ms"),
    P("source", "chain", "chain: compute the offset in the loop's process; offset_topic: follow irec/offset"),
    P("wrench_block", "", "chain: shared memory that can_ft_node writes; empty: the topic wrench or wrench_raw"),
    P("offset_timeout", 0.05, "offset_topic: longest time without an offset", 0.001, 5.0, unit="s"),
    P("realtime_priority", 0, "SCHED_FIFO priority of the loop, 0: none", 0, 99),
    P("realtime_processor", -1, "processor that the loop stays on (isolcpus=), from 0; -1: any", -1, 1023),
)

CAN_FT = (
    P("autostart", True, "configure and activate at once; false: wait for the lifecycle services"),
    P("interface", "socketcan", "python-can interface: socketcan, slcan, virtual, ..."),
    P("channel", "can0", "channel of it: can0, /dev/ttyUSB0, ..."),
    P("bitrate", 1_000_000, "speed of the bus", 10_000, 8_000_000, unit="bit/s"),
    P("base_id", 0x40, "base identifier of the sensor (DIP switches)", 0, 0x7F9),
    P("rate", 250.0, "readings per second", 1.0, 2000.0, unit="Hz"),
    P("short_answers", False, "answers of 16 bits (two frames) in place of 32 bits (four frames)"),
    P("sensor_rate", 7000.0, "samples per second by which the sensor's counter goes on", 1.0, 1e6, unit="Hz"),
    P("counts_per_force", 1e6, "counts per unit of force, from the sensor's calibration page (cfgcpf)", 1e-3, 1e12),
    P("counts_per_torque", 1e6, "counts per unit of torque (cfgcpt)", 1e-3, 1e12),
    P("to_newton", 1.0, "newtons per unit of force: 1, or 4.4482216 for lbf", 1e-6, 1e6, unit="N"),
    P("to_newton_metre", 1.0, "N m per unit of torque: 1, or 0.11298483 for lbf in", 1e-6, 1e6, unit="N m"),
    P("short_scale", [1.0] * 6, "counts of the long answer per count of the short one, Fx Fy Fz Tx Ty Tz", 1e-6, 1e6),
    P("frame_id", "ft_sensor", "frame of the readings"),
    P("block", "irec_wrench", "name of the shared memory that rsi_bridge can read (wrench_block)"),
    P("realtime_priority", 0, "SCHED_FIFO priority of the reading process, 0: none", 0, 99),
)


def offset_limits(v: Parameters) -> OffsetLimits:
    """Limits of the offset."""
    return OffsetLimits(*(
        Bounds(v[f"limit.{part}"], v[f"limit.{part}_rate"], v[f"limit.{part}_acceleration"])
        for part in ("translation", "rotation")
    ))  # fmt: skip


def offset_frame(v: Parameters) -> str:
    """base_link or tool0. Raises SettingsError."""
    frame = str(v["offset_frame"])
    if frame not in ("base_link", "tool0"):
        raise SettingsError(f"parameter 'offset_frame' is '{frame}'; base_link or tool0 is possible")
    return frame


def outputs(v: Parameters) -> tuple[bool, bool]:
    """Whether irec/offset and irec/joint_offset are sent. Raises SettingsError."""
    output = str(v["output"])
    if output not in ("offset", "joint_offset", "both"):
        raise SettingsError(f"parameter 'output' is '{output}'; offset, joint_offset or both is possible")
    return output != "joint_offset", output != "offset"


def rail_range(cell: Cell | None) -> RailRange | None:
    """Where the rail of a cell can be; of a robot without a cell file nobody knows, but no rail is longer than ANY_RAIL."""
    if cell is None:
        return RailRange(-ANY_RAIL, ANY_RAIL)
    return None if cell.rail is None else RailRange(float(cell.rail.lower), float(cell.rail.upper))


def correction_settings(v: Parameters, wrench_frame: str) -> CorrectionSettings:
    """Settings of the chain. Raises SettingsError."""
    watch = {f: v[f"watch.{f}"] for f in WatchdogSettings.__dataclass_fields__ if f != "wrench_frame"}
    return CorrectionSettings(
        period=1.0 / v["rate"],
        with_rotation=v["with_rotation"],
        lead=v["lead"],
        lead_smoothing=v["lead_smoothing"],
        lead_limit=v["lead_limit"],
        need_envelope=v["need_envelope"],
        start_load=v["start_load"],
        limits=offset_limits(v),
        times=StateTimes(**{f: v[f"time.{f}"] for f in StateTimes.__dataclass_fields__}),
        watchdog=WatchdogSettings(wrench_frame=wrench_frame, **watch),
    )


def filter_settings(v: Parameters, joint_names: Sequence[str]) -> FilterSettings:
    """Settings of the filters. Raises SettingsError."""
    fields = ("median", "spindle_speed", "harmonics", "notch_quality", "cutoff", "order", "taps")
    settings = FilterSettings(rate=v["wrench_rate"], **{f: v[f"filter.{f}"] for f in fields})
    if not v["filter.file"]:
        return settings
    if settings.designed:
        raise SettingsError("filter.file and filter.taps are both given; one of them is possible")
    table = read_taps(v["filter.file"], joint_names)
    return replace(settings, posture_taps=table.taps.tolist(), postures=table.postures.tolist())


def profile(v: Parameters, robot: Robot) -> ForceProfile | None:
    """The known force of a course. Raises SettingsError."""
    return read_profile(v["preview.file"], robot.joint_names) if v["preview.file"] else None


def preview(v: Parameters, robot: Robot) -> Preview | None:
    """The same with filters of its own as the wrench passes. Raises SettingsError."""
    known = profile(v, robot)
    if known is None:
        return None
    return Preview(known, v["preview.lead"], make_filters(filter_settings(v, robot.joint_names)), slack=v["preview.slack"])


def links(v: Parameters, robot: Robot) -> tuple[Links, LinkAngles] | None:
    """Secondary encoders, and what pairs their angles with those of the motors; None without them. Raises SettingsError."""
    if not v["links.topic"]:
        if v["links.file"]:
            raise SettingsError("links.file is given without links.topic; name the topic of the link-side joint states")
        return None
    if v["links.topic"] == "joint_states":
        raise SettingsError("links.topic is joint_states, which holds the motor-side angles")
    dry = read_dry_drive(v["links.file"], robot.joint_names) if v["links.file"] else None
    filters = make_filters(FilterSettings(rate=v["links.rate"], cutoff=v["links.cutoff"]))
    windup = Links(robot, filters, late=v["links.timeout"], zeroed=dry is None)
    return windup, LinkAngles(robot.n_joints, v["watch.clock_tolerance"], dry)


def tool_load(v: Parameters) -> ToolLoad:
    """What is taken off the raw wrench. Raises SettingsError."""
    return ToolLoad(v["tool_load.mass"], *(v.three(f"tool_load.{f}") for f in ("com", "bias_force", "bias_torque", "alignment")))


def cable(v: Parameters) -> Cable:
    """Pull of hoses. Raises SettingsError."""
    return Cable(v.three("cable.force"), v.three("cable.point"))
