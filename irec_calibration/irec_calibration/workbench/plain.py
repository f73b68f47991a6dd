# SPDX-License-Identifier: Apache-2.0
"""What passes between the worker that computes and the page that shows: plain data, arrays in m and base_link."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..typing import Array, IntArray


@dataclass(frozen=True)
class ParameterEntry:
    """One parameter as the list of effects shows it; se NaN where it is known only in a sum."""

    name: str
    value: float
    se: float
    unit: str
    lower: float
    upper: float
    identified: bool
    plausible: bool


@dataclass(frozen=True)
class EffectEntry:
    """One effect of a version; formula is empty for those of the catalogue."""

    id: str
    label: str
    physics: str
    formula: str
    parameters: tuple[ParameterEntry, ...]


@dataclass(frozen=True)
class Version:
    """A model on the session, m observed rows.

    Attributes:
        model: path of the model file.
        rows: indices of the observed rows in the session, (m,); measured, predicted, residual, held_out: (m, 3), m.
        sigma: noise of the norm of a row, (m,), m; noise_m: of a sample, m. As the session claims them until a diagnosis has
            inferred the noise.
    """

    name: str
    model: str
    effects: tuple[EffectEntry, ...]
    combinations: tuple[str, ...]
    rows: IntArray
    measured: Array
    predicted: Array
    residual: Array
    sigma: Array
    held_out: Array
    fit_rms_m: float
    cv_rms_m: float
    cv_rms_se_m: float
    noise_m: float
    repeat_m: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Tried:
    """An effect tried on top of a version; `exact` once it is refitted as `irec add` does, with a version to keep."""

    effect: str
    text: str
    model: str
    entry: EffectEntry
    residual: Array
    cv_rms_m: float
    cv_rms_se_m: float
    held_out: Array
    p_value: float
    sentence: str
    supported: bool
    exact: bool
    version: Version | None = None


@dataclass(frozen=True)
class SessionView:
    """A session for the screen, n rows; positions in the cell frame, m, which is base_link where nothing carries it.

    Attributes:
        joints: base, joint origins and TCP, (n, k + 2, 3); commanded: displacement of the TCP against the reference, (n, 3).
        columns: what samples can be coloured by, name -> (n,); joint angles in degrees; units: of each, "" for none.
        variables: what a formula may use here; effects: id -> label of everything known.
    """

    name: str
    kind: str
    serial: str
    pose: IntArray
    load_case: IntArray
    case_names: tuple[str, ...]
    repeat: IntArray
    stamp: Array
    joints: Array
    p_tcp: Array
    commanded: Array
    force: Array
    torque: Array
    tau: Array
    columns: dict[str, Array]
    units: dict[str, str]
    stations: dict[str, tuple[float, ...]]
    station: tuple[str, ...]
    claimed_noise: dict[str, float]
    notes: tuple[str, ...]
    n_joints: int
    variables: tuple[str, ...]
    effects: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class CourseView:
    """The process course as a version predicts it; lateral deviations (n,), m. `text`: what it says, or why there is none."""

    text: str
    s: Array
    without: Array
    before: Array
    se: Array
    tolerance: float


@dataclass(frozen=True)
class Codecs:
    """Growth of accuracy: version -> lower quartile, median, upper quartile over training poses, (3, n), mm; noise floor, mm."""

    quartiles: dict[str, Array]
    floor_mm: float
