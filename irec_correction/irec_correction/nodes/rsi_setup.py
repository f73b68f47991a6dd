# SPDX-License-Identifier: Apache-2.0
"""What the loop of the RSI bridge is told at its beginning, from the parameters of the node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from irec_calibration.cell import Cell
from irec_ros.parameters import Parameters

from ..conditioning import FilterSettings
from ..errors import SettingsError
from ..rsi.bridge import BridgeSetup
from ..rsi.loop import Link
from ..rsi.sources import ChainSettings
from . import parameters
from .rsi_inputs import RsiInputs

SOURCES = ("chain", "offset_topic")
CYCLES = {4: "IPO_FAST", 12: "IPO"}  # ms


def bridge_setup(
    p: Parameters, cell: Cell, report: str, latency: str, inputs: RsiInputs, inform: Callable[[str], None]
) -> BridgeSetup:
    """The setup.

    Args:
        report, latency: names of the blocks that the loop writes to.
        inputs: whose blocks it reads.
        inform: takes what is worth a line in the log.

    Raises:
        SettingsError: parameters that do not go together.
    """
    source, cycle_ms = str(p["source"]), int(p["cycle_ms"])
    if source not in SOURCES:
        raise SettingsError(f"parameter 'source' is '{source}'; {' or '.join(SOURCES)} is possible")
    if cycle_ms not in CYCLES:
        possible = " or ".join(f"{ms} ({name})" for ms, name in CYCLES.items())
        raise SettingsError(f"parameter 'cycle_ms' is {cycle_ms}; {possible} is possible")
    frame = str(p["sensor_frame"]) if p["raw_wrench"] else "tool0"
    settings = replace(parameters.correction_settings(p, frame), period=1e-3 * cycle_ms)  # 'rate' is that of correction_node
    filters = _filters(p, cell.robot.joint_names, 1e3 / cycle_ms, inform)
    chain = None
    if source == "chain":
        chain = ChainSettings(
            correction=settings,
            filters=filters,
            urdf_text=cell.robot.urdf_text,
            wrench_block=str(p["wrench_block"]) or inputs.wrench.name,
            raw=bool(p["raw_wrench"]),
            sensor_frame=str(p["sensor_frame"]),
            load=parameters.tool_load(p),
            cable=parameters.cable(p),
            gravity=p.three("gravity"),
            payload=cell.payload,
            profile=parameters.profile(p, cell.robot),
            preview_lead=p["preview.lead"],
            preview_slack=p["preview.slack"],
            rail=parameters.rail_range(cell),
        )
    link = Link(str(p["address"]), int(p["port"]), str(p["peer"]), str(p["sentype"]))
    return BridgeSetup(
        link, settings, report, latency, chain, inputs.offset.name, float(p["offset_timeout"]), cycle_ms,
        int(p["realtime_priority"]), int(p["realtime_processor"]),
    )  # fmt: skip


def _filters(p: Parameters, joint_names: Sequence[str], rate: float, inform: Callable[[str], None]) -> FilterSettings:
    """Filters for the readings that RSI lets through: one per cycle, the newest."""
    filters = parameters.filter_settings(p, joint_names)
    if filters.rate <= rate:
        return filters
    inform(f"filters act at {rate:g} Hz, the rate of RSI, not at wrench_rate {filters.rate:g} Hz")
    if filters.designed:
        raise SettingsError(
            f"the designed filter is for wrench_rate {filters.rate:g} Hz; RSI passes {rate:g} readings a second:"
            " design the filter for that rate and set wrench_rate to it"
        )
    return replace(filters, rate=rate)
