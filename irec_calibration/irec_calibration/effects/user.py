# SPDX-License-Identifier: Apache-2.0
"""Effects of users: a class in a file named on the command line, or a formula typed there."""

from __future__ import annotations

import importlib.util
import inspect
import re
from pathlib import Path

from ..errors import EffectError
from . import find_effect, register
from .base import Effect
from .formula import FormulaEffect


def register_file(path: str | Path) -> list[Effect]:
    """Run a Python file that the user named and register each effect class that it defines.

    Raises:
        EffectError: the file can't be run, defines no effect, or one of them is badly defined.
    """
    path = Path(path)
    spec = importlib.util.spec_from_file_location(f"irec_user_effects_{path.stem}", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise EffectError(f"{path}: no Python file with effects there")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file raises must name that file
        raise EffectError(f"{path}: {type(error).__name__}: {error}") from error
    classes = [
        c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, Effect) and c.__module__ == module.__name__
    ]
    if not classes:
        raise EffectError(f"{path}: no class in it is an Effect (from irec_calibration.effects import Effect)")
    effects = []
    for cls in classes:
        missing = [a for a in ("id", "label", "physics") if not isinstance(getattr(cls, a, None), str)]
        if missing:
            raise EffectError(f"{path}: class {cls.__name__}: {', '.join(missing)} must be given as text")
        try:
            effect = cls()
        except TypeError as error:
            raise EffectError(f"{path}: class {cls.__name__}: {error}") from error
        register(effect, str(path.resolve()))
        effects.append(effect)
    return effects


def effect_from_text(text: str) -> Effect:
    """An effect as typed on a command line: its id, `TARGET: EXPRESSION`, or `name = TARGET: EXPRESSION`.

    Raises:
        EffectError: unknown id or a formula that can't be read.
    """
    if ":" not in text:
        return find_effect(text.strip())
    named = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*=\s*(.+)", text)
    name, formula = (named[1], named[2]) if named else ("formula_" + re.sub(r"\W+", "_", text.partition(":")[0].strip()), text)
    effect = FormulaEffect(name, formula.strip())
    register(effect)
    return effect
