# SPDX-License-Identifier: Apache-2.0
"""Cell file `irec-cell/1`: robot, tool, tooling surface, tracker stations, load cases and limits of one cell.

The cell frame is base_link of the robot with its rail at 0; it does not move with the rail. SI units.
`Cell.raw` is the whole file, for those who need a section that this module does not read (procedure, workspace, course).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import CellError, PlanError, RobotError
from ..files.document import Document, open_document
from ..robot import Payload, Robot
from ..typing import Array
from .mesh import facing_share
from .rules import RULES, check_robot
from .surface import Block, MeshSurface, Patch, Surface

FORMAT = "irec-cell/1"
LOAD_CASE_NAMES = ("normal", "N", "S", "E", "W")


@dataclass(frozen=True)
class Rail:
    """Linear axis that carries base_link: unit direction (3,) in the cell frame, travel lower..upper, m."""

    axis: Array
    lower: float
    upper: float


@dataclass(frozen=True)
class Station:
    """Tracker station in the cell frame: position (3,), m, rotation of its frame into the cell frame (3, 3)."""

    name: str
    p_in_cell: Array
    R_in_cell: Array


@dataclass(frozen=True)
class Cell:
    """A cell as its file states it; `text` is what the file held when it was read.

    hull: spheres that contain tool and wrist, (s, 4): centre in tool0 and radius, m.
    forces_in_tool: (5, 3), N, environment on robot, in the order of LOAD_CASE_NAMES (paper, 4.1).
    friction: coefficient of the contact pad divided by its safety factor. continuous_torque: (k,), N m.
    """

    name: str
    path: Path
    robot: Robot
    serial: str
    home: Array
    arm_radius: float
    rail: Rail | None
    payload: Payload
    marker_in_tool: Array
    pad_radius: float
    clearance: float
    hull: Array
    surface: Surface
    stations: tuple[Station, ...]
    forces_in_tool: Array
    friction: float
    approach_distance: float
    reference_distance: float
    continuous_torque: Array
    joint_margin: float
    singularity: float
    noise: dict[str, float]
    tolerance: float
    poses_path: Path
    raw: dict[str, Any]
    text: str = ""

    @property
    def tool_name(self) -> str:
        """Of the mounted tool; empty where the file does not name it."""
        return str(self.raw["tool"].get("name") or "")

    @property
    def without_tracker(self) -> bool:
        """The file states that no tracker measures here (`procedure.without_tracker`); its stations only serve planning then."""
        return self.raw.get("procedure", {}).get("without_tracker", False) is True

    def base_in_cell(self, rail: Array) -> Array:
        """Position of base_link in the cell frame for rail positions (n,), shape (n, 3), m."""
        if self.rail is None:
            return np.zeros((len(rail), 3))
        return np.asarray(rail)[:, None] * self.rail.axis


def load_cases(fx: float, fy: float, fz: float) -> Array:
    """The five load cases of the paper (4.1) in tool0, environment on robot, (5, 3), N: normal, N, S, E, W.

    fx, fy, fz: magnitudes, N. The paper states the force that the robot exerts as +f_z normal to the surface pointing to the
    robot; tool0 z points to the surface, so the environment pushes back with -fz.
    """
    return np.array([[0, 0, -fz], [fx, 0, -fz], [-fx, 0, -fz], [0, -fy, -fz], [0, fy, -fz]], dtype=float)


class Section:
    """A mapping of the file that knows its own place, for messages."""

    def __init__(self, path: Path, name: str, values: Any) -> None:
        if not isinstance(values, dict):
            raise CellError(f"{path}: '{name or 'the file'}' must be a mapping, is {type(values).__name__}")
        self._path, self._name, self._values = path, name, values

    def _place(self, key: str) -> str:
        return f"{self._path}: {self._name + '.' if self._name else ''}{key}"

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def get(self, key: str) -> Any:
        if key not in self._values:
            raise CellError(f"{self._place(key)} is missing")
        return self._values[key]

    def only(self, *allowed: str) -> None:
        """Refuse keys that nobody reads: a limit with a spelling mistake must not be silently absent."""
        for key in self._values:
            if key not in allowed:
                near = difflib.get_close_matches(str(key), allowed, 1)
                raise CellError(f"{self._place(key)} is not known here; {f'write {near[0]}' if near else 'remove it'}")

    def section(self, key: str) -> Section:
        return Section(self._path, self._name + "." * bool(self._name) + key, self.get(key))

    def sections(self, key: str) -> list[Section]:
        items = self.get(key)
        if not isinstance(items, list):
            raise CellError(f"{self._place(key)} must be a list, is {type(items).__name__}")
        return [Section(self._path, f"{key}[{i}]", item) for i, item in enumerate(items)]

    def number(self, key: str, lowest: float = -np.inf, highest: float = np.inf) -> float:
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise CellError(f"{self._place(key)} must be a number, is {value!r}")
        if not lowest <= value <= highest:
            raise CellError(f"{self._place(key)} is {value}, must lie between {lowest} and {highest}")
        return float(value)

    def vector(self, key: str, length: int | None = None) -> Array:
        return self._array(key, (length,))

    def table(self, key: str, columns: int) -> Array:
        return self._array(key, (None, columns))

    def _array(self, key: str, shape: tuple[int | None, ...]) -> Array:
        try:
            value = np.array(self.get(key), dtype=float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        fits = value.ndim == len(shape) and all(s in (None, v) for s, v in zip(shape, value.shape, strict=True))
        if not fits or not np.isfinite(value).all():
            wanted = " x ".join("n" if s is None else str(s) for s in shape)
            raise CellError(f"{self._place(key)} must be {wanted} finite numbers, is {self.get(key)!r}")
        return value

    def rotation(self, key: str) -> Array:
        quaternion = self.vector(key, 4)
        if abs(np.linalg.norm(quaternion) - 1.0) > 1e-3:
            raise CellError(f"{self._place(key)} must have length 1, has {np.linalg.norm(quaternion):.4f}")
        return Rotation.from_quat(quaternion).as_matrix()


def read_cell(path: str | Path) -> Cell:
    """Read a cell file.

    Raises CellError: what is wrong, in the file or in the robot description and the mesh that it names; the message is one line,
    `problems` has one for each thing.
    """
    document, robot, surface = open_cell(path)
    document.finish(CellError)
    return _build(Path(path), document, robot, surface)  # type: ignore[arg-type]


def open_cell(path: str | Path) -> tuple[Document, Robot | None, Surface | None]:
    """A cell file with everything that is wrong in it, its robot and its surface (None where they can't be used).

    Raises CellError: not a cell file at all.
    """
    path = Path(path)
    document = open_document(path, FORMAT, "cell file", CellError, rules=RULES)
    robot = surface = None
    if document.sound("robot", "urdf"):
        try:
            robot = Robot.from_urdf(path.parent / document.data["robot"]["urdf"])
        except RobotError as error:
            document.wrong(("robot", "urdf"), f"can't be used: {error}")
    if robot is not None:
        check_robot(document, robot)
    if document.sound("surface"):
        try:
            surface = _surface(path, Section(path, "surface", document.data["surface"]))
        except (PlanError, CellError) as error:
            document.wrong(("surface",), f"can't be used: {error}")
    if surface is not None:
        _check_facing(document, surface)
    return document, robot, surface


def _build(path: Path, document: Document, robot: Robot, surface: Surface) -> Cell:
    raw: dict[str, Any] = document.data
    top = Section(path, "", raw)
    robot_, tool, limits, loads = (top.section(k) for k in ("robot", "tool", "limits", "load_cases"))
    payload = tool.section("payload")
    noise = top.section("noise")
    stations = tuple(
        Station(str(s.get("name")), s.vector("xyz", 3), s.rotation("quat_xyzw")) for s in top.sections("stations")
    )
    return Cell(
        name=str(top.get("name")),
        path=path,
        robot=robot,
        serial=str(robot_.get("serial")),
        home=robot_.vector("home", robot.n_joints),
        arm_radius=robot_.number("arm_radius", 0.0),
        rail=_rail(robot_.section("rail")) if "rail" in robot_ else None,
        payload=Payload(payload.number("mass", 0.0), tuple(payload.vector("com", 3))),
        marker_in_tool=tool.vector("marker_in_tool0", 3),
        pad_radius=tool.number("pad_radius", 0.0),
        clearance=tool.number("clearance", 0.0),
        hull=tool.table("hull", 4),
        surface=surface,
        stations=stations,
        forces_in_tool=load_cases(*(loads.number(k, 0.0) for k in ("fx", "fy", "fz"))),
        friction=loads.number("friction", 0.0) / loads.number("friction_safety", 1.0),
        approach_distance=top.number("approach_distance", 0.0),
        reference_distance=top.number("reference_distance", 0.0),
        continuous_torque=limits.number("continuous_torque", 0.0, 1.0) * robot.effort,
        joint_margin=limits.number("joint_margin", 0.0),
        singularity=limits.number("singularity", 0.0),
        noise={k: noise.number(k, 0.0) for k in ("tracker_m", "tracker_m_per_m", "force_n", "settling_m")},
        tolerance=top.number("tolerance_m", 0.0),
        poses_path=path.parent / str(top.get("poses")),
        raw=raw,
        text=document.text,
    )


def _check_facing(document: Document, surface: Surface) -> None:
    """A surface that turns its back to all stations can't be worked on: its normals, or its pose, are the wrong way round."""
    if not document.sound("stations"):
        return
    outward, inward = facing_share(surface.mesh(), np.array([s["xyz"] for s in document.data["stations"]], dtype=float))
    if outward < 0.02 < inward:
        stated = document.data["surface"]
        flip = f"write flip: {'false' if stated.get('flip') else 'true'}, or " if stated["kind"] == "mesh" else ""
        document.wrong(
            ("surface",),
            f"turns its back to every tracker station: the outward normals of {100 * outward:.0f} % of its area face one;"
            f" {flip}turn it round (quat_xyzw); irec show-cell draws it",
        )


def _rail(section: Section) -> Rail:
    axis, travel = section.vector("axis", 3), section.vector("range", 2)
    return Rail(axis / np.linalg.norm(axis), float(travel[0]), float(travel[1]))


def _surface(path: Path, section: Section) -> Surface:
    R, p = section.rotation("quat_xyzw"), section.vector("xyz", 3)
    kind = section.get("kind")
    if kind == "mesh":
        scale = section.number("scale") if "scale" in section else 1.0
        flip = bool(section.get("flip")) if "flip" in section else False
        return MeshSurface.from_file(path.parent / str(section.get("file")), R, p, scale, flip)
    if kind == "block":
        size = section.vector("size", 3)
        return Block((size[0], size[1], size[2]), tuple(dict.fromkeys(section.get("faces"))), R, p)
    size, radius = section.vector("size", 2), section.vector("radius", 2)
    return Patch((size[0], size[1]), (radius[0], radius[1]), R, p)
