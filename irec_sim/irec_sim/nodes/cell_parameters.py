# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated cell, and what is made from them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from irec_ros.parameters import P, Parameters

from ..cell import PERIOD, Cell
from ..cellfile import read_cell
from ..instruments import InstrumentSettings
from ..lease import LONGEST, LeaseSettings
from ..truth import make_truth, read_truth

RATES = {  # Hz of simulated time
    "clock": 100.0,
    "joint_states": 100.0,
    "tcp_pose": 100.0,
    "wrench": 250.0,
    "wrench_raw": 250.0,
    "tracker": 100.0,
    "temperature": 1.0,
    "state": 10.0,
    "diagnostics": 1.0,
}
LEASE = LeaseSettings()


def _instrument_defaults() -> tuple[P, ...]:
    return tuple(
        P(f"instruments.{f.name}", list(f.default) if isinstance(f.default, tuple) else f.default, "see irec_sim/instruments.py")
        for f in fields(InstrumentSettings)
    )


PARAMETERS = (
    P("cell", "afp", "cell file, or its name in config/cells"),
    P("truth", "", "truth file with hidden physics; empty: elastic with mild friction"),
    P("truth_seed", 0, "draws the compliances and what a truth file leaves open"),
    P("seed", 1, "of all noise"),
    P("speed_factor", 1.0, "simulated seconds per real second", 1e-3, 999.0, settable=True),
    P("period", PERIOD, "of a step; no topic comes more often; light robots need the default under force", 1e-3, 0.02, "s"),
    P("max_lead", 0.25, "simulated time that the cell may be ahead of its slowest follower", 1e-3, 100.0, "s"),
    P("rail_speed", 1.0, "velocity limit of the rail", 1e-3, 100.0, "m/s"),
    P("force_lease", LEASE.hold, "a force set point holds for so long unless it comes again; 0: for ever", 0.0, LONGEST, "s"),
    P("retract_distance", LEASE.distance, "way back along the tool after a set point has run out", 1e-3, 0.5, "m"),
    *(P(f"rate.{name}", rate, f"publications of {name} per simulated second; 0: never", 0.0, 250.0, "Hz")
      for name, rate in RATES.items()),
    *_instrument_defaults(),
)  # fmt: skip


def instruments_of(p: Parameters) -> InstrumentSettings:
    """Noise, delays and drop-outs."""
    given: dict[str, Any] = {f.name: p[f"instruments.{f.name}"] for f in fields(InstrumentSettings)}
    given["force_bias"] = tuple(given["force_bias"])
    return InstrumentSettings(**given)


def lease_of(p: Parameters) -> LeaseSettings:
    """The dead man's switch."""
    return LeaseSettings(hold=p["force_lease"], distance=p["retract_distance"])


def cell_of(p: Parameters, instruments: InstrumentSettings) -> Cell:
    """The cell with its hidden physics. SimError: a file is missing or wrong."""
    file = read_cell(p["cell"])
    effort, seed = file.chain.effort, p["truth_seed"]
    truth = read_truth(p["truth"], file.name, seed, effort) if p["truth"] else make_truth(file.name, [], seed, effort=effort)
    return Cell(file, truth, p["seed"], instruments, p["period"])
