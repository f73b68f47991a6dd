# SPDX-License-Identifier: Apache-2.0
"""No callback of a node is outside the guard: every node is a guarded one, and what the guard can't wrap is wrapped by hand."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [p for d in ("irec_calibration", "irec_correction", "irec_sim") for p in sorted((ROOT / d / d).rglob("*.py"))]
OF_ACTIONS = {"execute_callback", "goal_callback", "handle_accepted_callback", "cancel_callback"}
PLAIN = {"Node", "LifecycleNode"}


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _nodes_without_guard(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            bases = [_name(b) for b in node.bases]
            if PLAIN & set(bases) and bases[0] != "Guarded":
                yield f"class {node.name} in line {node.lineno}"
        elif isinstance(node, ast.Call) and _name(node.func) in PLAIN | {"create_node"}:
            yield f"{_name(node.func)}() in line {node.lineno}"


def _callbacks_without_guard(tree: ast.AST) -> Iterator[str]:
    """Callbacks of actions and of futures; an expression (lambda) that only says a constant or sets an event is let pass."""
    guarded = {
        target.id for node in ast.walk(tree) if isinstance(node, ast.Assign) and _wrapped(node.value)
        for target in node.targets if isinstance(target, ast.Name)
    }  # fmt: skip
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        given = [("add_done_callback", node.args[0])] if _name(node.func) == "add_done_callback" else []
        if _name(node.func) == "ActionServer":
            given = [(k.arg, k.value) for k in node.keywords if k.arg in OF_ACTIONS]
        for what, callback in given:
            if not (_wrapped(callback) or isinstance(callback, ast.Lambda) or _name(callback) in guarded):
                yield f"{what} in line {callback.lineno}"


def _wrapped(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and _name(value.func) == "guarded"


@pytest.mark.parametrize("find", [_nodes_without_guard, _callbacks_without_guard])
def test_everything_that_ros_calls_is_guarded(find) -> None:
    found = [f"{p.relative_to(ROOT)}: {what}" for p in SOURCES for what in find(ast.parse(p.read_text()))]
    assert found == []


def _moves_kept_too_long(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _name(node.func) == "ActionServer" and _name(node.args[1]) == "Move":
            if "RESULT_KEPT" not in [_name(k.value) for k in node.keywords if k.arg == "result_timeout"]:
                yield f"ActionServer in line {node.lineno}"


def test_every_driver_forgets_moves_that_have_ended() -> None:
    """Hundreds an hour: with the 900 s of rclpy memory and messages grow (`irec_ros.moves`)."""
    found = [f"{p.relative_to(ROOT)}: {what}" for p in SOURCES for what in _moves_kept_too_long(ast.parse(p.read_text()))]
    assert found == []
    assert list(_moves_kept_too_long(ast.parse("ActionServer(n, Move, 'a', result_timeout=900)")))


def test_what_is_not_guarded_is_found() -> None:
    nodes = "class A(Node): ...\nclass B(Guarded, Node): ...\n"
    tree = ast.parse(f"{nodes}ActionServer(n, T, 'a', execute_callback=self.f)\nf.add_done_callback(g)")
    assert list(_nodes_without_guard(tree)) == ["class A in line 1"]
    assert list(_callbacks_without_guard(tree)) == ["execute_callback in line 3", "add_done_callback in line 4"]
