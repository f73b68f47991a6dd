# SPDX-License-Identifier: Apache-2.0
"""A first cell file from what an integrator knows on the first day; everything in it can be changed by hand afterwards."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from ..cell.mesh import facing_share, read_mesh
from ..cell.surface import LARGEST, Block, MeshSurface, Patch, Surface
from ..errors import CellError, PlanError
from ..files import read_text, write_file
from ..robot import Robot
from ..typing import Array
from .ik import Chain, solve_tool_axis, wrap_into_limits

GRAVITY = 9.81
MILLIMETRES = 20.0  # an extent beyond this many metres is one in millimetres


@dataclass(frozen=True)
class Facts:
    """What was stated. m, rad, N, kg; positions in the cell frame (base_link, rail at 0).

    surface: yaml lines of the surface section without its pose; surface_at: xyz, quat_xyzw.
    rail: axis and range, or None. stations: name, xyz, quat_xyzw. payload_limit: rated load of the robot, kg.
    """

    name: str
    serial: str
    urdf: str
    robot: Robot
    surface: str
    surface_xyz: tuple[float, float, float]
    surface_quat: tuple[float, float, float, float]
    shape: Surface
    stations: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]
    marker: tuple[float, float, float]
    rail: tuple[tuple[float, ...], tuple[float, ...]] | None
    sensor_range: float
    sensor_frame: str
    payload_limit: float
    friction: float
    home: Array | None
    joint_names: tuple[str, ...]


def mesh_section(
    path: Path, relative: str, R: Array, p: Array, stations: Array, scale: float | None
) -> tuple[str, Surface, list[str]]:
    """The surface section for a mesh file, the surface, and what was recognised: unit and side of the normals.

    Raises PlanError: not a mesh.
    """
    notes = []
    extent = float(np.ptp(read_mesh(path)[0], axis=0).max())
    if scale is None:
        scale = 0.001 if extent > MILLIMETRES else 1.0
        if scale != 1.0:
            notes.append(f"{path}: {extent:.4g} units large, taken as millimetres (scale: 0.001); --scale states another")
    flip = False
    try:
        surface = MeshSurface.from_file(path, R, p, scale)
    except PlanError as error:
        if "point inwards" not in str(error):
            raise
        flip, surface = True, MeshSurface.from_file(path, R, p, scale, True)
        notes.append(f"{path}: the normals of the closed mesh point inwards; turned round (flip: true)")
    outward, inward = facing_share(surface.mesh(), stations)
    if not flip and outward < 0.02 < inward:
        flip, surface = True, MeshSurface.from_file(path, R, p, scale, True)
        notes.append(f"{path}: the normals point away from every station; turned round (flip: true)")
    lines = (
        f"  kind: mesh\n  file: {relative}\n  scale: {scale:g}                                   # metres per unit of the file\n"
    )
    return lines + f"  flip: {str(flip).lower()}                                      # turn the normals round\n", surface, notes


def mesh_of_points(table: Path, target: Path, towards: Array) -> tuple[int, list[str]]:
    """Triangles through probed points (x, y, z per line, base_link) into an OBJ file, normals towards a point (3,).

    Returns the number of points and what was recognised. Raises CellError: fewer than 4, or all in a line.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(table, "table of probed points", CellError).splitlines(), 1):
        words = line.replace(";", ",").replace(",", " ").split("#")[0].split()
        if not words:
            continue
        try:
            values = [float(w) for w in words[:3]]
        except ValueError:
            if rows:
                raise CellError(f"{table}:{number}: {line.strip()[:60]!r} is not x, y, z") from None
            continue  # a header line
        if len(values) < 3 or not all(map(math.isfinite, values)):
            raise CellError(f"{table}:{number}: {line.strip()[:60]!r} is not x, y, z")
        rows.append(values)
    points = np.unique(np.array(rows, dtype=float).reshape(-1, 3), axis=0)
    if len(points) < 4:
        raise CellError(f"{table}: {len(points)} points were probed; at least 4 are needed, better 20, spread over the surface")
    notes = []
    if float(np.ptp(points, axis=0).max()) > MILLIMETRES:
        points = points / 1000.0
        notes.append(f"{table}: taken as millimetres")
    if float(np.ptp(points, axis=0).max()) > LARGEST:
        raise CellError(f"{table}: the points are {np.ptp(points, axis=0).max():.4g} m apart, at most {LARGEST:g} m make sense")
    centre = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - centre, full_matrices=False)
    if size[1] < 1e-3 * size[0]:
        raise CellError(f"{table}: the points lie on a line; probe some beside it")
    triangles = Delaunay((points - centre) @ axes[:2].T).simplices
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    side = np.sign(normal @ axes[2]) * np.sign((towards - centre) @ axes[2])
    triangles = np.where(side[:, None] < 0, triangles[:, ::-1], triangles)
    text = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points) + "".join(
        f"f {i + 1} {j + 1} {k + 1}\n" for i, j, k in triangles
    )
    write_file(target, text, error=CellError)
    return len(points), notes


def shape_of(kind: str, size: list[float], R: Array, p: Array, radius: list[float], faces: list[str]) -> tuple[str, Surface]:
    """The surface section for a patch or a block, and the surface."""
    if kind == "patch":
        lines = f"  kind: patch\n  size: {size[:2]}                              # along local x and y\n  radius: {radius}\n"
        return lines, Patch((size[0], size[1]), (radius[0], radius[1]), R, p)
    lines = f"  kind: block\n  size: {size}                         # along local x, y, z\n  faces: [{', '.join(faces)}]\n"
    return lines, Block((size[0], size[1], size[2]), tuple(faces), R, p)


def find_home(robot: Robot, shape: Surface, rail: tuple[tuple[float, ...], tuple[float, ...]] | None, seed: int = 1) -> Array:
    """Joint angles with the tool over the middle of the surface, 0.25 m off, away from limits and singularities.

    Raises CellError: the robot does not reach it.
    """
    rng = np.random.default_rng(seed)
    points = shape.sample(200, rng)
    centre = points.p.mean(axis=0)
    order = np.argsort(np.linalg.norm(points.p - centre, axis=1))[:20]
    chain = Chain.of(robot)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    which = np.repeat(order, 60)
    wanted = points.p[which] + 0.25 * points.normal[which]
    if rail is not None:
        axis = np.array(rail[0]) / np.linalg.norm(rail[0])
        wanted = wanted - np.clip(wanted @ axis, rail[1][0], rail[1][1])[:, None] * axis
    start = rng.uniform(lower, upper, (len(which), robot.n_joints))
    q, reached = solve_tool_axis(chain, wanted, -points.normal[which], start)
    q = wrap_into_limits(q, robot.lower, robot.upper, chain.is_prismatic)
    reached &= ((q > robot.lower + 0.1) & (q < robot.upper - 0.1)).all(axis=1)
    if not reached.any():
        where = np.round(centre, 3).tolist()
        raise CellError(
            f"the robot reaches nothing 0.25 m over the middle of the surface {where} (base_link, m), tool along the normal;"
            " move the surface (--surface-xyz, --surface-rpy), check its unit, or give --home"
        )
    J = chain.forward(q[reached])[2]
    span = np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 2 * np.pi)
    middle = np.where(np.isfinite(robot.upper + robot.lower), 0.5 * (robot.upper + robot.lower), 0.0)
    centred = 1.0 - (np.abs(q[reached] - middle) / (0.5 * span)).max(axis=1)
    height = chain_heights(robot, q[reached])
    score = np.linalg.svd(J, compute_uv=False)[:, -1] * np.sqrt(np.maximum(centred, 0.0)) * (height > 0.0)
    return np.asarray(np.round(q[reached][int(np.argmax(score))], 4))


def chain_heights(robot: Robot, q: Array) -> Array:
    """Height of the lowest joint beyond the shoulder over the base, (n,), m."""
    origin = robot.kinematics(q).origin
    return np.asarray(origin[:, min(2, robot.n_joints - 1) :, 2].min(axis=1))


def cell_text(f: Facts) -> str:
    """The commented cell file."""
    home = f.home if f.home is not None else find_home(f.robot, f.shape, f.rail)
    kin = f.robot.kinematics(home[None])
    tool = float(np.linalg.norm(kin.p_tcp[0] - kin.origin[0, -1]))
    tool = max(tool, 0.1)
    reach = float(np.linalg.norm(np.diff(kin.origin[0], axis=0), axis=1).sum() + tool)
    arm = round(min(max(0.06 * reach, 0.05), 0.2), 3)
    fz = round(min(0.6 * f.sensor_range, 0.8 * f.payload_limit * GRAVITY), 0)
    friction, safety = f.friction, 1.5
    lateral = math.floor(0.9 * fz * friction / safety)
    abort = math.ceil(1.45 * math.hypot(fz, lateral))
    mesh = f.shape.mesh()
    base = np.zeros((2, 3))
    if f.rail is not None:
        base = np.outer(f.rail[1], np.array(f.rail[0]) / np.linalg.norm(f.rail[0]))
    around = np.vstack([mesh.vertices, kin.p_tcp[0] + base])
    lower, upper = np.round(around.min(axis=0) - 0.4, 2).tolist(), np.round(around.max(axis=0) + 0.4, 2).tolist()
    behind, size = abs(f.marker[2]), max(tool / 0.45, 0.25)  # spheres that widen towards the wrist and leave the marker free
    hull = [[0.0, 0.0, round(-behind - size * d, 3), round(0.57 * size * d, 3)] for d in (0.07, 0.17, 0.32)]
    rail = ""
    if f.rail is not None:
        rail = f"  rail: {{axis: {list(f.rail[0])}, range: {list(f.rail[1])}}}      # carries base_link\n"
    names = f"  joint_names: [{', '.join(f.joint_names)}]   # in ROS topics\n" if f.joint_names else ""
    stations = "".join(f"  - {{name: {n}, xyz: {list(p)}, quat_xyzw: {list(q)}}}\n" for n, p, q in f.stations)
    return f"""\
# Cell file of irec. SI units: m, rad, N, kg, s. Frame: base_link{" with the rail at 0" if f.rail else ""}.
# tool0 z points out of the tool to the surface; forces are what the environment exerts on the robot.
# irec check FILE says what is wrong, irec show-cell FILE draws it.
format: irec-cell/1
name: {f.name}
robot:
  urdf: {f.urdf}
  serial: {f.serial!r}
  home: {[float(v) for v in home]}      # over the surface, clear of it
{names}  arm_radius: {arm}                                 # of the links, for line of sight and clearance
{rail}tool:
  payload: {{mass: 0.0, com: [0.0, 0.0, 0.0]}}       # kg and m, beyond what the description states; it is weighed: CHECK
  marker_in_tool0: {list(f.marker)}
  pad_radius: 0.02                                 # contact pad: all of it has to touch: CHECK
  clearance: 0.01
  hull:                                            # spheres that contain tool and wrist: CHECK with irec show-cell
{"".join(f"    - {h}" + chr(10) for h in hull)}surface:
{f.surface}  xyz: {list(f.surface_xyz)}
  quat_xyzw: {list(f.surface_quat)}
stations:                                          # quat_xyzw: of the station's frame, from its registration
{stations}load_cases:                                        # fz: 0.6 of the sensor's range, at most 0.8 of the rated load
  fx: {lateral:.1f}
  fy: {lateral:.1f}
  fz: {fz:.1f}
  friction: {friction:g}                                    # of the pad on the surface: CHECK
  friction_safety: {safety:g}
approach_distance: 0.1
reference_distance: 0.003
limits:
  continuous_torque: 0.8                           # share of the effort limits of the description
  joint_margin: 0.05
  singularity: 0.03
noise:                                             # data sheets, one standard deviation: CHECK
  tracker_m: 7.5e-6
  tracker_m_per_m: 3.0e-6
  force_n: {max(0.02, round(0.001 * fz, 3)):g}
  settling_m: 2.0e-6
tolerance_m: 3.0e-4
poses: {f.name}_poses.yaml                         # irec plan writes it
force_sensor:
  frame: {f.sensor_frame}
  axis_in_tool0: [0.0, 0.0, 1.0]
  range_n: {f.sensor_range:g}
procedure:
  home_speed: 0.3
  linear_speed: 0.1
  window_s: 0.4
  settling:
    force_n: {max(0.5, round(0.014 * fz, 2)):g}
    force_drift_n: {max(0.2, round(0.0046 * fz, 2)):g}
    marker_drift_m: 6.0e-6
    marker_std_m: 6.0e-5
    slip_m: 2.0e-3
  min_samples: 20
  force_abort_n: {abort:.1f}
  repeats: 1
  timeouts: {{home: 60.0, approach: 60.0, advance: 20.0, reference: 15.0, force_mode: 5.0, establish: 15.0, settle: 15.0,
             position_mode: 5.0, retract: 20.0}}
  skip_limit: 0.25
workspace:                                         # box for the TCP; no move is asked for outside
  lower: {lower}
  upper: {upper}
acceptance:
  min_poses: 12
  held_out_share: 0.3
  held_out_rms_m: 1.0e-4
  max_ratio_to_old: 1.05
  max_noise_floors: 6.0
"""


def quaternion(rpy_degrees: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """x, y, z, w of turns about fixed x, y, z."""
    x, y, z, w = np.round(Rotation.from_euler("xyz", rpy_degrees, degrees=True).as_quat(), 9).tolist()
    return float(x), float(y), float(z), float(w)
