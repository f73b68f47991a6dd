# SPDX-License-Identifier: Apache-2.0
"""The deflected arm: where axes, links, weights and tool are for given motor angles and elastic coordinates.

Each joint is three rotations in series, one about the actuated axis and two orthogonal to it, each of everything beyond it.
The two sit at a point of their own (`centre`). There may be six more degrees of freedom under base_link and six at the
tool's mount.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kinematics import Array, Chain, rotation_of_vector, skew
from .parameters import Hose, PlantParameters

GRAVITY = 9.81


def cross(a: Array, b: Array) -> Array:
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = ay * bz - az * by
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out


@dataclass(frozen=True)
class Frames:
    """Deflected configuration of n rows, in base_link.

    Attributes:
        p_tcp, R_tool: physical TCP, (n, 3) m and (n, 3, 3).
        axis: of each degree of freedom, (n, dof, 3); lever: its translational Jacobian at the TCP, (n, dof, 3).
        weight_torque: torque of the weights about each degree of freedom, (n, dof), N m (N for translations).
        p_attach, p_anchor: ends of the hoses where there are any, (n, 3), m (the anchor on the floor in the cell frame).
    """

    p_tcp: Array
    R_tool: Array
    axis: Array
    lever: Array
    weight_torque: Array
    p_attach: Array | None = None
    p_anchor: Array | None = None


class Skeleton:
    """Geometry of an elastic robot of n joints; degrees of freedom in order: base (6 if any), 3 per joint, tool (6 if any).

    Attributes:
        dof: how many; axial: those about the actuated axes, (n,); across: those orthogonal to them, (n, 2).
        turning: which are rotations, (dof,) bool.
    """

    def __init__(self, chain: Chain, parameters: PlantParameters, gravity: float, whole: bool) -> None:
        """gravity: m/s^2, along -z of base_link; whole: with base and tool even where they are rigid."""
        self.chain, self.parameters = chain, parameters
        par, n = parameters, chain.n
        self.has_base = bool(whole or np.any(par.base) or np.any(par.rail))
        self.has_tool = bool(whole or np.any(par.tool) or par.taper or np.any(par.flange_gap))
        self.has_base |= any(t.place == "base" for t in par.terms)
        self.has_tool |= any(t.place == "tool" for t in par.terms)
        b = 3 if self.has_base else 0
        eye = np.eye(3)
        fixed = [eye] * b
        local_axis = list(eye) if self.has_base else []
        R_fixed = chain.R_fixed @ rotation_of_vector(par.turn_error)
        for k in range(n):
            first = np.cross(chain.axis[k], eye[int(np.argmin(np.abs(chain.axis[k])))])
            first /= np.linalg.norm(first)
            fixed += [R_fixed[k], eye, eye]
            local_axis += [chain.axis[k], first, np.cross(chain.axis[k], first)]
        if self.has_tool:
            fixed += [chain.R_mount, eye, eye]
            local_axis += list(eye)
        self._local = np.array(local_axis)
        K = skew(self._local)
        self._A = np.array(fixed)
        self._B, self._C = self._A @ K, self._A @ K @ K
        self._p_fixed = chain.p_fixed + par.p_error
        self._b = b
        self._last = b + 2 + 3 * np.arange(n)  # rotation after which each link is reached
        self._axial_rotation = b + 3 * np.arange(n)
        # degrees of freedom: [base t, base r], joints, [tool t, tool r]
        j0 = 6 if self.has_base else 0
        self.dof = j0 + 3 * n + (6 if self.has_tool else 0)
        self.axial = j0 + 3 * np.arange(n)
        self._rotations = np.r_[np.arange(3, j0) if self.has_base else [], j0 + np.arange(3 * n)].astype(int)
        if self.has_tool:
            self._rotations = np.r_[self._rotations, self.dof - 3 + np.arange(3)]
        masses = np.r_[chain.mass, chain.tool_mass]
        self._weight = masses[:, None] * np.array([0.0, 0.0, -gravity])  # (n + 1, 3)
        self._weight_beyond = self._weight[::-1].cumsum(axis=0)[::-1]
        owner = np.r_[np.zeros(j0), np.repeat(np.arange(n), 3), np.full(6 if self.has_tool else 0, n)].astype(int)
        self._owner = owner
        self._weight_owned = self._weight_beyond[owner]
        self.across = j0 + 3 * np.arange(n)[:, None] + np.array([1, 2])
        self.turning = np.ones(self.dof, dtype=bool)
        self.turning[: 3 if self.has_base else 0] = False
        if self.has_tool:
            self.turning[-6:-3] = False
        self._centred = not np.any(par.centre)

    def frames(self, q: Array, e: Array) -> Frames:
        """Deflected configuration at motor angles q (n, joints) and elastic coordinates e (n, dof)."""
        chain, n = self.chain, len(q)
        angle = e[:, self._rotations]
        angle[:, self._axial_rotation] += q + self.parameters.joint_zero
        local = np.sin(angle)[..., None, None] * self._B
        local += (1.0 - np.cos(angle))[..., None, None] * self._C
        local += self._A
        G = np.empty_like(local)
        R = local[:, 0]
        G[:, 0] = R
        for i in range(1, local.shape[1]):
            R = np.matmul(R, local[:, i], out=G[:, i])
        axis_of_rotation = (G @ self._local[:, :, None])[..., 0]
        R_link = G[:, self._last]
        R_before = np.empty_like(R_link)
        R_before[:, 0] = G[:, 2] if self._b else np.eye(3)
        R_before[:, 1:] = R_link[:, :-1]
        origin = (R_before @ self._p_fixed[:, :, None])[..., 0]
        if self.has_base:
            origin[:, 0] += e[:, :3]
        p_link, across = origin, origin
        if not self._centred:  # links bend about points off the joints' origins
            arm = (G[:, self._axial_rotation] @ self.parameters.centre[:, :, None])[..., 0]
            shift = arm - (R_link @ self.parameters.centre[:, :, None])[..., 0]
            origin[:, 1:] += shift[:, :-1]
            origin = origin.cumsum(axis=1)
            p_link, across = origin + shift, origin + arm
        else:
            p_link = across = origin = origin.cumsum(axis=1)
        com = np.empty((n, chain.n + 1, 3))
        com[:, :-1] = p_link + (R_link @ chain.com[:, :, None])[..., 0]
        p_mount = p_link[:, -1] + R_link[:, -1] @ chain.p_mount
        R_mount0 = R_link[:, -1] @ chain.R_mount
        if self.has_tool:
            p_mount = p_mount + (R_mount0 @ e[:, -6:-3, None])[..., 0]
            R_mount = G[:, -1]
        else:
            R_mount = R_mount0
        com[:, -1] = p_mount + R_mount @ chain.tool_com
        p_tcp = p_mount + R_mount @ chain.p_tcp
        moment = cross(com, self._weight)
        moment_beyond = moment[:, ::-1].cumsum(axis=1)[:, ::-1]
        axis = np.empty((n, self.dof, 3))
        center = np.empty((n, self.dof, 3))
        axis[:, self._rotations] = axis_of_rotation
        j0 = 6 if self.has_base else 0
        center[:, j0 : j0 + 3 * chain.n] = np.repeat(across, 3, axis=1)
        center[:, self.axial] = origin
        if self.has_base:
            axis[:, :3] = np.eye(3)
            center[:, :6] = e[:, None, :3]
        if self.has_tool:
            axis[:, -6:-3] = R_mount0.swapaxes(1, 2)
            center[:, -6:] = p_mount[:, None]
        about_base = cross(axis, center)
        lever = axis @ skew(p_tcp) - about_base
        torque = (axis * moment_beyond[:, self._owner]).sum(axis=2) - (about_base * self._weight_owned).sum(axis=2)
        if self.has_base:
            lever[:, :3] = axis[:, :3]
            torque[:, :3] = axis[:, :3] @ self._weight_beyond[0]
        if self.has_tool:
            lever[:, -6:-3] = axis[:, -6:-3]
            torque[:, -6:-3] = axis[:, -6:-3] @ self._weight_beyond[-1]
        hose, attach, anchor = self.parameters.hose, None, None
        if hose is not None:
            attach = p_mount + R_mount @ hose.attach
            anchor = p_link[:, hose.link - 1] + R_link[:, hose.link - 1] @ hose.anchor if hose.link else hose.anchor
        return Frames(p_tcp, R_mount @ chain.R_tcp, axis, lever, torque, attach, anchor)

    def turns(self, frames: Frames) -> Array:
        """Rotation of the tool per degree of freedom, (n, dof, 3): its axis, nothing for translations."""
        out = frames.axis.copy()
        if self.has_base:
            out[:, :3] = 0.0
        if self.has_tool:
            out[:, -6:-3] = 0.0
        return out

    def hose_torque(
        self, hose: Hose, frames: Frames, on: Array, base_in_cell: Array | None, q: Array
    ) -> Array:  # fmt: skip
        """Torque of hoses about each degree of freedom, (n, dof), N m; on: rows with pressure; base_in_cell: (n, 3), m."""
        if frames.p_attach is None or frames.p_anchor is None:
            return np.zeros((len(q), self.dof))
        attach, anchor = frames.p_attach, frames.p_anchor
        if not hose.link and base_in_cell is not None:
            anchor = anchor - base_in_cell
        way = anchor - attach
        length = np.linalg.norm(way, axis=1)
        tension = hose.tension * np.exp(np.clip((length - hose.reach) / hose.stretch, -2.0, 2.0))
        tension = tension * (1.0 + np.sin(q[:, [-3, -1]]) @ hose.wrist) * on
        pull = way * (tension / length)[:, None]
        torque = (frames.lever @ pull[:, :, None])[..., 0]
        torque += (frames.axis @ cross(attach - frames.p_tcp, pull)[:, :, None])[..., 0] * self.turning
        if hose.link:  # the link that holds the other end is pulled towards the tool
            below = self._owner < hose.link
            held = (frames.lever @ pull[:, :, None])[..., 0]
            held += (frames.axis @ cross(anchor - frames.p_tcp, pull)[:, :, None])[..., 0] * self.turning
            torque -= held * below
        return torque
