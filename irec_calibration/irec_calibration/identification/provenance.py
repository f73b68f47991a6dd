# SPDX-License-Identifier: Apache-2.0
"""The model that a fit makes: its values, what it was identified from, and how well it predicts."""

from __future__ import annotations

import datetime
from collections.abc import Iterator

import numpy as np

from .. import __version__
from ..lengths import length
from ..model import Envelope, Model
from ..session.data import Session
from ..typing import Json
from .absolute import held_geometry
from .identify import Fit
from .validation import ESTIMATOR, HeldOut, rms

FEW_POSES = 5  # below which nothing is said of a model but what it leaves
MOST_LEFT, FAR_ABOVE_NOISE = 0.3, 3.0  # of the deflection, and times the noise: a model that leaves more says little
GUESSED = (
    "the link masses of the robot description are guesses: of each compliance only its product with the masses that load "
    "it is known; deflection under gravity is what was measured, deflection under a process force is not to be predicted "
    "from it"
)


def model_of(result: Fit, *, held_out: HeldOut | None = None, parent: str = "") -> Model:
    """A model with its provenance and figures, ready to be saved.

    Args:
        held_out: its error on held-out poses, from `diagnose.validated`; None: the model says nothing of it.
        parent: date of the model that it takes the place of.
    """
    session = result.observation.session
    force = np.linalg.norm(session.force_in_tool, axis=1)
    torque = np.linalg.norm(session.torque_in_tool, axis=1)
    held = held_geometry(result.terms, result.observation)
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
            **_sag_share(result),
            **_payload_as_shown(session),
            **({"without_tracker": True} if session.contact is not None else {}),
            **({"held_at_zero": list(held)} if held else {}),
            **({"caution": caution} if (caution := "; ".join(_cautions(result))) else {}),
        },
        figures={
            "fit_rms_m": result.rms,
            "fit_mean_m": float(np.linalg.norm(result.residual, axis=1).mean()),
            **({} if held_out is None else _figures(held_out)),
            "noise_floor_m": result.observation.whiten.floor,
            "rank": result.rank,
            "condition": result.condition,
            "chi2_per_dof": result.chi2 / max(result.dof, 1),
            "poses": len(result.observation.poses),
            "samples": len(result.observation.rows),
        },
        combinations=result.combinations,
    )


def _sag_share(result: Fit) -> Json:
    """`Model.sag_share`, where it is not what is expected."""
    observation = result.observation
    share = observation.scene.view.sags
    sees_it = observation.session.kind == "loaded" and observation.session.contact is None
    return {"sag_share": share} if sees_it and share != 1.0 else {}


def _payload_as_shown(session: Session) -> Json:
    """`Model.carried`, where the session did not state it."""
    p = session.payload
    return {} if p is None or "payload" in session.meta else {"payload_as_shown": {"mass": p.mass, "com": list(p.com)}}


def _figures(held_out: HeldOut) -> Json:
    return {
        "cv_rms_m": held_out.rms_m,
        "cv_rms_se_m": held_out.rms_se_m,
        "cv_mean_m": held_out.mean_m,
        "estimator": ESTIMATOR,
    }


def instruments(result: Fit) -> Json:
    """Where a fit has the stations and markers that were unknowns of the session, for the model's provenance."""
    out: Json = {}
    for term in result.terms:
        if term.effect.registers:
            out |= term.effect.placed(result.observation.session, {n: e.value for n, e in term.estimates.items()})
    return out


def _cautions(result: Fit) -> Iterator[str]:
    """What to think of before a model is used."""
    if _rests_on_guesses(result):
        yield GUESSED
    observation = result.observation
    if too_few(result):
        yield (
            f"{len(observation.poses)} pose(s) determine {result.rank} combinations of parameters with {result.dof} equations to"
            " spare: nothing tells how it predicts other poses; measure more"
        )
    if observation.session.kind != "loaded":
        return
    whole = rms(observation.y)
    if result.rms > MOST_LEFT * whole and result.rms > FAR_ABOVE_NOISE * observation.whiten.floor:
        yield (
            f"it leaves {length(result.rms)} of a deflection of {length(whole)} (at most {100.0 * MOST_LEFT:.0f} % is expected):"
            " something is wrong with the session, or much is missing; see irec diagnose before it is used"
        )


def too_few(result: Fit) -> bool:
    """Whether a session has too few poses or equations for its model to be judged."""
    return len(result.observation.poses) < FEW_POSES or result.dof < result.rank


def _rests_on_guesses(result: Fit) -> bool:
    session = result.observation.session
    return session.kind == "absolute" and session.inertials == "guess" and any(t.effect.elastic for t in result.terms)
