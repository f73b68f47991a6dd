# SPDX-License-Identifier: Apache-2.0
"""Link lengths, axis offsets and joint zeros differ from the robot description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..robot.kinematics import cross_matrices
from ..typing import Array
from .base import Effect, Parameter
from .live import LeftOut
from .scene import Scene
from .state import ElasticResponse
from .station_pose import left_jacobian
from .traits import Cause, Family

# Largest of robots after their geometric calibration, RMS over the parameters of a fit; chosen: twice what was found of such
USUAL_M, USUAL_RAD = 0.6e-3, 0.6e-3
# Largest that is physically likely: a zero of a lost mastering, rad or m; a place, m, and a tilt, rad, of an axis. Chosen smaller
# where differences have to tell them, in a loaded session: larger ones were found there only where something else was missing.
ZERO, PLACE, TILT, PLACE_IN_DIFFERENCES, TILT_IN_DIFFERENCES = 0.1, 0.05, 0.05, 0.015, 0.012
# Prior of place and tilts of the last axis, of that of others, where differences have to tell them: a tool that is or stands
# elsewhere is another place of the marker, and what it makes of the force's direction is an error of the force sensor
LAST = 0.03
ORDER = [3, 0, 1, 2, 4, 5]  # of the parameters of a joint among translation, zero, tilts


class GeometryError(Effect):
    id = "geometry_error"
    label = "geometry error"
    physics = (
        "A joint's zero, the place of its axis or the axis' direction differ from the robot description: zero offset "
        "(zero_k), displacement (x_k, y_k, z_k) and tilt (tilt_ka, tilt_kb) in the frame that turns with the joint. Exact "
        "forward kinematics in absolute sessions, their derivative in loaded ones, where it shows in proportion to the "
        "commanded displacement, and in what springs do: they turn about other lines, under a force of another direction."
    )
    family = Family.ANGLE_ERROR
    chosen_by_poses = True
    cause = Cause.STATE
    usual_visible = 0.006  # chosen; of outside simulators, without a cause up to 0.4 %, with one 1.1 % and more
    usual_alone = 0.025  # chosen; links of a good robot leave less, whatever way a reference is away from its load cases
    usual_beside = 0.05  # chosen; what mended other causes on outside simulators was seen by 3 % at most, wrong links by 2 to 12
    needs = ("tracker",)
    in_readings = True
    moves_joints = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = []
        base = scene.kind == "absolute"
        low, high = (-np.inf, np.inf) if base else (-0.5, 0.5)
        place, tilt = (PLACE, TILT) if base else (PLACE_IN_DIFFERENCES, TILT_IN_DIFFERENCES)
        last = int(np.flatnonzero(scene.driven)[-1]) if scene.driven.any() else -1
        for k in range(scene.n_joints):
            group = f"axis {k + 1}"
            width = 1.0 if base or k != last else LAST
            slides = bool(scene.kin.is_prismatic[k])
            unit = "m" if slides else "rad"
            out.append(
                Parameter(
                    f"zero_{k + 1}", unit, 1e-3, low, high, plausible=(-ZERO, ZERO), group=group, flat=base, axis=k, first=True
                )
            )
            for a in "xyz":
                name = f"{a}_{k + 1}"
                out.append(
                    Parameter(name, "m", 1e-3, low, high, plausible=(-place, place), group=group, flat=base, width=width, axis=k)
                )
            for v in "ab":
                name = f"tilt_{k + 1}{v}"
                out.append(
                    Parameter(name, "rad", 1e-3, low, high, plausible=(-tilt, tilt), group=group, flat=base, width=width, axis=k)
                )
        return tuple(out)

    def displacement(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "loaded":
            return self.regressor(scene, theta) @ theta
        p = scene.p_observed
        for k, t, w in reversed(self._joint_changes(scene, theta)):
            p = self._moved(scene, k, p, t, w)
        return (p - scene.p_observed) * scene.moves_with_arm[:, None]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "loaded":
            springs = _by_geometry(scene)
            return self._first_order(scene) if springs is None else self._first_order(scene) + springs
        if not np.any(theta):
            return self._first_order(scene)
        n, nk = scene.q.shape
        p = scene.p_observed
        out = np.empty((n, 3, nk, 6))
        turns = np.empty((nk, n, 3, 3))  # of what is beyond a joint, by its change
        by_own = np.empty((nk, n, 3, 6))  # translation, then zero and tilts, as if no joint before it had changed
        axis, virtual = scene.arm.axis_in_joint, scene.kin.virtual_in_joint
        for k, t, w in reversed(self._joint_changes(scene, theta)):
            R = scene.kin.R_joint[:, k]
            E = Rotation.from_rotvec(w).as_matrix()
            turns[k] = R @ E @ np.swapaxes(R, 1, 2)
            turned = np.einsum("nji,nj->ni", R, p - scene.kin.origin[:, k]) @ E.T
            ways = left_jacobian(w) @ np.stack([axis[k], *virtual[k]], axis=1)
            by_own[k, :, :, :3] = R
            by_own[k, :, :, 3:] = R @ -(cross_matrices(turned).reshape(-1, 3) @ ways).reshape(n, 3, 3)
            if scene.kin.is_prismatic[k]:
                by_own[k, :, :, 3] = R @ axis[k]
            p = scene.kin.origin[:, k] + np.einsum("nij,nj->ni", R, turned + t)
        out[:, :, 0] = by_own[0][..., ORDER]
        for k in range(1, nk):  # what a joint does is turned by the changes of all before it
            out[:, :, k] = (turns[k - 1] @ by_own[k])[..., ORDER]
            turns[k] = turns[k - 1] @ turns[k]
        follow = _following(scene)
        if follow is not None:
            out[..., 0] = np.einsum("nik,nkl->nil", out[..., 0], follow)
        return out.reshape(n, 3, 6 * nk) * scene.moves_with_arm[:, None, None]

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        turned = [v for n, v in values.items() if n.startswith(("zero", "tilt"))]
        moved = [v for n, v in values.items() if not n.startswith(("zero", "tilt"))]
        return all(
            float(np.sqrt(np.mean(np.square(sizes)))) <= largest
            for sizes, largest in ((turned, USUAL_RAD), (moved, USUAL_M))
            if sizes
        )

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array | None:
        return None if change.by_geometry is None else np.einsum("nigp,g->nip", change.by_geometry, theta)

    def no_live_form(self) -> LeftOut:
        return LeftOut("does not depend on the process force itself; springs turn about the joints where it has them")

    def standing(self, scene: Scene, theta: Array) -> Scene:
        kin, p = scene.kin, scene.p_observed
        for k, t, w in reversed(self._joint_changes(scene, theta)):
            if np.any(t) or np.any(w):
                kin, moved = kin.changed(k, t, w, p)
                p = np.where(scene.moves_with_arm[:, None], moved, p)
        return scene.at(replace(scene.arm, kin=kin, p_tcp=kin.p_tcp), p, scene.tau_gravity)

    def _joint_changes(self, scene: Scene, theta: Array) -> list[tuple[int, Array, Array]]:
        """Joint, translation (3,) or (n, 3), rotation vector (3,) or (n, 3), in the frame that turns with it."""
        by_joint = theta.reshape(scene.n_joints, 6)
        zero = by_joint[:, 0]
        follow = _following(scene)
        if follow is not None:
            zero = follow.mean(axis=0) @ zero
        out = []
        for k in range(scene.n_joints):
            axis, (a, b) = scene.arm.axis_in_joint[k], scene.kin.virtual_in_joint[k]
            along = axis * zero[k]
            t, w = by_joint[k, 1:4].copy(), by_joint[k, 4] * a + by_joint[k, 5] * b
            if scene.kin.is_prismatic[k]:
                t += along
            else:
                w = w + along
            out.append((k, t, w))
        return out

    def _moved(self, scene: Scene, k: int, p: Array, t: Array, w: Array) -> Array:
        R, o = scene.kin.R_joint[:, k], scene.kin.origin[:, k]
        local = np.einsum("nji,nj->ni", R, p - o)
        return o + np.einsum("nij,nj->ni", R, local @ Rotation.from_rotvec(w).as_matrix().T + t)

    def _first_order(self, scene: Scene) -> Array:
        n, k = scene.q.shape
        out = np.empty((n, 3, k, 6))
        follow = _following(scene)
        J = scene.kin.jacobian(scene.p_observed) * scene.moves_with_arm[:, None, None]
        out[..., 0] = J if follow is None else np.einsum("nik,nkl->nil", J, follow)
        out[..., 1:4] = np.swapaxes(scene.kin.R_joint, 1, 2) * scene.moves_with_arm[:, None, None, None]
        out[..., 4:6] = scene.V.reshape(n, 3, k, 2)
        return out.reshape(n, 3, 6 * k)


def _by_geometry(scene: Scene) -> Array | None:
    return None if scene.elastic is None else scene.elastic.by_geometry


def _following(scene: Scene) -> Array | None:
    """How joints follow a zero offset: a coupled joint those that drive it, and its own, (n, k, k)."""
    return scene.arm.coupling
