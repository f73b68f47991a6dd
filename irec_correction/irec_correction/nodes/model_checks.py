# SPDX-License-Identifier: Apache-2.0
"""From a model file to what may come into force: read, checked against robot and tool, plausible, fast enough."""

from __future__ import annotations

import os
import stat
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.effects.production import production_scene
from irec_calibration.errors import IrecError
from irec_calibration.model import Model
from irec_calibration.model.file import file_sha256, load_model
from irec_calibration.model.plausibility import LARGEST_OFFSET, check_identity, check_plausible
from irec_calibration.recertification.store import Store, calibration_folder
from irec_calibration.robot import Payload, Robot
from irec_calibration.typing import Array

from ..deflection import Deflection
from ..errors import ActivationError, SettingsError

SHARE_OF_PERIOD = 0.5
EVALUATIONS = 30
# bytes: a model has some 10 kB; reading one stops the correction for 2 ms per kB at worst, and a driver holds an offset for 0.1 s
LARGEST_FILE = 64_000


@dataclass(frozen=True)
class Mounted:
    """What a model has to fit.

    Attributes:
        gravity: in base_link, m/s^2. payload: on tool0 beyond the robot description. period: of the correction, s.
        rail_name: of the external axis, as sessions name it.
        largest_offset: m, that its predictions may reach.
    """

    robot: Robot
    serial: str
    tool: str
    gravity: tuple[float, float, float]
    payload: Payload | None
    period: float
    largest_offset: float = LARGEST_OFFSET
    need_envelope: bool = True
    rail_name: str = "rail"


@dataclass(frozen=True)
class CheckedModel:
    """A model that may come into force.

    Attributes:
        sha256, modified: of its file, when it was read. largest_offset: that it predicts within its envelope, m.
        spent: time of an evaluation, s. doubts: about its values, a sentence each.
    """

    path: Path
    model: Model
    deflection: Deflection
    sha256: str
    modified: float
    largest_offset: float
    spent: float
    doubts: tuple[str, ...] = ()

    @property
    def caution(self) -> str:
        """What is to be thought of before it is used, by its file and by its values; empty where nothing."""
        return "; ".join(t for t in (*self.doubts, str(self.model.made.get("caution") or "")) if t)

    def changed(self) -> str:
        """What has become of the file since, empty where nothing."""
        try:
            same = self.path.stat().st_mtime == self.modified
        except OSError:
            return f"{self.path} has gone; the model in force is the one that was read from it"
        return "" if same else f"{self.path} was changed after it was put in force; the model in force is the one before that"


def read_checked(path: str | Path, mounted: Mounted) -> CheckedModel:
    """Read a model file and check all that can be checked without moving.

    Raises:
        IrecError: with file, value and limit; whatever is in the file.
    """
    path = Path(path)
    try:
        return _read_checked(path, mounted)
    except IrecError as error:
        raise ActivationError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    except Exception as error:  # a file can hold anything, and effects of users are evaluated
        raise ActivationError(f"{path}: not a model that can be used: {type(error).__name__}: {error}") from error


def calibration_in_force(cell_file: str, folder: str, serial: str) -> Path | None:
    """Model in force by the journal of the calibrations of a robot; None where none is in force yet.

    Args:
        folder: of the calibrations, relative to that of the cell file.

    Raises:
        IrecError: the journal, or a file of the calibration, is missing or was changed.
    """
    if not cell_file:
        raise SettingsError("parameter 'calibrations' needs parameter 'cell': it is a folder beside the cell file")
    found = Store(calibration_folder(cell_file, folder), serial).in_force()
    return None if found is None else found[1]


def _read_checked(path: Path, mounted: Mounted) -> CheckedModel:
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        raise ActivationError(f"{path}: can't read the model: {error}") from error
    if not stat.S_ISREG(found.st_mode):
        raise ActivationError(f"{path}: is not a file")
    if found.st_size > LARGEST_FILE:
        raise ActivationError(
            f"{path}: has {found.st_size} bytes; a model that is put in force has {LARGEST_FILE} at most, as reading a larger one"
            " would hold up the correction: is it a model? Its history may be left out of a copy"
        )
    digest = file_sha256(path)
    model = load_model(path)
    if file_sha256(path) != digest:
        raise ActivationError(f"{path}: was changed while it was read; try again")
    m = mounted
    check_identity(model, m.robot, m.serial, m.tool)
    deflection = Deflection(model, m.robot, m.gravity, m.payload, m.rail_name)

    def predict(q: Array, force: Array, torque: Array) -> Array:
        deflection.reset()
        return deflection(q, force, torque, m.period)[0]

    scene = production_scene(m.robot, np.asarray(m.gravity, dtype=float), m.payload, m.rail_name)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        plausible = check_plausible(
            model, m.robot, m.serial, scene, predict,
            tool=m.tool, largest_offset=m.largest_offset, need_envelope=m.need_envelope,
        )  # fmt: skip
    spent = _affordable(deflection, m.period)
    return CheckedModel(path, model, deflection, digest, found.st_mtime, plausible.largest_offset, spent, plausible.doubts)


def _affordable(deflection: Deflection, period: float) -> float:
    """Time of an evaluation, s. Raises ActivationError where all effects together take too long."""
    spent = _time_of(deflection)
    if spent > SHARE_OF_PERIOD * period:
        raise ActivationError(
            f"the model takes {spent * 1e3:.2f} ms per evaluation, half a period of {period * 1e3:.1f} ms is allowed;"
            " use a model without effects of your own, or a lower rate"
        )
    return spent


def _time_of(deflection: Deflection) -> float:
    q: Array = np.zeros(deflection.n_joints)
    spent = []
    for _ in range(EVALUATIONS):
        t = time.perf_counter()
        deflection(q, np.ones(3), np.ones(3), 0.004)
        spent.append(time.perf_counter() - t)
    deflection.reset()
    return float(np.median(spent))
