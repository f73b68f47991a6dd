# SPDX-License-Identifier: Apache-2.0
"""`model.yaml` (irec-model/1): write, read, check against a robot. Data only: reading never runs code not installed."""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from .effects import find_effect
from .effects.formula import FormulaEffect
from .errors import EffectError, ModelError
from .model import Combination, Envelope, Estimate, Model, Term
from .robot import Robot

FORMAT = "irec-model/1"


def save_model(model: Model, path: str | Path) -> Path:
    """Write a model; an existing file is replaced in one step."""
    path = Path(path)
    data: dict[str, Any] = {
        "format": FORMAT,
        "robot": {"serial": model.serial, "urdf": model.urdf, "urdf_sha256": model.urdf_sha256, "tool": model.tool},
        "made": model.made,
        "figures": {k: _plain(v) for k, v in model.figures.items()},
        "effects": [
            {"effect": t.effect.id, "parameters": {name: _entry(e) for name, e in t.estimates.items()}} for t in model.terms
        ],
        "known_only_in_combination": [{"sum_of": c.weights, "value": c.value, "se": c.se} for c in model.combinations],
    }
    for item, term in zip(data["effects"], model.terms, strict=True):
        if isinstance(term.effect, FormulaEffect):
            item["formula"] = term.effect.formula
    if model.envelope is not None:
        data["envelope"] = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(model.envelope).items()}
    if model.history:
        data["history"] = list(model.history)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")
    os.replace(part, path)
    return path


def _entry(e: Estimate) -> dict[str, Any]:
    out: dict[str, Any] = {"value": float(e.value), "unit": e.unit}
    if math.isfinite(e.se):
        out["se"] = float(e.se)
    if math.isfinite(e.lower):
        out["lower"] = float(e.lower)
    if math.isfinite(e.upper):
        out["upper"] = float(e.upper)
    out["identified"] = bool(e.identified)
    return out


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def load_model(path: str | Path) -> Model:
    """Read a model file.

    Raises:
        ModelError: what is wrong, with file and field.
        EffectError: an effect is not installed.
    """
    path = Path(path)
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ModelError(f"{path}: can't read the model: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise ModelError(f"{path}: format is {found!r}, this program reads {FORMAT}")
    robot = data.get("robot") or {}
    terms = data.get("effects")
    if not isinstance(terms, list) or not terms:
        raise ModelError(f"{path}: 'effects' must list at least one effect")
    envelope = None
    if data.get("envelope"):
        e = data["envelope"]
        try:
            envelope = Envelope(
                tuple(map(float, e["q_lower"])), tuple(map(float, e["q_upper"])), float(e["force"]), float(e["torque"])
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"{path}: envelope: {error!r} is missing or not a number") from error
    return Model(
        terms=tuple(_term(item, f"{path}: effects[{i}]") for i, item in enumerate(terms)),
        serial=str(robot.get("serial", "")),
        urdf=str(robot.get("urdf", "")),
        urdf_sha256=str(robot.get("urdf_sha256", "")),
        tool=str(robot.get("tool", "")),
        envelope=envelope,
        made=data.get("made") or {},
        figures=data.get("figures") or {},
        combinations=tuple(
            Combination({str(n): float(w) for n, w in c["sum_of"].items()}, float(c["value"]), float(c["se"]))
            for c in data.get("known_only_in_combination") or ()
        ),
        history=tuple(data.get("history") or ()),
    )


def _term(item: Any, where: str) -> Term:
    if not isinstance(item, dict) or not isinstance(item.get("effect"), str):
        raise ModelError(f"{where}: 'effect' must name an effect")
    try:
        formula = item.get("formula")
        effect = find_effect(item["effect"]) if formula is None else FormulaEffect(item["effect"], str(formula))
    except EffectError as error:
        raise EffectError(f"{where}: {error}") from error
    estimates = {}
    for name, entry in (item.get("parameters") or {}).items():
        place = f"{where} ({item['effect']}): parameters: {name}"
        entry = entry if isinstance(entry, dict) else {"value": entry}
        value = _number(entry.get("value"), f"{place}: value")
        lower = _number(entry.get("lower", -math.inf), f"{place}: lower")
        upper = _number(entry.get("upper", math.inf), f"{place}: upper")
        if not math.isfinite(value):
            raise ModelError(f"{place}: value is {value}, a finite number is needed")
        if not lower - 1e-15 <= value <= upper + 1e-15:
            raise ModelError(f"{place}: value {value:g} is outside its bounds {lower:g} .. {upper:g}")
        se = _number(entry.get("se", math.nan), f"{place}: se")
        estimates[str(name)] = Estimate(value, se, str(entry.get("unit", "")), lower, upper, bool(entry.get("identified", True)))
    return Term(effect, estimates)


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ModelError(f"{place} is {value!r}, a number is needed")
    try:
        return float(value)
    except ValueError:
        raise ModelError(f"{place} is {value!r}, a number is needed") from None


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file, by which nodes name the model in force."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def check_belongs(model: Model, robot: Robot, serial: str, what: str = "the session") -> None:
    """Refuse a model of another robot.

    Raises:
        ModelError: serial or robot description differ, with both values.
    """
    if model.serial and serial and model.serial != serial:
        raise ModelError(f"the model belongs to robot '{model.serial}', {what} to '{serial}'; identify a model for this robot")
    if model.urdf_sha256 and model.urdf_sha256 != robot.sha256:
        raise ModelError(
            f"the model was identified with another robot description (SHA-256 {model.urdf_sha256[:12]}.., {what} has"
            f" {robot.sha256[:12]}..); use the same URDF or identify again"
        )
