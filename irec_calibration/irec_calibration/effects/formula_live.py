# SPDX-License-Identifier: Apache-2.0
"""A formula that turns an axis or tilts a link by torques, forces and angles, in the live correction.

Evaluated on single numbers, without arrays: in a thirtieth of the time of `displacement` (`tools/bench/correction.py`, `law`).
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Collection, Mapping

import numpy as np

from ..errors import EffectError
from ..typing import Array
from .live import ColumnLaw, Tick, drives

READ = re.compile(r"(tau|tau_g|q)(_\d+)?|f_[xyz]|load")  # variables that a tick has
Values = Mapping[str, float]
OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: math.pow,
    ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., float]] = {
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "tanh": math.tanh, "exp": math.exp, "log": math.log, "sqrt": math.sqrt,
    "abs": abs, "sign": lambda x: math.copysign(1.0, x) if x else 0.0, "min": min, "max": max,
    "clip": lambda x, low, high: min(max(x, low), high),
}  # fmt: skip


class TurningLaw(ColumnLaw):
    """What a formula gives for an axis, or for an axis across it, under the process less what it gives without."""

    def __init__(
        self, formula: str, column: str, axis: int, n_joints: int, names: Collection[str], angle: Callable[[Values], float],
        exact: Callable[[Values], float], size: Callable[[Array, Array], Array],
    ) -> None:  # fmt: skip
        """
        Args:
            formula: for messages. column: that it turns, as `drives` or springs name it; axis: that it belongs to, from 0.
            names: variables that it reads, each as `READ` says. angle: by their values, rad; exact: the same where that raises,
                as at a division by 0, by the arithmetic that predictions have.
            size: the variable `load` of force and torque in tool0, (3,) each, N.
        """
        self.columns = (*(c for c in drives(n_joints) if c != column), column)
        self._formula, self._angle, self._exact, self._size = formula, angle, exact, size
        own = len(self.columns) - 1
        place = {c: i for i, c in enumerate(self.columns)}
        of: dict[str, list[tuple[str, int]]] = {"tau": [], "tau_g": [], "q": []}
        for found in (f for f in map(READ.fullmatch, names) if f is not None and f[1]):
            k = axis if found[2] is None else int(found[2][1:]) - 1
            by_column = found[1] == "tau"
            of[found[1]].append((found[0], k if not by_column else own if found[2] is None else place[f"joint_{k + 1}"]))
        self._tau, self._tau_g, self._q = of["tau"], of["tau_g"], of["q"]
        self._force = [(name, "xyz".index(name[2])) for name in names if name.startswith("f_")]
        self._reads_size = "load" in names
        none = np.zeros(3)
        self._relaxed = dict.fromkeys([n for n, _ in (*self._tau, *self._force)], 0.0)
        self._relaxed |= {"load": float(size(none, none))} if self._reads_size else {}
        self.needs_gravity = bool(self._tau_g)
        self._out = np.zeros(len(self.columns))

    def displacement(self, tick: Tick, tau: Array) -> Array:
        values = {name: float(tick.q[k]) for name, k in self._q}
        values |= {name: float(tick.tau_gravity[k]) for name, k in self._tau_g}
        pressed = {name: float(tau[i]) for name, i in self._tau} | {name: float(tick.force[i]) for name, i in self._force}
        if self._reads_size:
            pressed["load"] = float(self._size(tick.force, tick.torque))
        angle = self._at(values | pressed) - self._at(values | self._relaxed)
        if not math.isfinite(angle):
            raise EffectError(f"formula '{self._formula}': not a finite number at the present joint angles and torques")
        self._out[-1] = angle
        return self._out

    def _at(self, values: Values) -> float:
        try:
            return self._angle(values)
        except (ValueError, ZeroDivisionError, OverflowError):
            return self._exact(values)


def by_values(tree: ast.AST, constants: Values) -> Callable[[Values], float]:
    """A parsed formula as a function of the values of its variables, of single numbers.

    Args:
        constants: names that have one value, such as parameters.
    """
    match tree:
        case ast.Constant(value):
            number = float(value)  # type: ignore[arg-type]
            return lambda values: number
        case ast.Name(name) if name in constants:
            constant = float(constants[name])
            return lambda values: constant
        case ast.Name(name):
            return lambda values: values[name]
        case ast.BinOp(left, operation, right):
            a, b, of = by_values(left, constants), by_values(right, constants), OPERATORS[type(operation)]
            return lambda values: of(a(values), b(values))
        case ast.UnaryOp(operation, operand):
            inner, sign = by_values(operand, constants), OPERATORS[type(operation)]
            return lambda values: sign(inner(values))
        case ast.Call(ast.Name(name), arguments):
            each, function = [by_values(x, constants) for x in arguments], FUNCTIONS[name]
            return lambda values: function(*(x(values) for x in each))
    raise EffectError(f"can't evaluate '{ast.unparse(tree)}'")
