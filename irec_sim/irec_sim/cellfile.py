# SPDX-License-Identifier: Apache-2.0
"""What the simulator needs of a cell file (irec-cell/1): robot, tool, tooling surface, stations, load cases, noise.

The cell frame is base_link with the rail at 0. The simulator reads the file for itself and ignores what it doesn't use.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SimError
from .files import read_yaml
from .kinematics import Array, Chain, read_urdf, rotation_of_quaternion
from .mesh import Mesh, read_mesh


@dataclass(frozen=True)
class Patch:
    """Double-curvature mould: z = -x^2 / (2 rx) - y^2 / (2 ry) over a rectangle, in its own frame R, p of the cell."""

    size: tuple[float, float]
    radius: tuple[float, float]
    R: Array
    p: Array

    def point(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Points (n, 3) and outward unit normals (n, 3) in the cell frame at local x, y (n,), m."""
        rx, ry = self.radius
        local = np.stack([x, y, -(x**2) / (2 * rx) - y**2 / (2 * ry)], axis=-1)
        normal = np.stack([x / rx, y / ry, np.ones_like(x)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return self.p + local @ self.R.T, normal @ self.R.T

    def sample(self, n: int, margin: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """n random points at least `margin` (m) inside the edge: positions and normals in the cell frame."""
        half = np.array(self.size) / 2 - margin
        xy = rng.uniform(-half, half, (n, 2))
        return self.point(xy[:, 0], xy[:, 1])

    def gap(self, p: Array) -> tuple[float, Array]:
        """Signed distance of one point above the surface, m (negative inside), and the normal there, in the cell frame.

        Exact to first order in the distance, which near contact is below a millimetre.
        """
        x, y, z = self.R.T @ (p - self.p)
        nx, ny = x / self.radius[0], y / self.radius[1]
        length = float(np.sqrt(nx * nx + ny * ny + 1.0))
        height = z + x * nx / 2 + y * ny / 2
        return height / length, self.R @ (np.array([nx, ny, 1.0]) / length)


@dataclass(frozen=True)
class Block:
    """Cuboid with some faces that the robot may press on; R, p of its centre in the cell frame."""

    size: tuple[float, float, float]
    faces: tuple[str, ...]
    R: Array
    p: Array

    def _face(self, name: str) -> tuple[int, float]:
        return "xyz".index(name[1]), 1.0 if name[0] == "+" else -1.0

    def face_point(self, name: str, a: Array, b: Array) -> tuple[Array, Array]:
        """Points and normals on one face at the two remaining local coordinates a, b (n,), m, in order x, y, z."""
        k, sign = self._face(name)
        local = np.empty((len(a), 3))
        local[:, k] = sign * self.size[k] / 2
        others = [i for i in range(3) if i != k]
        local[:, others[0]], local[:, others[1]] = a, b
        normal = np.zeros_like(local)
        normal[:, k] = sign
        return self.p + local @ self.R.T, normal @ self.R.T

    def sample(self, n: int, margin: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """n random points, the same share on each face, at least `margin` (m) from the edges."""
        points, normals = [], []
        for i, name in enumerate(self.faces):
            k, _ = self._face(name)
            half = np.array([s for j, s in enumerate(self.size) if j != k]) / 2 - margin
            ab = rng.uniform(-half, half, (n // len(self.faces) + (i < n % len(self.faces)), 2))
            p, normal = self.face_point(name, ab[:, 0], ab[:, 1])
            points.append(p)
            normals.append(normal)
        return np.concatenate(points), np.concatenate(normals)

    def gap(self, p: Array) -> tuple[float, Array]:
        """Signed distance of one point above the face it is nearest to, m, and that face's normal, in the cell frame."""
        local = self.R.T @ (p - self.p)
        excess = np.abs(local) - np.array(self.size) / 2
        k = int(np.argmax(excess))
        normal = np.zeros(3)
        normal[k] = np.sign(local[k])
        return float(excess[k]), self.R @ normal


@dataclass(frozen=True)
class CellFile:
    """Positions in the cell frame, m; forces in tool0, environment on robot, N.

    Attributes:
        rail: axis in the cell frame and range, or None.
        stations: (name, position, rotation into the cell frame).
        load_cases: nominal forces 1..M in tool0, (M, 3); names 1..M.
        noise: tracker_m, tracker_m_per_m, force_n, settling_m.
    """

    name: str
    path: Path
    chain: Chain
    urdf: Path
    serial: str
    home: Array
    rail: tuple[Array, tuple[float, float]] | None
    marker_in_tool0: Array
    pad_radius: float
    surface: Patch | Block | Mesh
    stations: tuple[tuple[str, Array, Array], ...]
    load_cases: Array
    load_case_names: tuple[str, ...]
    friction: float
    approach_distance: float
    reference_distance: float
    noise: dict[str, float]
    course: dict[str, Any]
    sensor_axis: Array
    arm_radius: float = 0.2


def find_cell(name: str) -> Path:
    """A cell by path, or by name among `config/cells` of this source tree or of the installed share folder.

    Raises:
        SimError: there is none.
    """
    here = Path(__file__).resolve()
    places = [Path(name)] + [p / "config" / "cells" / f"{name}.yaml" for p in (Path.cwd(), *here.parents)]
    places += [p / "share" / "irec_sim" / "config" / "cells" / f"{name}.yaml" for p in here.parents]
    for path in places:
        if path.is_file():
            return path
    raise SimError(f"cell '{name}': no such file, and no config/cells/{name}.yaml above {Path.cwd()} or {here.parent}")


def _station(data: dict[str, Any]) -> tuple[str, Array, Array]:
    return data["name"], np.array(data["xyz"], dtype=float), rotation_of_quaternion(np.array(data["quat_xyzw"]))


def read_cell(name: str | Path) -> CellFile:
    """Read a cell file, by path or name (`afp`, `milling`).

    Raises:
        SimError: file or key missing.
    """
    path = find_cell(str(name))
    try:
        data = read_yaml(path, "cell file")
        robot, tool, surface, loads = data["robot"], data["tool"], data["surface"], data["load_cases"]
        frame = rotation_of_quaternion(np.array(surface["quat_xyzw"])), np.array(surface["xyz"], dtype=float)
        shape: Patch | Block | Mesh
        if surface["kind"] == "patch":
            shape = Patch(tuple(surface["size"]), tuple(surface["radius"]), *frame)
        elif surface["kind"] == "block":
            shape = Block(tuple(surface["size"]), tuple(surface["faces"]), *frame)
        elif surface["kind"] == "mesh":
            local = read_mesh(path.parent / str(surface["file"])) * float(surface.get("scale", 1.0))
            triangles = local @ frame[0].T + frame[1]
            shape = Mesh(triangles[:, ::-1] if surface.get("flip") else triangles)
        else:
            raise SimError(f"{path}: surface.kind is '{surface['kind']}', must be patch, block or mesh")
        urdf = (path.parent / robot["urdf"]).resolve()
        rail = None
        if "rail" in robot:
            rail = np.array(robot["rail"]["axis"], dtype=float), tuple(robot["rail"]["range"])
        try:
            chain = read_urdf(urdf)
        except SimError as error:
            raise SimError(f"{path}: robot.urdf: {error}") from error
        if np.shape(robot["home"]) != (chain.n,):
            raise SimError(f"{path}: robot.home has {np.size(robot['home'])} values, the description {chain.n} joints")
        fx, fy, fz = loads["fx"], loads["fy"], loads["fz"]
        cases = np.array([[0, 0, -fz], [fx, 0, -fz], [-fx, 0, -fz], [0, -fy, -fz], [0, fy, -fz]], dtype=float)
        return CellFile(
            name=data["name"], path=path, chain=chain, urdf=urdf, serial=robot["serial"],
            home=np.array(robot["home"], dtype=float), rail=rail,
            marker_in_tool0=np.array(tool["marker_in_tool0"], dtype=float), pad_radius=float(tool["pad_radius"]), surface=shape,
            stations=tuple(_station(s) for s in data["stations"]),
            load_cases=cases, load_case_names=("normal", "N", "S", "E", "W"), friction=float(loads["friction"]),
            approach_distance=float(data["approach_distance"]), reference_distance=float(data["reference_distance"]),
            noise={k: float(v) for k, v in data["noise"].items()}, course=data.get("course", {}),
            sensor_axis=np.array(data.get("force_sensor", {}).get("axis_in_tool0", [0, 0, 1]), dtype=float),
            arm_radius=float(robot.get("arm_radius", 0.2)),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, OSError) as error:
        raise SimError(f"{path}: {type(error).__name__}: {error}; see config/cells/afp.yaml for what a cell states") from error
