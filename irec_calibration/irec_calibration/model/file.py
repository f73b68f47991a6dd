# SPDX-License-Identifier: Apache-2.0
"""`model.yaml` (irec-model/1): write, read, check against a robot. Data only: reading never runs code not installed."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from ..effects import find_effect
from ..effects.formula import FormulaEffect
from ..errors import EffectError, IrecError, ModelError
from ..files import Document, check_replaceable, open_document, read_bytes, read_document, write_file
from ..files.outputs import of_format
from ..robot import Robot
from .model import Combination, Envelope, Model
from .term import Estimate, Term

FORMAT = "irec-model/1"


def save_model(model: Model, path: str | Path) -> Path:
    """Write a model; an existing one is replaced in one step.

    Raises:
        ModelError: it can't be written, and nothing is left then; or what is there is no model, and stays.
    """
    path = check_model_target(path)
    data: dict[str, Any] = {
        "format": FORMAT,
        "robot": {"serial": model.serial, "urdf": model.urdf, "urdf_sha256": model.urdf_sha256, "tool": model.tool},
        "made": model.made,
        "figures": {k: _plain(v) for k, v in model.figures.items()},
        "effects": [
            {"effect": t.effect.id, "parameters": {name: _entry(e) for name, e in t.estimates.items()}} for t in model.terms
        ],
        "known_only_in_combination": [{"sum_of": c.weights, "value": c.value, "se": _plain(c.se)} for c in model.combinations],
    }
    for item, term in zip(data["effects"], model.terms, strict=True):
        if isinstance(term.effect, FormulaEffect):
            item["formula"] = term.effect.formula
    if model.envelope is not None:
        data["envelope"] = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(model.envelope).items()}
    data["values_sha256"] = _values_sha256(data)
    if model.history:
        data["history"] = list(model.history)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    return write_file(path, text, "the model", ModelError)


def check_model_target(path: str | Path) -> Path:
    """The path of a model that may be written. ModelError: what is there is something else."""
    return check_replaceable(path, "a model", (of_format(FORMAT),), ModelError)


def _values_sha256(data: Any) -> str:
    """Of what a correction follows: effects with their parameters, and the envelope. Name and note may be written by hand. Empty
    where they have keys that are no words, as no model that was saved has."""
    values = {key: data.get(key) for key in ("effects", "envelope")}
    try:
        text = json.dumps(values, sort_keys=True, default=str)
    except TypeError:
        return ""
    return hashlib.sha256(text.encode()).hexdigest()


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
        ModelError: what is wrong, with file, line and key.
        EffectError: an effect is not installed.
    """
    document = read_document(path, FORMAT, "model", ModelError, rules=(_consistent,))
    data = document.data
    robot = data.get("robot") or {}
    envelope = None
    if data.get("envelope"):
        e = data["envelope"]
        envelope = Envelope(
            tuple(map(float, e["q_lower"])), tuple(map(float, e["q_upper"])), float(e["force"]), float(e["torque"])
        )
    return Model(
        terms=tuple(_term(item, f"{path}: effects[{i}]") for i, item in enumerate(data["effects"])),
        serial=robot.get("serial", ""),
        urdf=robot.get("urdf", ""),
        urdf_sha256=robot.get("urdf_sha256", ""),
        tool=robot.get("tool", ""),
        envelope=envelope,
        made=data.get("made") or {},
        figures=data.get("figures") or {},
        combinations=tuple(
            Combination({str(n): float(w) for n, w in c["sum_of"].items()}, float(c["value"]), _or_nan(c.get("se")))
            for c in data.get("known_only_in_combination") or ()
        ),
        history=tuple(data.get("history") or ()),
        edited=bool(data.get("values_sha256")) and data["values_sha256"] != _values_sha256(data),
    )


def model_problems(path: str | Path) -> list[str]:
    """Everything that is wrong in a model file, one line each: structure, effects, formulas and names of parameters.

    Raises ModelError: not a model file at all.
    """
    document = open_document(path, FORMAT, "model", ModelError, rules=(_consistent,))
    for i, item in enumerate(document.data["effects"] if document.sound("effects") else ()):
        try:
            _term(item, "")
        except IrecError as error:
            document.wrong(("effects", i), str(error).removeprefix(": "))
    return [str(p) for p in document.problems]


def _consistent(document: Document) -> None:
    """Values within their bounds, an envelope with as many lower as upper ends."""
    if document.sound("effects"):
        for i, item in enumerate(document.data["effects"]):
            for name, entry in (item.get("parameters") or {}).items():
                if isinstance(entry, dict):
                    value, low, high = entry["value"], entry.get("lower", -math.inf), entry.get("upper", math.inf)
                    if not low - 1e-15 <= value <= high + 1e-15:
                        place = ("effects", i, "parameters", str(name), "value")
                        document.wrong(place, f"is {value:g}, outside its bounds {low:g} .. {high:g}")
    if document.sound("envelope") and document.data["envelope"]:
        e = document.data["envelope"]
        if len(e["q_lower"]) != len(e["q_upper"]):
            document.wrong(("envelope", "q_upper"), f"has {len(e['q_upper'])} values, q_lower has {len(e['q_lower'])}")
        elif any(low > high for low, high in zip(e["q_lower"], e["q_upper"], strict=True)):
            document.wrong(("envelope", "q_upper"), "is below q_lower for some joint")


def _term(item: dict[str, Any], where: str) -> Term:
    formula = item.get("formula")
    try:
        effect = find_effect(item["effect"]) if formula is None else FormulaEffect(item["effect"], formula)
    except EffectError as error:
        raise EffectError(f"{where}: {error}") from error
    estimates = {}
    for name, entry in (item.get("parameters") or {}).items():
        entry = entry if isinstance(entry, dict) else {"value": entry}
        estimates[str(name)] = Estimate(
            float(entry["value"]),
            _or_nan(entry.get("se")),
            entry.get("unit", ""),
            float(entry.get("lower", -math.inf)),
            float(entry.get("upper", math.inf)),
            entry.get("identified", True),
        )
    return Term(effect, estimates)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file, by which nodes name the model in force."""
    return hashlib.sha256(read_bytes(path, "model", ModelError)).hexdigest()


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
