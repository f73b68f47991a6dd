# SPDX-License-Identifier: Apache-2.0
"""Help while a formula is typed: completion, what is wrong and where, and which names are parameters.

A name that is no variable is a parameter only where somebody says so: `taw` is more likely a typing error than a new quantity.
Single letters (c, k2, c_1) are taken for parameters without asking.
"""

from __future__ import annotations

import ast
import difflib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ..effects.formula import CONSTANTS, FUNCTIONS, VARIABLES, FormulaEffect
from ..errors import EffectError

TARGETS = ("axis ", "link ", "tool x: ", "tool y: ", "tool z: ", "base x: ", "base y: ", "base z: ")
SHORT = re.compile(r"[A-Za-z]_?\d*")
MANY_AXES = 9
NAMED_BY_SESSION = ("temp_", "ext_")


@dataclass(frozen=True)
class Checked:
    """A formula as typed so far.

    Attributes:
        error: empty where it can be read; at: where in the text the error is, -1 where it has no place.
        parameters: names that would be identified; doubtful: those that nobody has declared, with the name that may be meant.
    """

    error: str = ""
    at: int = -1
    parameters: tuple[str, ...] = ()
    doubtful: tuple[tuple[str, str], ...] = ()


def is_formula(text: str) -> bool:
    """Whether a text is a formula and not the id of an effect."""
    return ":" in text


def check(text: str, variables: Sequence[str] = (), declared: Collection[str] = ()) -> Checked:
    """Read a formula without using it.

    Args:
        text: `TARGET: EXPRESSION`, a name and `=` may stand before it.
        variables: names that this session has; those of any session where empty.
        declared: parameters that the user has confirmed.
    """
    begin, formula = _without_name(text)
    target, colon, expression = formula.partition(":")
    if not colon:
        return Checked("Begin with what the formula gives: 'axis 3:' an angle, 'tool z:' or 'base x:' a displacement.", len(text))
    offset = begin + len(target) + 1
    known = _known(variables)
    turns = re.fullmatch(r"\s*(axis\s+\d+|link\s+\d+[ab])\s*", target)
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except SyntaxError as error:
        blank = len(expression) - len(expression.lstrip())
        at = offset + blank + max((error.offset or 1) - 1, 0)
        return Checked(f"This is no expression: {error.msg}.", min(at, len(text)))
    except (RecursionError, MemoryError, ValueError) as error:
        return Checked(f"This is no expression: {error}.", offset)
    try:
        effect = FormulaEffect("formula", formula.strip())
    except EffectError as error:
        message = str(error)
        return Checked(message.partition("': ")[2] or message, _place_of(message, text, offset))
    names = _names(tree)
    base = offset + len(expression) - len(expression.lstrip())
    for name, column in names:
        if _looks_like_variable(name) and name not in known and (variables or not name.startswith(NAMED_BY_SESSION)):
            return Checked(f"'{name}' is not in this session.", base + column)
        if turns is None and name in ("tau", "tau_g", "q", "step"):
            return Checked(f"'{name}' needs a target axis: write {name}_1, or begin with 'axis 1:'.", base + column)
    parameters = effect._names
    doubtful = tuple((n, nearest(n, known)) for n in parameters if n not in declared and needs_declaring(n, known))
    return Checked("", -1, parameters, doubtful)


def needs_declaring(name: str, known: Collection[str] = ()) -> bool:
    """Whether a name might be a typing error: longer than a letter with a number, or a variable without its underscore."""
    if not SHORT.fullmatch(name):
        return True
    return any(name == v.replace("_", "") for v in (known or _known(())))


def nearest(name: str, known: Collection[str] = ()) -> str:
    """The variable or function that may have been meant, or an empty string."""
    pool = [*(known or _known(())), *FUNCTIONS, *CONSTANTS]
    found = difflib.get_close_matches(name.lower(), pool, 1, 0.6)
    return found[0] if found else next((v for v in pool if v.replace("_", "") == name), "")


def complete(text: str, cursor: int, variables: Sequence[str] = ()) -> list[str]:
    """What may stand at the cursor instead of the word that is begun there, best first, at most 8."""
    before = text[:cursor]
    _, formula = _without_name(before)
    if ":" not in formula:
        if formula.strip() in ("axis", "link"):
            return [f"{formula.strip()} "]
        return [t for t in TARGETS if t.startswith(formula.lstrip())][:8]
    word = re.search(r"[A-Za-z_]\w*$", before)
    if word is None:
        return []
    pool = [*(_known(variables)), *(f"{f}(" for f in FUNCTIONS), *CONSTANTS]
    return [v for v in dict.fromkeys(pool) if v.startswith(word[0]) and v != word[0]][:8]


def completed(text: str, cursor: int, choice: str) -> str:
    """The text with a choice in place of the word that is begun at the cursor."""
    before, after = text[:cursor], text[cursor:]
    _, formula = _without_name(before)
    if ":" not in formula:
        start = before[: len(before) - len(formula.lstrip())]
        return start + choice + after
    word = re.search(r"[A-Za-z_]\w*$", before)
    return before[: word.start() if word else len(before)] + choice + after


def undeclared(text: str, declared: Collection[str], variables: Sequence[str] = ()) -> tuple[tuple[str, str], ...]:
    """Names of a formula that somebody has to declare or confirm, each with the name that may be meant instead.

    Raises EffectError: the formula can't be read, or a declared parameter does not occur in it.
    """
    found = check(text, variables, declared)
    if found.error:
        raise EffectError(f"formula '{text}': {found.error.rstrip('.')}{place(text, found.at)}")
    missing = [n for n in declared if n not in found.parameters]
    if missing:
        raise EffectError(
            f"formula '{text}': the parameter '{missing[0]}' that was declared does not occur in it;"
            f" its parameters are {', '.join(found.parameters)}"
        )
    return found.doubtful


def place(text: str, at: int) -> str:
    """Where an error is, for a message of one line."""
    return f", at character {at + 1}: '{text[at : at + 16]}'" if 0 <= at < len(text) else ""


def _without_name(text: str) -> tuple[int, str]:
    named = re.match(r"\s*[A-Za-z_]\w*\s*=\s*", text)
    return (named.end(), text[named.end() :]) if named else (0, text)


def _known(variables: Sequence[str]) -> tuple[str, ...]:
    if variables:
        return tuple(variables)
    out: list[str] = []
    for name in VARIABLES:
        stem = name.removesuffix(" ..")
        if stem != name:
            out += [f"{stem[:-2]}_{k}" for k in range(1, MANY_AXES + 1)]
        elif "NAME" not in name:
            out += name.split()
    return tuple(out)


def _looks_like_variable(name: str) -> bool:
    return bool(re.fullmatch(r"(tau|tau_g|q|step)_\d+|temp_\w+|ext_\w+", name))


def _names(tree: ast.Expression) -> list[tuple[str, int]]:
    return [(n.id, n.col_offset) for n in ast.walk(tree) if isinstance(n, ast.Name)]


def _place_of(message: str, text: str, offset: int) -> int:
    """Where the thing stands that a message quotes."""
    for quoted in re.findall(r"'([^']+)'", message.partition("': ")[2] or message):
        at = text.find(quoted)
        if at >= 0:
            return at
    return 0 if "must begin with" in message else offset
