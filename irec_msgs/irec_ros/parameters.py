# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node as a table: name, default, what it is, range, unit, and whether it can be set while the node runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter


@dataclass(frozen=True)
class P:
    """One parameter.

    Attributes:
        default: its type is the type of the parameter; a whole number does for one that is a float.
        text: what it is, in a few words. low, high: range of a number, both ends allowed. unit: of the number.
        settable: it can be set while the node runs; what can't is read-only.
    """

    name: str
    default: Any
    text: str
    low: float | None = None
    high: float | None = None
    unit: str = ""
    settable: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """As `ros2 param describe` shows it."""
        text = f"{self.text} [{self.unit}]" if self.unit else self.text
        number = isinstance(self.default, int | float) and not isinstance(self.default, bool)
        # `-p rate:=250` is meant as 250.0, which ROS refuses where the type is fixed
        d = ParameterDescriptor(description=text, read_only=not self.settable, dynamic_typing=isinstance(self.default, float))
        if number and self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                d.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=0)]
            else:
                d.floating_point_range = [FloatingPointRange(from_value=float(self.low), to_value=float(self.high), step=0.0)]
        return d

    def problem(self, value: Any) -> str:
        """Why this can't be the value; empty where it can. The types of texts and lists are checked by ROS."""
        if isinstance(self.default, bool | str) or not isinstance(self.default, int | float | list):
            return ""
        numbers = list(value) if isinstance(self.default, list) else [value]
        if not isinstance(self.default, list) and (isinstance(value, bool) or not isinstance(value, int | float)):
            return f"parameter '{self.name}' is {value!r}; a number is needed"
        for v in numbers:
            if isinstance(v, float) and not math.isfinite(v):
                return f"parameter '{self.name}' is {v}; a finite number is needed"
            if (self.low is not None and v < self.low) or (self.high is not None and v > self.high):
                unit = f" {self.unit}" if self.unit else ""
                return f"parameter '{self.name}' is {v:g}{unit}; from {self.low} to {self.high}{unit} is possible"
        return ""


class Parameters:
    """The declared parameters of a node: `parameters["name"]`.

    Raises:
        ParameterException: a value of another type or out of its range; names it and says what is possible.
    """

    def __init__(self, node: Node, table: Iterable[P]) -> None:
        self._node = node
        self._table = {p.name: p for p in table}
        self._changed: dict[str, Callable[[Any], None]] = {}
        for p in self._table.values():
            value = node.declare_parameter(p.name, p.default, p.descriptor()).value
            if problem := p.problem(value):
                raise ParameterException(problem, [p.name])
        if any(p.settable for p in self._table.values()):
            node.add_on_set_parameters_callback(self._check)
            node.add_post_set_parameters_callback(self._after_set)

    def __getitem__(self, name: str) -> Any:
        value = self._node.get_parameter(name).value
        if isinstance(self._table[name].default, float):
            return float(value)
        return value

    def three(self, name: str) -> tuple[float, float, float]:
        """A parameter of three numbers. Raises ParameterException."""
        value = self[name]
        if len(value) != 3:
            raise ParameterException(f"parameter '{name}' has {len(value)} numbers, it needs 3", [name])
        x, y, z = (float(v) for v in value)
        return x, y, z

    def when_set(self, name: str, tell: Callable[[Any], None]) -> None:
        """Call `tell` with each new value of a settable parameter."""
        self._changed[name] = tell

    def _check(self, given: list[Parameter]) -> SetParametersResult:
        for parameter in given:
            p = self._table.get(parameter.name)
            if p is not None and (problem := p.problem(parameter.value)):
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def _after_set(self, given: list[Parameter]) -> None:
        for parameter in given:
            if parameter.name in self._changed:
                self._changed[parameter.name](self[parameter.name])
