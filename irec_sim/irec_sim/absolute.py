# SPDX-License-Identifier: Apache-2.0
"""Absolute sessions: an arm under gravity alone, measured in many poses by a tracker whose place nobody knows exactly.

One row per pose and marker; the order of the poses is their order in time, and friction remembers the last step.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from .absolute_truth import AbsoluteTruth
from .errors import SimError
from .kinematics import Array, Chain, forward, quaternion_of_rotation, rotation_of_vector, skew
from .mishaps import Mishap
from .noise import TrueNoise, marker_noise
from .plant import Conditions, Frames, Plant
from .sensing import drift_at, motor_angles, tracker_reading
from .truth_catalogue import Physics

MISHAPS = ("jump", "angles_of_another_pose", "wrong_nest", "reseated_reflector")
_LOW = 0.08  # m, height that no part of the arm goes below


@dataclass(frozen=True)
class Setup:
    """What stands around the arm.

    Attributes:
        markers: on tool0, (k, 3), m; base_marker: on base_link, (3,), m, or None.
        p_station, R_station: true pose of the station; p_stated, R_stated: what the session says it is (a start value).
        markers_stated: likewise, (k, 3).
        no_efforts: the description states no torque limits (effort="0").
    """

    markers: Array
    base_marker: Array | None
    p_station: Array
    R_station: Array
    p_stated: Array
    R_stated: Array
    markers_stated: Array
    no_efforts: bool


@dataclass(frozen=True)
class AbsoluteMade:
    """A session before it is written: N poses, k markers (those on tool0, then that on the base).

    Attributes:
        q: reported, (N, n), rad; stamp: (N,), s; ambient: degC; p_tcp: physical TCP in base_link without drift, (N, 3), m.
        clean: markers in the frame of the station without noise, (N, k, 3), m; seen: with noise and mishaps.
        distance: (N, k), m; q_written: as the table has them.
    """

    truth: AbsoluteTruth
    setup: Setup
    noise: TrueNoise
    claim: dict[str, float]
    q: Array
    q_written: Array
    stamp: Array
    ambient: Array
    p_tcp: Array
    clean: Array
    seen: Array
    distance: Array
    mishaps: list[Mishap]
    robot_m: float


def draw_setup(chain: Chain, rng: np.random.Generator) -> Setup:
    """Station 2.5-5 m away, one to three markers, now and then one on the base."""
    size = float(np.linalg.norm(chain.p_fixed, axis=1).sum())
    markers = rng.normal(0.0, 0.06 if size < 1.8 else 0.12, (int(rng.choice([1, 2, 3], p=[0.5, 0.25, 0.25])), 3))
    base = np.array([*rng.uniform(-0.3, 0.3, 2), 0.05]) if rng.random() < 0.35 else None
    angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 4.0) + 0.5 * size
    p = np.array([away * np.cos(angle), away * np.sin(angle), rng.uniform(0.2, 1.5)])
    R = rotation_of_vector(rng.normal(0.0, [0.05, 0.05, 1.5]))
    return Setup(
        markers, base, p, R, p + rng.normal(0.0, 0.05, 3), R @ rotation_of_vector(rng.normal(0.0, 0.02, 3)),
        markers + rng.normal(0.0, 0.004, markers.shape), bool(rng.random() < 0.4),
    )  # fmt: skip


def draw_poses(chain: Chain, count: int, rng: np.random.Generator) -> Array:
    """Joint angles all over the range, nothing near the floor, in an order that somebody planned (neighbours) or at random."""
    lower, upper = np.maximum(chain.lower, -2.8) + 0.05, np.minimum(chain.upper, 2.8) - 0.05
    shoulder = chain.p_fixed[:3, 2].sum()
    low = _LOW if shoulder > 0.02 else _LOW - 0.35  # an arm whose base_link is its shoulder stands on something
    found: list[Array] = []
    for _ in range(40):
        q = rng.uniform(lower, upper, (4 * count, chain.n))
        pose = forward(chain, q)
        high = (pose.origin[:, -3:, 2] > low).all(axis=1) & (pose.p_tcp[:, 2] > low)
        clear = np.linalg.norm(pose.p_tcp[:, :2], axis=1) > 0.15
        found.append(q[high & clear])
        if sum(map(len, found)) >= count:
            break
    q = np.concatenate(found)[:count]
    if len(q) < count:
        raise SimError(f"only {len(q)} of {count} poses found above the floor")
    return q[np.argsort(np.round(q[:, 0] * 2) * 10 + q[:, 1])] if rng.random() < 0.5 else q


@dataclass(frozen=True)
class Rest:
    """Where an arm rests in each pose: motor angles (N, n), elastic coordinates (N, dof), configuration."""

    motor: Array
    e: Array
    frames: Frames


def at_rest(plant: Plant, physics: Physics, q: Array, near: Rest | None = None) -> Rest:
    """Equilibrium under gravity and hoses in each pose; friction points to where the joints came from.

    Args:
        near: a solution under nearly the same physics: the answer is then of first order in the difference.
    """
    step = np.diff(q, axis=0, prepend=q[:1])
    came = np.sign(step) * (np.abs(step) > 1e-6)
    motor = motor_angles(physics.sensing, q, step)
    # no process ever is on here, and hoses pull all the time
    idle = replace(Conditions.idle(len(q), q.shape[1]), process_on=np.ones(len(q), dtype=bool))
    if near is None:
        state = plant.relaxed(motor, idle, came)
        state, frames = plant.equilibrium(motor, idle, state, tolerance=1e-11)
        return Rest(motor, state.e, frames)
    frames = plant.frames(motor, near.e)
    state = plant.at_rest(frames, motor, idle, came)
    state, _ = plant.respond(frames, motor, idle, state, plant.compliance(motor, idle), 0.0)
    de = (state.e - near.e)[:, None]
    turn = (de @ plant.turns(frames))[:, 0]
    R = frames.R_tool + skew(turn) @ frames.R_tool
    return Rest(motor, state.e, replace(frames, p_tcp=frames.p_tcp + (de @ frames.lever)[:, 0], R_tool=R))


def markers_of(physics: Physics, setup: Setup, rest: Rest, stamp: Array, ambient: Array) -> Array:
    """Where the markers are in base_link, with drift, (N, k, 3), m."""
    drift = drift_at(physics.sensing, stamp, ambient)
    places = setup.markers + physics.sensing.marker_error
    on_tool = rest.frames.p_tcp[:, None] + np.einsum("nij,kj->nki", rest.frames.R_tool, places) + drift[:, None]
    if setup.base_marker is None:
        return on_tool
    moved = rest.e[:, :3] + np.cross(rest.e[:, 3:6], setup.base_marker)
    return np.concatenate([on_tool, (setup.base_marker + moved)[:, None]], axis=1)


def in_station(physics: Physics, setup: Setup, p: Array) -> Array:
    """Markers (N, k, 3) in the frame of the station, m."""
    N, k = p.shape[:2]
    shifted = np.repeat(np.arange(N) >= physics.sensing.shift_share * N, k)
    flat = tracker_reading(physics.sensing, p.reshape(-1, 3), 0, setup.p_station, setup.R_station, shifted)
    return flat.reshape(N, k, 3)


def generate_absolute(
    truth: AbsoluteTruth, setup: Setup, poses: int, noise: TrueNoise, claim: dict[str, float], robot_m: float,
    rng: np.random.Generator, mishap: str = "",
) -> AbsoluteMade:  # fmt: skip
    """Measure an arm; robot_m: how well it comes back to a pose, m per axis (in every marker of the pose alike)."""
    physics, chain = truth.physics(), truth.arm.chain
    plant = Plant(chain, physics.plant, whole=True)
    q = draw_poses(chain, poses, rng)
    stamp = np.cumsum(rng.uniform(8.0, 20.0, poses))
    ambient = 21.0 + np.sin(stamp / 2000.0 + rng.uniform(0, 6)) + 2e-4 * stamp
    rest = at_rest(plant, physics, q)
    p_tcp, markers = rest.frames.p_tcp, markers_of(physics, setup, rest, stamp, ambient)
    clean = in_station(physics, setup, markers)
    distance = np.linalg.norm(clean, axis=2)
    k = clean.shape[1]
    error = marker_noise(noise, np.repeat(stamp, k), np.zeros(poses * k, dtype=int), distance.ravel(), rng).reshape(clean.shape)
    again = rng.normal(0.0, robot_m, (poses, 1, 3)) * np.ones((1, k, 1))
    if setup.base_marker is not None:
        again[:, -1] = 0.0
    seen, q_written, found = clean + error + again, q.copy(), []
    if mishap:
        i = int(rng.integers(1, poses))
        away = rng.standard_normal(3)
        away /= np.linalg.norm(away)
        if mishap == "angles_of_another_pose":
            q_written[i], size = q[i - 1], 0.0
        elif mishap == "wrong_nest":
            size = float(rng.uniform(0.05, 0.3))
            seen[i, 0] += size * away
        elif mishap == "jump":
            size = float(rng.uniform(0.7e-3, 1.5e-3))
            seen[i, 0] += size * away
        else:  # from this pose on a reflector sits otherwise in its nest
            size = float(rng.uniform(0.6e-4, 1.5e-4))
            R = forward(chain, q).R_tool
            seen[i:, 0] += (R[i:] @ (size * away)) @ setup.R_station
        found = [Mishap(mishap, i + 1, (0,), 0, size)]
    return AbsoluteMade(
        truth, setup, noise, claim, q, q_written, stamp, ambient, p_tcp, clean, seen, distance, found, robot_m
    )  # fmt: skip


def write_absolute(made: AbsoluteMade, folder: Path, name: str) -> None:
    """Write session.yaml, samples.csv and robot.urdf into a new folder.

    Raises:
        SimError: the folder has files already.
    """
    if folder.exists() and any(folder.iterdir()):
        raise SimError(f"{folder}: exists and is not empty")
    folder.mkdir(parents=True, exist_ok=True)
    setup, arm = made.setup, made.truth.arm
    text = re.sub(r'effort="[^"]*"', 'effort="0"', arm.chain.text) if setup.no_efforts else arm.chain.text
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    names = [f"M{i + 1}" for i in range(len(setup.markers))]
    markers = [{"name": n, "link": "tool0", "xyz": p.tolist()} for n, p in zip(names, setup.markers_stated, strict=True)]
    if setup.base_marker is not None:
        names.append("B1")
        markers.append({"name": "B1", "link": "base_link", "xyz": setup.base_marker.tolist()})
    header = {
        "format": "irec-session/1", "name": name, "kind": "absolute",
        "robot": {"urdf": "robot.urdf", "serial": arm.name}, "markers": markers,
        "stations": [
            {"name": "A", "xyz": setup.p_stated.tolist(), "quat_xyzw": quaternion_of_rotation(setup.R_stated).tolist()}
        ],
        "payload": {"mass": arm.payload[0], "com": arm.payload[1].tolist()}, "inertials": "cad", "clock": "time",
        "noise": {**made.claim, "robot_m": made.robot_m},
    }  # fmt: skip
    (folder / "session.yaml").write_text(yaml.safe_dump(header, sort_keys=False), encoding="utf-8")
    with open(folder / "samples.csv", "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        joints = [f"joint_{k + 1}" for k in range(arm.chain.n)]
        writer.writerow(["pose", "stamp", *joints, "marker", "marker_x", "marker_y", "marker_z", "station", "temp_ambient"])
        for i, j in np.ndindex(made.seen.shape[:2]):
            row = [i + 1, f"{made.stamp[i]:.3f}", *(f"{v:.9f}" for v in made.q_written[i]), names[j]]
            writer.writerow([*row, *(f"{v:.8f}" for v in made.seen[i, j]), "A", f"{made.ambient[i]:.2f}"])


def write_truth_rows(made: AbsoluteMade, path: Path) -> None:
    """True displacement of the TCP against the nominal kinematics, and the nominal pose, from which a score can take out what
    no session tells: where the station stands (a motion of everything) and where the marker sits in the tool."""
    nominal = forward(made.truth.arm.chain, made.q)
    with open(path, "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        turn = [f"R_{i}{j}" for i in "xyz" for j in "xyz"]
        writer.writerow(["pose", "load_case", "repeat", *(f"deflection_{a}" for a in "xyz"), "tcp_x", "tcp_y", "tcp_z", *turn])
        for i, (p, n, R) in enumerate(zip(made.p_tcp, nominal.p_tcp, nominal.R_tool, strict=True)):
            row = [i + 1, 0, 0, *(f"{v:.9e}" for v in p - n), *(f"{v:.9f}" for v in n)]
            writer.writerow([*row, *(f"{v:.12f}" for v in R.ravel())])


def free_of_gauge(difference: Array, p: Array, R: Array) -> Array:
    """Differences of points (N, 3) less what a motion of everything and of the marker in the tool explains, m.

    Args:
        p, R: nominal TCP, (N, 3) and (N, 3, 3).
    """
    columns = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -skew(p), R], axis=2).reshape(-1, 9)
    flat = difference.reshape(-1)
    return (flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]).reshape(-1, 3)


def spoiled(made: AbsoluteMade) -> Array:
    """Rows (N, k) that a mishap spoils."""
    out = np.zeros(made.distance.shape, dtype=bool)
    for m in made.mishaps:
        if m.kind == "reseated_reflector":
            out[m.pose - 1 :, 0] = True
        else:
            out[m.pose - 1, slice(None) if m.kind == "angles_of_another_pose" else 0] = True
    return out
