# SPDX-License-Identifier: Apache-2.0
"""Passive joints that follow others through a linkage, as written in session.yaml: `joint_4: {passive: "-(joint_2 +
joint_3)"}`."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable

import numpy as np

from ..errors import SessionError
from ..typing import Array

OPERATORS: dict[type[ast.AST], Callable[..., Array]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide,
    ast.USub: np.negative, ast.UAdd: np.positive,
}  # fmt: skip
STEP = 1e-6  # rad


def coupling(passive: dict[str, str], names: tuple[str, ...], q: Array) -> Array | None:
    """How the joints follow the driven ones: dq = coupling dq_driven.

    Args:
        passive: name of a joint without a drive -> expression in the names of others (`joint_k`).
        names: all joints in order.
        q: (n, k), rad.

    Returns:
        (n, k, k): unit columns for driven joints with the coupled joints' share below; a unit column for a passive one, as if it
        moved by itself. None where every joint is driven.

    Raises:
        SessionError: an expression that can't be read.
    """
    index = {name: k for k, name in enumerate(names)} | {f"joint_{k + 1}": k for k in range(len(names))}
    followers = {index[name]: _parse(name, text, index) for name, text in passive.items() if name in index}
    if not followers:
        return None
    n, k = q.shape
    out = np.tile(np.eye(k), (n, 1, 1))
    for p, tree in followers.items():
        for d in range(k):
            if d not in followers:
                ahead, behind = q.copy(), q.copy()
                ahead[:, d] += STEP
                behind[:, d] -= STEP
                out[:, p, d] = np.broadcast_to((_value(tree, ahead, index) - _value(tree, behind, index)) / (2 * STEP), n)
    return out


def _parse(name: str, text: str, index: dict[str, int]) -> ast.AST:
    where = f"session.yaml: joints: {name}: passive: '{text}'"
    try:
        tree = ast.parse(re.sub(r"\s+", " ", text).strip(), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise SessionError(f"{where}: not an expression: {error}") from error
    for node in ast.walk(tree):
        if isinstance(node, (ast.operator, ast.unaryop, ast.expr_context)):
            continue
        known = isinstance(node, ast.Name) and node.id in index and index[node.id] != index[name]
        number = isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool)
        operation = isinstance(node, (ast.BinOp, ast.UnaryOp)) and type(node.op) in OPERATORS
        if not (known or number or operation):
            raise SessionError(f"{where}: '{ast.unparse(node)}' is not allowed; use numbers, other joints' names and + - * /")
    return tree


def _value(node: ast.AST, q: Array, index: dict[str, int]) -> Array:
    if isinstance(node, ast.Name):
        return q[:, index[node.id]]
    if isinstance(node, ast.Constant):
        return np.asarray(float(node.value))  # type: ignore[arg-type]
    if isinstance(node, ast.BinOp):
        return OPERATORS[type(node.op)](_value(node.left, q, index), _value(node.right, q, index))
    if not isinstance(node, ast.UnaryOp):
        raise TypeError(f"{ast.dump(node)} has passed the check of the expression")
    return OPERATORS[type(node.op)](_value(node.operand, q, index))
