# SPDX-License-Identifier: Apache-2.0
"""The `irec` commands as services use them: run in a process of their own, their JSON put into plain words."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from ..errors import IrecError
from ..lengths import length

STATUSES = ("adequate", "missing_effect", "unexplained")
Answer = tuple[str, list[str], float, str]  # status, effects, cross-validated RMS in m, plain words


def _compared(found: dict[str, Any]) -> Answer:
    rms, floor = float(found["rms_m"]), float(found["noise_floor_m"])
    words = f"The model leaves {length(rms)}; the instruments' noise is {length(floor)}."
    return "not_evaluated", [], float("nan"), words


def diagnosed(found: dict[str, Any]) -> Answer:
    verdict = found["verdict"]
    status = str(verdict["status"])
    return (
        status if status in STATUSES else "not_evaluated", [str(e) for e in verdict.get("effects", [])],
        float(found["model"]["cv_rms_m"]), str(verdict["text"]),
    )  # fmt: skip


def _added(found: dict[str, Any]) -> Answer:
    before, after = float(found["cv_rms_before_m"]), float(found["cv_rms_after_m"])
    p_value = float(found["p_value"])
    words = f"Error on held-out poses {length(before)} before, {length(after)} after (p = {p_value:.2g})."
    return "not_evaluated", [str(e) for e in found["effects"]], after, words


def _improved(found: dict[str, Any]) -> Answer:
    last = found["steps"][-1]
    added = [str(step["added"]) for step in found["steps"] if step["added"]]
    words = f"Added: {', '.join(added) or 'nothing'}; {found['stopped']}. Held-out poses {1e6 * float(last['cv_rms_m']):.1f} um."
    return "not_evaluated", added, float(last["cv_rms_m"]), words


READERS: dict[str, Callable[[dict[str, Any]], Answer]] = {
    "compare": _compared, "diagnose": diagnosed, "add": _added, "improve": _improved,
}  # fmt: skip


def arguments_of(command: str, session: str, model: str, effect: str, output: str) -> list[str]:
    """Command line of an analysis, as a user would type it."""
    if command == "add":
        if not effect or not model:
            raise IrecError("add needs the id of an effect and a model; see `irec effects`")
        return ["add", model, effect, session, "--json", "-o", f"{output}.yaml"]
    if command == "compare":
        if not model:
            raise IrecError("compare needs a model; none is in force, give model_path")
        return ["compare", model, session, "--json", "-o", output]
    return [command, session, *(["--model", model] if model else []), "--json", "-o", output]


def run_command(arguments: list[str]) -> dict[str, Any]:
    """Run one `irec` command in a process of its own; its JSON. IrecError with its message where it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "irec_calibration.cli", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1) or not done.stdout.strip():
        lines = done.stderr.strip().splitlines()
        raise IrecError(lines[-1] if lines else f"irec {arguments[0]} ended with code {done.returncode}")
    try:
        found = json.loads(done.stdout)
    except json.JSONDecodeError as error:
        raise IrecError(f"irec {arguments[0]} did not answer in JSON: {error}") from error
    return found if isinstance(found, dict) else {"result": found}
