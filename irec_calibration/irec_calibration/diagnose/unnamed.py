# SPDX-License-Identifier: Apache-2.0
"""Causes without a name: the residual as a smooth function of one variable, along physical directions.

They compete with the catalogue. Where one of them explains what no effect does, the answer is "unexplained", and its
variable is what the residual depends on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from ..typing import Array
from .candidates import supported
from .evidence import Block, Posterior
from .study import Study

DEGREE = 3
FACTORS = np.array([0.5, 3.0])  # of the prior widths
TYPICAL_DISPLACEMENT = 3e-5  # m; what a parameter of scale 1 moves
LEVER = 0.01  # m; by which a force typically acts beside the TCP
MODULATION = 0.1  # typical relative change of a spring
DEPENDS_ON_AT_MOST = 4


@dataclass(frozen=True)
class Unnamed:
    """One structure without a name.

    Attributes:
        variables: session columns or `tau_k` that it depends on, the one that shapes it first.
        frame: along what it acts, in words.
        block: its columns.
        posterior, log_evidence: on top of the model, relative to the model alone.
        tried: how many of its kind were tried.
    """

    variables: tuple[str, ...]
    frame: str
    block: Block
    posterior: Posterior
    log_evidence: float
    tried: int = 1


def varying(study: Study) -> dict[str, Array]:
    """Variables of a session that are there in every row and vary, name -> (n,)."""
    scene = study.ready
    loaded = study.observation.rows
    table: dict[str, Array] = {}
    if scene.clock == "time":
        table["stamp"] = scene.stamp
    table |= {f"temp_{n}": v for n, v in scene.temperature.items()}
    table |= {f"ext_{n}": v for n, v in scene.ext.items()}
    table |= {f"joint_{k + 1}": scene.q[:, k] for k in range(scene.n_joints)}
    table |= {f"tau_{k + 1}": scene.tau[:, k] for k in range(scene.n_joints)}
    table |= {f"force_{a}": scene.force_in_tool[:, i] for i, a in enumerate("xyz")}
    return {
        name: values
        for name, values in table.items()
        if np.isfinite(values).all() and np.ptp(values[loaded]) > 1e-9 * max(1.0, float(np.abs(values[loaded]).max()))
    }


def shapes(study: Study) -> dict[str, Array]:
    """Shapes over the rows of each variable that varies, name -> (n, m); columns of order 1."""
    scene = study.ready
    loaded = study.observation.rows
    out = {}
    for name, values in varying(study).items():
        seen = values[loaded]
        middle, half = 0.5 * (seen.max() + seen.min()), 0.5 * np.ptp(seen)
        u = np.clip((values - middle) / half, -1.2, 1.2)
        out[name] = legendre.legvander(u, DEGREE)[:, 1:]
    cases = np.unique(scene.load_case[loaded])
    if len(cases) > 1:
        out["load_case"] = (scene.load_case[:, None] == cases).astype(float)
    return out


def frames(study: Study) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Directions along which a structure may act: words -> (variables it brings along, columns (n, 3, d) in m)."""
    scene = study.ready
    loaded = (scene.load_case > 0) if scene.kind == "loaded" else np.ones(len(scene), dtype=bool)
    on = loaded[:, None, None].astype(float)
    assert scene.elastic is not None
    lever = max(float(np.abs(scene.J).max()), 1e-9)
    angle = scene.J * (TYPICAL_DISPLACEMENT / lever)
    tau = scene.load_torque()
    twist = (
        scene.J * (tau / np.maximum(np.sqrt((tau[loaded] ** 2).mean(axis=0)), 1e-9))[:, None, :] * (TYPICAL_DISPLACEMENT / lever)
    )
    size = max(float(np.sqrt((scene.elastic.displacement**2).sum(axis=1).mean())), 1e-9)
    out: dict[str, tuple[tuple[str, ...], Array]] = {
        "constant in the base frame": ((), np.tile(np.eye(3), (len(scene), 1, 1)) * TYPICAL_DISPLACEMENT * on),
        "constant in the tool frame": ((), scene.kin.R_tool * TYPICAL_DISPLACEMENT * on),
        "along the elastic deflection": (
            (),
            scene.elastic.displacement[:, :, None] * (TYPICAL_DISPLACEMENT / size / MODULATION * 0.1),
        ),
        "turning the axes": ((), angle * on),
        "as compliance of the axes": ((), twist * on),
    }
    for k in range(scene.n_joints):
        out[f"turning axis {k + 1}"] = ((), angle[:, :, k : k + 1] * on)
        out[f"as compliance of axis {k + 1}"] = ((f"tau_{k + 1}",), twist[:, :, k : k + 1] * on)
    return out


def plain(study: Study) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Structures that need no variable: words -> (session columns that they depend on, columns (n, 3, d) in m)."""
    scene = study.ready
    assert scene.elastic is not None
    by_torque = scene.elastic.compliance[:, :, 3:]
    beside = np.stack([np.einsum("nij,nj->ni", by_torque, np.cross(e, scene.force_in_tool)) for e in np.eye(3)], axis=2)
    return {"as if the force acted beside the TCP": (("load_case", f"tau_{scene.n_joints}"), beside * LEVER)}


def drifts(study: Study) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Structures that follow time or a temperature in every row and differ over the poses: words -> (variables, columns)."""
    scene = study.ready
    out: dict[str, tuple[tuple[str, ...], Array]] = {}
    if scene.measured_from_station is None:
        return out
    away = np.nan_to_num(scene.measured_from_station)
    far = np.linalg.norm(away, axis=1)
    reach = scene.p_tcp / max(float(np.linalg.norm(scene.p_tcp, axis=1).max()), 1e-9)
    by_reach = np.einsum("ni,jk->njik", reach, np.eye(3)).reshape(len(far), 3, -1)
    loaded = study.observation.rows
    for name, values in varying(study).items():
        if name != "stamp" and not name.startswith("temp_"):
            continue
        change = study.observation.of(np.tile(values[:, None], (1, 3)))[:, 0]
        size = float(np.abs(change).max())
        if size <= 1e-9 * max(1.0, float(np.abs(values).max())):
            continue
        course = (values - values[loaded].mean()) / size * TYPICAL_DISPLACEMENT
        square = np.eye(3) * (course * (far / max(far.max(), 1e-9)) ** 2)[:, None, None]
        out[f"{name}: growing with the square of the distance"] = ((name,), square)
        out[f"{name}: growing with the reach"] = ((name,), by_reach * course[:, None, None])
        out[f"{name}: turning the axes"] = ((name,), scene.J * course[:, None, None])
        out[f"{name}: along the tool"] = ((name,), scene.kin.R_tool * course[:, None, None])
    return out


def search(study: Study, check: Callable[[], None] = lambda: None) -> list[Unnamed]:
    """Try every structure on top of the model; best evidence first."""
    alone = study.bench.posterior(study.base)
    own = slice(study.base.A.shape[1], None)
    along = frames(study)
    found: list[Unnamed] = []

    def attempt(names: tuple[str, ...], words: str, columns: Array, tried: int) -> None:
        A = study.columns(columns)
        A = A[:, np.linalg.norm(A, axis=0) > 1e-6]
        if A.shape[1]:
            free = np.full(A.shape[1], np.inf)
            block = Block(A, -free, free, np.ones(A.shape[1]))
            posterior = study.bench.posterior(study.base + block, FACTORS, own)
            gained = supported(posterior.log_evidence - alone.log_evidence, alone.chi2 - posterior.chi2)
            found.append(Unnamed(names, words, block.widened(posterior.factor), posterior, gained, tried))

    for kind in (plain(study), drifts(study)):
        for words, (names, columns) in kind.items():
            attempt(names, words, columns, len(kind))
    shaped = shapes(study)
    for name, shape in shaped.items():
        check()
        for words, (brings, directions) in along.items():
            columns = (directions[:, :, :, None] * shape[:, None, None, :]).reshape(len(directions), 3, -1)
            attempt((name, *(v for v in brings if v != name)), words, columns, len(shaped) * len(along))
    return sorted(found, key=lambda u: -u.log_evidence)


def depends_on(found: list[Unnamed], least: float) -> list[str]:
    """Variables of the structures whose evidence is above `least` and within reach of the best, strongest first."""
    out: list[str] = []
    for u in found:
        if u.log_evidence < max(least, 0.3 * found[0].log_evidence):
            break
        out += [v for v in u.variables if v not in out]
    return out[:DEPENDS_ON_AT_MOST]
