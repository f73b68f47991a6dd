# SPDX-License-Identifier: Apache-2.0
"""Structural modes of arm and head at a posture, and oscillators that follow them.

M e'' + D e' + K e = J^T F - M B q_m'', with e the elastic coordinates of the plant, M from the masses of the description, K from
the compliances, q_m the motion of the motors (an offset moves them). In modes: eta'' + 2 zeta w eta' + w^2 eta =
phi^T (J^T F - M B q_m'').
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cellfile import CellFile
from ..errors import SimError
from ..kinematics import Array, rotation
from ..plant import Conditions, Plant
from .hard import Modes

_RIGID = 1e-12  # rad/(N m) or m/N, below which a degree of freedom can't be part of a mode


@dataclass(frozen=True)
class ModalForm:
    """m modes of n rows.

    Attributes:
        omega: rad/s, (n, m); at_tcp: translation of the TCP per mode, (n, m, 3), mass-normalised; by_motor: phi^T M
        B, (n, m, joints). axial: windup of each gear per mode, (n, m, joints).
    """

    omega: Array
    at_tcp: Array
    by_motor: Array
    axial: Array


def mass_matrix(plant: Plant, q: Array, gyration: Array) -> Array:
    """M of the elastic coordinates at motor angles q (n, joints), (n, dof, dof), kg m^2 (kg for translations).

    gyration: as `Modes.gyration`. Raises SimError where there is not one row for each link and one for the tool.
    """
    if np.shape(gyration) != (plant.chain.n + 1, 3):
        raise SimError(
            f"modes: gyration has shape {np.shape(gyration)}; it takes three radii (m) for each of the {plant.chain.n} links "
            "and for the tool"
        )
    chain, rows = plant.chain, len(q)
    frames = plant.frames(q, np.zeros((rows, plant.dof)))
    (com, turned_by), j0 = _bodies(plant, q), 6 if plant.has_base else 0
    owner = np.r_[np.zeros(j0), np.repeat(np.arange(chain.n), 3), np.full(6 if plant.has_tool else 0, chain.n)].astype(int)
    turns = plant.turns(frames)
    mass = np.r_[chain.mass, chain.tool_mass]
    M = np.zeros((rows, plant.dof, plant.dof))
    for k in range(chain.n + 1):
        carried = (owner <= k)[None, :, None]
        moved = (frames.lever + np.cross(turns, (com[:, k] - frames.p_tcp)[:, None, :])) * carried
        turned = (turns * carried) @ turned_by[:, k] * gyration[k]  # in the axes of the body
        M += mass[k] * (moved @ moved.swapaxes(1, 2) + turned @ turned.swapaxes(1, 2))
    return M


def _bodies(plant: Plant, q: Array) -> tuple[Array, Array]:
    """Centres of mass of the links and the tool in base_link, (n, joints + 1, 3), m, and their frames, (n, joints + 1, 3, 3)."""
    chain = plant.chain
    local = chain.R_fixed @ rotation(chain.axis, q)
    R, p = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    centres, frames = [], []
    for k in range(chain.n):
        p = p + R @ chain.p_fixed[k]
        R = R @ local[:, k]
        centres.append(p + R @ chain.com[k])
        frames.append(R)
    centres.append(p + R @ chain.p_mount + R @ chain.R_mount @ chain.tool_com)
    return np.stack(centres, axis=1), np.stack([*frames, R @ chain.R_mount], axis=1)


def modes_at(plant: Plant, q: Array, settings: Modes, count: int | None = None) -> ModalForm:
    """Modes at postures q (n, joints); as many as the row with most of them has below `highest`."""
    frames = plant.frames(q, np.zeros((len(q), plant.dof)))
    M = mass_matrix(plant, q, np.array(settings.gyration))
    c = np.broadcast_to(plant.compliance(q, Conditions.idle(len(q), plant.chain.n)), (len(q), plant.dof))
    soft = np.flatnonzero(c.min(axis=0) > _RIGID)
    n = len(soft)
    forms = []
    for i in range(len(q)):
        root = 1.0 / np.sqrt(c[i, soft])
        Ms = M[i][np.ix_(soft, soft)]
        # K phi = w^2 M phi with K diagonal: the eigenvalues of K^-1/2 M K^-1/2 are 1 / w^2
        inverse_square, V = np.linalg.eigh(Ms / np.outer(root, root))
        omega = 1.0 / np.sqrt(np.maximum(inverse_square[::-1], 1e-12))
        phi = (V[:, ::-1] / root[:, None]) * omega  # phi^T M phi = 1
        whole = np.zeros((plant.dof, n))
        whole[soft] = phi
        by_motor = phi.T @ M[i][np.ix_(soft, plant.axial)]
        forms.append((omega, phi.T @ frames.lever[i, soft], by_motor, whole[plant.axial].T))
    omega = np.array([f[0] for f in forms])
    m = count or max(1, int((omega < 2.0 * np.pi * settings.highest).sum(axis=1).max()))
    m = min(m, n)
    return ModalForm(omega[:, :m], *(np.array([f[k][:m] for f in forms]) for k in (1, 2, 3)))


class FollowedModes:
    """Modes along the courses: computed at some postures of each, each mode followed from one to the next."""

    def __init__(self, plant: Plant, q: Array, settings: Modes, knots: int = 9) -> None:
        """q: of all courses over all steps, (steps, rows, joints)."""
        self._at = np.unique(np.linspace(0, len(q) - 1, knots).astype(int))
        forms: list[ModalForm] = []
        for k in self._at:
            form = modes_at(plant, q[k], settings, forms[0].omega.shape[1] if forms else None)
            forms.append(_followed(forms[-1], form) if forms else form)
        self._omega = np.array([f.omega for f in forms])
        self._tcp = np.array([f.at_tcp for f in forms])
        self._motor = np.array([f.by_motor for f in forms])
        self._axial = np.array([f.axial for f in forms])

    @property
    def hertz(self) -> Array:
        """Frequencies at the postures that were computed, (knots, rows, modes), Hz."""
        return self._omega / (2.0 * np.pi)

    def at(self, step: int) -> ModalForm:
        """Modes of all rows at a step, between the postures linear."""
        i = int(np.clip(np.searchsorted(self._at, step, side="right") - 1, 0, len(self._at) - 2))
        u = (step - self._at[i]) / (self._at[i + 1] - self._at[i])
        return ModalForm(*((1.0 - u) * x[i] + u * x[i + 1] for x in (self._omega, self._tcp, self._motor, self._axial)))


def _followed(before: ModalForm, now: ModalForm) -> ModalForm:
    """`now` with modes in the order and the sense in which they were before."""
    shape = np.concatenate([now.at_tcp, 0.1 * now.by_motor], axis=2)
    old = np.concatenate([before.at_tcp, 0.1 * before.by_motor], axis=2)
    norm = np.linalg.norm(shape, axis=2)[:, None, :] * np.linalg.norm(old, axis=2)[:, :, None]
    alike = old @ shape.swapaxes(1, 2) / np.maximum(norm, 1e-12)
    order, sign = np.zeros(now.omega.shape, dtype=int), np.ones(now.omega.shape)
    for row in range(len(alike)):
        left = np.abs(alike[row]).copy()
        for _ in range(left.shape[0]):
            a, b = np.unravel_index(int(np.argmax(left)), left.shape)
            order[row, a], sign[row, a] = b, 1.0 if alike[row, a, b] >= 0.0 else -1.0
            left[a, :] = left[:, b] = -1.0
    rows = np.arange(len(alike))[:, None]
    return ModalForm(
        now.omega[rows, order],
        *(x[rows, order] * sign[..., None] for x in (now.at_tcp, now.by_motor, now.axial)),
    )


class Oscillators:
    """State of all modes of all rows; one step is exact for a forcing that is constant over it."""

    def __init__(self, rows: int, modes: int, damping: tuple[float, ...]) -> None:
        zeta = np.array([damping[min(i, len(damping) - 1)] for i in range(modes)])
        self._zeta = np.broadcast_to(zeta, (rows, modes))
        self.eta, self._rate = np.zeros((rows, modes)), np.zeros((rows, modes))

    def step(self, omega: Array, forcing: Array, dt: float) -> None:
        """omega: rad/s; forcing: phi^T (...), both (rows, modes)."""
        rest = forcing / omega**2
        x, v = self.eta - rest, self._rate
        decay, turn = self._zeta * omega, omega * np.sqrt(1.0 - self._zeta**2)
        e, c, s = np.exp(-decay * dt), np.cos(turn * dt), np.sin(turn * dt)
        self.eta = rest + e * (x * c + (v + decay * x) / turn * s)
        self._rate = e * (v * c - (decay * v + omega**2 * x) / turn * s)


def modes_of_cell(cell: CellFile, plant: Plant, settings: Modes, q: Array) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping of each mode at one posture (joints,)."""
    form = modes_at(plant, q[None], settings)
    zeta = settings.damping
    return [(float(w / (2.0 * np.pi)), zeta[min(i, len(zeta) - 1)]) for i, w in enumerate(form.omega[0])]
