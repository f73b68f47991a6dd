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
import yaml
from scipy.spatial.transform import Rotation

from .errors import CellError
from .robot import Payload, Robot
from .surface import Block, MeshSurface, Patch, Surface
from .typing import Array

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
    """A cell as its file states it.

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

    Raises CellError: the file, a key or a value is wrong; names file and key. RobotError: the robot description.
    """
    path = Path(path)
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CellError(f"{path}: can't read the cell file: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CellError(f"{path}: not a YAML file: {error}") from error
    top = Section(path, "", raw)
    if top.get("format") != "irec-cell/1":
        raise CellError(f"{path}: format is {top.get('format')!r}, this version reads irec-cell/1")
    robot_, tool, limits, loads = (top.section(k) for k in ("robot", "tool", "limits", "load_cases"))
    robot = Robot.from_urdf(path.parent / robot_.get("urdf"))
    payload = tool.section("payload")
    noise = top.section("noise")
    stations = tuple(
        Station(str(s.get("name")), s.vector("xyz", 3), s.rotation("quat_xyzw")) for s in top.sections("stations")
    )
    if not stations:
        raise CellError(f"{path}: stations is empty: at least one tracker station has to see the marker")
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
        surface=_surface(path, top.section("surface")),
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
    )


def _rail(section: Section) -> Rail:
    axis, travel = section.vector("axis", 3), section.vector("range", 2)
    if np.linalg.norm(axis) == 0.0 or travel[0] > travel[1]:
        raise CellError(f"{section._place('axis')} or range is empty: axis {axis.tolist()}, range {travel.tolist()}")
    return Rail(axis / np.linalg.norm(axis), float(travel[0]), float(travel[1]))


def _surface(path: Path, section: Section) -> Surface:
    R, p = section.rotation("quat_xyzw"), section.vector("xyz", 3)
    kind = section.get("kind")
    if kind == "mesh":
        scale = section.number("scale", 1e-9) if "scale" in section else 1.0
        return MeshSurface.from_file(path.parent / str(section.get("file")), R, p, scale)
    if kind not in ("patch", "block"):
        raise CellError(f"{section._place('kind')} is {kind!r}, must be patch, block or mesh")
    size = section.vector("size", 2 if kind == "patch" else 3)
    if (size <= 0).any():
        raise CellError(f"{section._place('size')} must be positive, is {size.tolist()}")
    if kind == "block":
        faces = section.get("faces")
        if not isinstance(faces, list) or not faces or not set(faces) <= {"+x", "-x", "+y", "-y", "+z", "-z"}:
            raise CellError(f"{section._place('faces')} must list some of +x -x +y -y +z -z, is {faces!r}")
        return Block((size[0], size[1], size[2]), tuple(dict.fromkeys(faces)), R, p)
    radius = section.vector("radius", 2)
    if (radius == 0).any():
        raise CellError(f"{section._place('radius')} must not be 0 (use a large radius for a flat surface)")
    return Patch((size[0], size[1]), (radius[0], radius[1]), R, p)
