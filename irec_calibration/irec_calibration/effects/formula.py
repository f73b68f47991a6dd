# SPDX-License-Identifier: Apache-2.0
"""An effect that a user writes as one line: `axis 3: c * tau**3`.

The part before the colon says what the formula gives: `axis K` an angle about joint K, `link Ka` or `link Kb` one about an axis
across it at the same place (virtual axis of the paper, Eq. (1)), `tool x|y|z` or `base x|y|z` a displacement along an axis of
tool0 or base_link. The expression may use the variables of `VARIABLES`, the functions of
`FUNCTIONS`, numbers, and any other names, which become parameters. It is parsed into a tree of permitted operations and
never handed to `eval`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping

import numpy as np

from ..errors import EffectError
from ..typing import Array
from .base import NOT_IN_PRODUCTION, Effect, Parameter, not_in_production
from .formula_live import READ, TurningLaw, by_values
from .live import ByDisplacement, LeftOut, LiveForm, Refused
from .scene import Scene
from .traits import Cause

VARIABLES: dict[str, str] = {
    "tau": "torque of the process about the target axis, N m (axis K and link Ka or Kb only)",
    "tau_g": "torque of gravity about the target axis, N m (the same)",
    "q": "angle of the target axis, rad (the same)",
    "step": "change of the target axis since the previous row, rad (axis K only)",
    "tau_1 ..": "process torque about axis 1, 2, .., N m",
    "tau_g_1 ..": "gravity torque about axis 1, 2, .., N m",
    "q_1 ..": "angle of axis 1, 2, .., rad",
    "step_1 ..": "change of axis 1, 2, .. since the previous row, rad",
    "f_x f_y f_z": "force of the environment on the robot in tool0, N",
    "b_x b_y b_z": "the same in base_link, N",
    "load": "size of the process force, N; a torque counts as the force that has it over 0.2 m; never 0",
    "x y z": "TCP in base_link, m",
    "t": "time since the session began, s",
    "dwell": "time since the load was applied, s",
    "temp_NAME": "a logged temperature, degC",
    "ext_NAME": "an external axis, m or rad",
}
FUNCTIONS: dict[str, Callable[..., Array]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "tanh": np.tanh, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
    "abs": np.abs, "sign": np.sign, "min": np.minimum, "max": np.maximum, "clip": np.clip,
}  # fmt: skip
CONSTANTS = {"pi": np.pi}
ARGUMENTS = {"min": 2, "max": 2, "clip": 3}  # of the others one; clip(x, lowest, highest)
HELD = re.compile(r"clip\((q_\d+), [-.\d]+, [-.\d]+\)")  # an angle that a law holds at the ends of what was seen of it
LOAD_VARIABLE = r"tau(_\d+)?|[fb]_[xyz]|load"
TARGET = re.compile(
    r"\s*(?:axis\s+(?P<axis>\d+)|link\s+(?P<link>\d+)(?P<across>[ab])|(?P<frame>tool|base)\s+(?P<along>[xyz]))\s*"
)
NEEDS = {"load": LOAD_VARIABLE, "time": "t|dwell", "step": r"step(_\d+)?", "temperature": r"temp_\w+", "ext": r"ext_\w+"}
OPERATORS: dict[type[ast.AST], Callable[..., Array]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
    ast.USub: np.negative, ast.UAdd: np.positive,
}  # fmt: skip
TYPICAL_DISPLACEMENT = 1e-4  # m; a parameter of scale 1 moves the marker by about this much
LEVER = 0.2  # m, by which `load` counts a torque as a force
SMALLEST_LOAD = 1e-6  # N
LINE = 60  # characters of a formula in a table or a sentence
LONGEST_FORMULA = 500
DEEPEST = 100  # operations inside one another
LARGEST_EXPONENT = 12


class FormulaEffect(Effect):
    """One line of formula as an effect. Raises EffectError on construction where the line can't be read."""

    physics = "Written by the user as a formula."

    def __init__(self, effect_id: str, formula: str) -> None:
        """Parse.

        Args:
            effect_id: id that files and reports use.
            formula: `TARGET: EXPRESSION`.
        """
        self.id = effect_id  # type: ignore[misc]
        self.formula = formula
        self.label = formula  # type: ignore[misc]
        if len(formula) > LONGEST_FORMULA:
            raise EffectError(f"formula of {len(formula)} characters; at most {LONGEST_FORMULA} are read")
        target, colon, expression = formula.partition(":")
        found = TARGET.fullmatch(target)
        if not colon or found is None:
            raise EffectError(
                f"formula '{formula}': it must begin with 'axis K:', 'link Ka:' (Kb), 'tool x:' (y, z) or 'base x:' (y, z), as "
                "in 'axis 3: c * tau**3'"
            )
        self._axis = int(found["axis"]) - 1 if found["axis"] else None
        self._link = 2 * (int(found["link"]) - 1) + "ab".index(found["across"]) if found["link"] else None
        self._frame, self._direction = found["frame"], "xyz".find(found["along"] or "x")
        try:
            self._tree = ast.parse(expression.strip(), mode="eval").body
        except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
            raise EffectError(f"formula {formula!r}: not an expression: {error}") from error
        if _deeper_than(DEEPEST, self._tree):
            raise EffectError(f"formula '{formula}': more than {DEEPEST} operations inside one another")
        self._check(self._tree)
        names = {n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name)}
        called = {n.func.id for n in ast.walk(self._tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        self._names = tuple(sorted(n for n in names - called if not _is_variable(n) and n not in CONSTANTS))
        if not self._names:
            raise EffectError(f"formula '{formula}': no parameter in it; give at least one name to be identified, such as c")
        read = self._read = {n for n in names - called if _is_variable(n)}
        self.needs = tuple(need for need, pattern in NEEDS.items() if any(re.fullmatch(pattern, n) for n in read))  # type: ignore[misc]
        if not any(re.fullmatch(LOAD_VARIABLE, n) for n in read):
            self.cause = Cause.TIME if {"time", "temperature"} & set(self.needs) else Cause.STATE  # type: ignore[misc]

    def _check(self, node: ast.AST) -> None:
        allowed = (ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Constant)
        if not isinstance(node, allowed):
            raise EffectError(f"formula '{self.formula}': '{ast.unparse(node)}' is not allowed; use + - * / ** and functions")
        if isinstance(node, ast.Constant) and (isinstance(node.value, bool) or not isinstance(node.value, (int, float))):
            raise EffectError(f"formula '{self.formula}': {node.value!r} is not a number")
        if isinstance(node, ast.Name) and node.id in FUNCTIONS:
            raise EffectError(f"formula '{self.formula}': '{node.id}' is a function and needs its arguments: {node.id}(...)")
        if isinstance(node, (ast.BinOp, ast.UnaryOp)):
            if type(node.op) not in OPERATORS:
                raise EffectError(f"formula '{self.formula}': operator in '{ast.unparse(node)}' is not allowed; use + - * / **")
            exponent = node.right.value if isinstance(node, ast.BinOp) and isinstance(node.right, ast.Constant) else None
            if isinstance(node.op, ast.Pow) and isinstance(exponent, (int, float)) and abs(exponent) > LARGEST_EXPONENT:
                raise EffectError(f"formula '{self.formula}': exponent {exponent} is above {LARGEST_EXPONENT}")
            children = [node.left, node.right] if isinstance(node, ast.BinOp) else [node.operand]
        elif isinstance(node, ast.Call):
            if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS or node.keywords:
                raise EffectError(
                    f"formula '{self.formula}': '{ast.unparse(node.func)}' is not a function; there are {', '.join(FUNCTIONS)}"
                )
            needed = ARGUMENTS.get(node.func.id, 1)
            if len(node.args) != needed:
                raise EffectError(f"formula '{self.formula}': {node.func.id} takes {needed} argument(s), {len(node.args)} given")
            children = list(node.args)
        else:
            children = []
        for child in children:
            self._check(child)

    @property
    def in_short(self) -> str:
        """The formula, without the ends at which angles are held, where a line has room; else what it gives and by what."""
        free = HELD.sub(r"\1", self.formula)
        if len(free) <= LINE:
            return free
        return f"{self.formula.partition(':')[0].strip()}: by {', '.join(sorted(self._read))}"

    def no_live_form(self) -> LeftOut | Refused | None:
        at = self._counted_from()
        if at and [n for n in NOT_IN_PRODUCTION if n in self.needs] == ["temperature"] and self._vanishes(at):
            usual = ", ".join(f"{name} = {value:g} degC" for name, value in at.items())
            return LeftOut(f"follows a temperature, which a correction does not read; the arm is taken to be at {usual}")
        return super().no_live_form() or not_in_production(self)

    @property
    def turns_by_itself(self) -> bool:
        """Whether it turns an axis by nothing but that axis' own torques and angle."""
        own = re.compile(rf"(tau|tau_g|q)(_{(self._axis or 0) + 1})?")
        return self._axis is not None and all(own.fullmatch(n) for n in self._read)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        turns = self._axis if self._axis is not None else self._link
        # no tick has the torque of gravity about an axis across a joint
        if turns is None or not all(READ.fullmatch(n) for n in self._read) or (self._link is not None and "tau_g" in self._read):
            return ByDisplacement()
        axis = turns if self._axis is not None else turns // 2
        column = f"joint_{axis + 1}{'' if self._axis is not None else 'ab'[turns % 2]}"
        constants = {**CONSTANTS, **dict(zip(self._names, (float(v) for v in theta), strict=True))}

        def exact(values: Mapping[str, float]) -> float:
            return float(self._evaluate({**values, **constants}))

        law = by_values(self._tree, constants)
        return TurningLaw(self.formula, column, axis, scene.n_joints, self._read, law, exact, size_of_load)

    def _counted_from(self) -> dict[str, float]:
        """Temperatures that are counted from one value: those that stand in a difference `temp_NAME - NUMBER`."""
        out: dict[str, float] = {}
        for node in ast.walk(self._tree):
            match node:
                case ast.BinOp(ast.Name(name), ast.Sub(), ast.Constant(int() | float() as value)) if name.startswith("temp_"):
                    out[name] = float(value)
        return out

    def _vanishes(self, at: dict[str, float]) -> bool:
        """Whether it is 0 where some variables have these values, whatever the others."""
        names = {n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name)}
        others = np.random.default_rng(0).uniform(0.5, 2.0, (len(names), 5))
        return bool(np.all(self._evaluate({**dict(zip(sorted(names), others, strict=True)), **at}) == 0.0))

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        variables = self._variables(scene)
        ones = dict.fromkeys(self._names, 1.0)
        out = []
        for name in self._names:
            # the size of a parameter that moves the marker visibly, other parameters at 1
            angle = self._evaluate({**variables, **ones, name: 1.0}) - self._evaluate({**variables, **ones, name: 0.0})
            moved = np.linalg.norm(self._along(scene) * np.broadcast_to(angle, len(scene))[:, None], axis=1)
            size = float(np.sqrt(np.mean(np.nan_to_num(moved, posinf=0.0) ** 2)))
            scale = TYPICAL_DISPLACEMENT / size if size > 0.0 else 1.0
            out.append(Parameter(name, "by formula", scale, axis=self._axis))
        return tuple(out)

    def displacement(self, scene: Scene, theta: Array) -> Array:
        value = self._evaluate({**self._variables(scene), **dict(zip(self._names, theta, strict=True))})
        value = np.broadcast_to(value, len(scene))
        if not np.isfinite(value).all():
            row = int(np.flatnonzero(~np.isfinite(value))[0])
            raise EffectError(
                f"effect '{self.id}', formula '{self.formula}': not a finite number in row {row + 1} of the session"
            )
        return self._along(scene) * value[:, None]

    def _along(self, scene: Scene) -> Array:
        """Displacement of the observed point per unit of the formula, (n, 3)."""
        if self._axis is not None:
            if self._axis >= scene.n_joints:
                raise EffectError(f"formula '{self.formula}': the robot has {scene.n_joints} axes")
            return scene.J[:, :, self._axis]
        if self._link is not None:
            if self._link >= scene.V.shape[2]:
                raise EffectError(f"formula '{self.formula}': the robot has {scene.n_joints} axes")
            return scene.V[:, :, self._link]
        if self._frame == "tool":
            return scene.kin.R_tool[:, :, self._direction] * scene.moves_with_arm[:, None]
        return np.tile(np.eye(3)[self._direction], (len(scene), 1))

    def _variables(self, scene: Scene) -> dict[str, Array]:
        table: dict[str, Array] = {"t": scene.stamp, "dwell": scene.stamp - scene.load_since}
        per_axis = {"tau": scene.tau, "tau_g": scene.tau_gravity, "q": scene.q, "step": scene.step}
        for name, block in per_axis.items():
            table |= {f"{name}_{k + 1}": block[:, k] for k in range(scene.n_joints)}
            if self._axis is not None and self._axis < scene.n_joints:
                table[name] = block[:, self._axis]
        if self._link is not None and self._link < scene.V.shape[2]:
            k = self._link // 2
            table |= {"tau": scene.tau_virtual[:, self._link], "tau_g": scene.gravity.tau_virtual[:, self._link]}
            table["q"] = scene.q[:, k]
        if "load" in self._read:
            table["load"] = size_of_load(scene.force_in_tool, scene.torque_in_tool)
        for prefix, block in (("f_", scene.force_in_tool), ("b_", scene.force), ("", scene.p_tcp)):
            table |= {prefix + a: block[:, i] for i, a in enumerate("xyz")}
        table |= {f"temp_{n}": v for n, v in scene.temperature.items()} | {f"ext_{n}": v for n, v in scene.ext.items()}
        for name in sorted(self._read):
            if name not in table:
                raise EffectError(f"formula '{self.formula}': '{name}' is not in this session; there are {', '.join(table)}")
        return table

    def _evaluate(self, values: dict[str, Array | float]) -> Array:
        def walk(node: ast.AST) -> Array:
            if isinstance(node, ast.Constant):
                return np.float64(node.value)  # type: ignore[arg-type, return-value]
            if isinstance(node, ast.Name):
                return np.asarray(CONSTANTS[node.id] if node.id in CONSTANTS else values[node.id], dtype=float)
            if isinstance(node, ast.BinOp):
                return OPERATORS[type(node.op)](walk(node.left), walk(node.right))
            if isinstance(node, ast.UnaryOp):
                return OPERATORS[type(node.op)](walk(node.operand))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                return FUNCTIONS[node.func.id](*(walk(a) for a in node.args))
            raise EffectError(f"formula '{self.formula}': can't evaluate '{ast.unparse(node)}'")

        with np.errstate(all="ignore"):
            return walk(self._tree)


def size_of_load(force: Array, torque: Array) -> Array:
    """The variable `load`, (...), N, of forces and torques, (..., 3) each, N and N m."""
    squared = (force * force).sum(axis=-1) + (torque * torque).sum(axis=-1) / LEVER**2
    return np.asarray(np.maximum(np.sqrt(squared), SMALLEST_LOAD))


def in_words(effect: Effect) -> str:
    """How a sentence names an effect: by its label, a formula as the law that it is."""
    return f"the law '{effect.in_short}'" if isinstance(effect, FormulaEffect) else effect.label


def _deeper_than(limit: int, tree: ast.AST) -> bool:
    """Whether an expression has more levels; without recursion, since it is asked before any."""
    level = [tree]
    for _ in range(limit):
        level = [c for node in level for c in ast.iter_child_nodes(node) if isinstance(c, ast.expr)]
        if not level:
            return False
    return True


def _is_variable(name: str) -> bool:
    return bool(re.fullmatch(r"(tau|tau_g|q|step)(_\d+)?|[fb]_[xyz]|load|[xyzt]|dwell|temp_\w+|ext_\w+", name))
