# SPDX-License-Identifier: Apache-2.0
"""The model that a fit makes: its values, what it was identified from, and how well it predicts."""

from __future__ import annotations

import datetime

import numpy as np
from scipy.spatial.transform import Rotation

from . import __version__
from .absolute import held_geometry
from .cross_validation import held_out_residual, rms
from .identify import Fit
from .model import Envelope, Model
from .typing import Json

GUESSED = (
    "the link masses of the robot description are guesses: of each compliance only its product with the masses that load "
    "it is known; deflection under gravity is what was measured, deflection under a process force is not to be predicted "
    "from it"
)


def model_of(result: Fit, *, cv_rms: float | None = None, parent: str = "") -> Model:
    """A model with its provenance and figures, ready to be saved."""
    session = result.observation.session
    force = np.linalg.norm(session.force_in_tool, axis=1)
    torque = np.linalg.norm(session.torque_in_tool, axis=1)
    held = held_geometry(result.terms, result.observation)
    held_out = held_out_residual(result.terms, result.observation) if cv_rms is None else None
    return Model(
        terms=result.terms,
        serial=session.serial,
        urdf=str(session.meta.get("robot", {}).get("urdf", "")),
        urdf_sha256=session.robot.sha256,
        tool=str(session.meta.get("tool", "")),
        envelope=Envelope(
            tuple(session.q.min(axis=0).tolist()), tuple(session.q.max(axis=0).tolist()), float(force.max()), float(torque.max())
        ),
        made={
            "session": session.name,
            "tool_version": __version__,
            "solver": "bounded weighted least squares, Gauss-Newton",
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            **({"parent": parent} if parent else {}),
            **instruments(result),
            **({"held_at_zero": [f"geometry_error.{n}" for n in held]} if held else {}),
            **({"caution": GUESSED} if _rests_on_guesses(result) else {}),
        },
        figures={
            "fit_rms_m": result.rms,
            "fit_mean_m": float(np.linalg.norm(result.residual, axis=1).mean()),
            "cv_rms_m": float(cv_rms) if held_out is None else rms(held_out),  # type: ignore[arg-type]
            **({} if held_out is None else {"cv_mean_m": float(np.linalg.norm(held_out, axis=1).mean())}),
            "noise_floor_m": result.observation.whiten.floor,
            "rank": result.rank,
            "condition": result.condition,
            "chi2_per_dof": result.chi2 / max(result.dof, 1),
            "poses": len(result.observation.poses),
            "samples": len(result.observation.rows),
        },
        combinations=result.combinations,
    )


def instruments(result: Fit) -> Json:
    """Where a fit has the stations and markers that were unknowns of the session, for the model's provenance."""
    session = result.observation.session
    value = {t.effect.id: {n: e.value for n, e in t.estimates.items()} for t in result.terms if t.effect.registers}
    out: Json = {}
    for s in session.stations if "station_pose" in value else ():
        if not s.known:
            d, w = (np.array([value["station_pose"][f"{p}{a}_{s.name}"] for a in "xyz"]) for p in ("", "w_"))
            turned = Rotation.from_rotvec(w) * Rotation.from_quat(s.quat_xyzw)
            pose = {"xyz": (np.array(s.xyz) + d).tolist(), "quat_xyzw": turned.as_quat().tolist()}
            out.setdefault("stations_in_base_link", {})[s.name] = pose
    for m in session.markers if "marker_position" in value else ():
        if not m.known:
            d = np.array([value["marker_position"][f"{a}_{m.name}"] for a in "xyz"])
            out.setdefault(f"markers_in_{m.link}", {})[m.name] = (np.array(m.xyz) + d).tolist()
    return out


def _rests_on_guesses(result: Fit) -> bool:
    session = result.observation.session
    return session.kind == "absolute" and session.inertials == "guess" and any(t.effect.elastic for t in result.terms)
