# SPDX-License-Identifier: Apache-2.0
"""A payload that a loaded session does not state, from the torques at which the laws of gears turn.

In a loaded session the weight of a tool cancels but for one thing: with it the torque of an axis changes sign elsewhere, where
play is crossed and a gear is soft. Without it these laws look like nothing in the catalogue. So where neither session nor robot
description have the tool, its mass is sought: at each of some masses play and stiffening are tried on top of the model, with the
mass half way between the last joint and the TCP. Where it sits matters less, but it does: a centimetre is 10 N m of a spindle's
100 kg, and play is crossed within a few. So both are moved then as long as that explains more, but only where the law leaves
little that has no name before: beside a weight that may sit anywhere a gear imitates other causes, as play of a bearing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import log

import numpy as np
from scipy.optimize import minimize

from ..effects import Effect, known_effects
from ..effects.of_session import carrying
from ..effects.traits import Family
from ..robot import Payload
from ..session.data import Session
from ..typing import Array
from .candidates import try_effect
from .family import family_of
from .remainder import grow
from .settings import SETTINGS, Settings
from .study import Study

SHARES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)  # of the mass of the moving arm; rated payloads are 0.1 to 0.35 of it
NEARER = (0.5, 0.25)  # octaves by which the best is moved to either side
STEPS = (0.2, 0.1, 0.05)  # octaves of the mass, and shares of the way from the last joint to the TCP, by which both are moved
LEAST_WAY = 0.1  # m
MOST_STEPS = 4  # of one size to one side
LEAST_TOOL = 1e-3  # of the mass of the moving arm; less on a tool's link is there to please a simulator, and states no tool
MOST_TRIED = 90  # payloads, of the search after that
# of the law's evidence, what may have no name beside it; chosen: payloads on simulators left 0 to 0.09, play of a bearing 0.25
LEAST_KNOWN = 0.15
GAINED = 0.5  # nats, least of a step that is worth it
NOTE = "no payload is stated, and play or softness of gears turns at the torques of one of"


def with_payload_as_shown(
    session: Session, study: Study, check: Callable[[], None] = lambda: None, settings: Settings = SETTINGS
) -> Session:
    """The session with the payload that it shows, and a note; the same where it states one or shows none.

    Args:
        study: of the session, with what completes its springs.
    """
    arm = float(session.robot.moved_masses.sum())
    if session.kind != "loaded" or session.payload is not None or arm <= 0.0 or not np.any(session.gravity_in_base):
        return session
    if session.robot.tool_mass >= LEAST_TOOL * arm:  # the robot description has the tool
        return session
    present = {t.effect.id for t in study.terms}
    laws = [
        e for e in known_effects().values() if e.family is Family.TORQUE_LAW and e.id not in present and not study.why_not(e)
    ]
    none, heaviest = (_evidence(study, laws, p) for p in (None, _payload(session, SHARES[-1] * arm)))
    laws = [law for law in laws if none.get(law.id) != heaviest.get(law.id)]  # others don't ask for the weight

    def gain(share: float) -> float:
        """Log odds for a payload, by the law that gains most by it."""
        check()
        found = _evidence(study, laws, _payload(session, share * arm))
        return max((odds - max(none.get(law, 0.0), 0.0) for law, odds in found.items()), default=0.0) - log(len(SHARES))

    tried = {share: gain(share) for share in SHARES}
    best = max(tried, key=lambda share: tried[share])
    if tried[best] < settings.nats_to_name:
        return session
    for octaves in NEARER:
        tried |= {share: gain(share) for share in (best * 2.0**-octaves, best * 2.0**octaves)}
        best = max(tried, key=lambda share: tried[share])
    payload = _moved_where_it_explains_most(session, study, laws, _payload(session, best * arm), check)
    note = (
        f"{NOTE} about {payload.mass:.2g} kg at ({', '.join(f'{v:.2f}' for v in payload.com)}) m in tool0 (log odds"
        f" {tried[best]:.0f}), which is taken: state it (payload: mass and com); these torques tell a lighter one further out"
        " hardly from a heavier one"
    )
    return replace(carrying(session, payload), notes=(*session.notes, note))


def _moved_where_it_explains_most(
    session: Session, study: Study, laws: Sequence[Effect], start: Payload, check: Callable[[], None]
) -> Payload:
    """A payload near another one that explains more by the law that it was found with; mass and each coordinate in turn."""
    found = _evidence(study, laws, start)
    most, law = max((odds, name) for name, odds in found.items())
    laws = [one for one in laws if one.id == law]
    kin = session.robot.kinematics(session.q[:1])
    way = max(float(np.linalg.norm(kin.p_tcp[0] - kin.origin[0, -1])), LEAST_WAY)
    best = start
    if _without_a_name(study, laws[0], start) > LEAST_KNOWN * most:
        return start
    for step in STEPS:
        for side in (*np.eye(4), *-np.eye(4)):
            for _ in range(MOST_STEPS):
                check()
                there = _beside(best, step * side, way)
                odds = _evidence(study, laws, there).get(law, most)
                if odds < most + GAINED:
                    break
                best, most = there, odds

    def loss(moved: Array) -> float:
        check()
        return -_evidence(study, laws, _beside(best, moved, way)).get(law, 0.0)

    # mass and place depend on each other: along the valley that steps of one at a time leave
    simplex = np.concatenate([np.zeros((1, 4)), np.diag([-STEPS[0], STEPS[1], STEPS[1], STEPS[1]])])
    options = {"maxfev": MOST_TRIED, "initial_simplex": simplex, "fatol": GAINED}
    found = minimize(loss, np.zeros(4), method="Nelder-Mead", options=options)
    return _beside(best, found.x, way) if -found.fun > most + GAINED else best


def _beside(payload: Payload, moved: Array, way: float) -> Payload:
    """A payload with another mass, by octaves, and elsewhere, by shares of a way, m; moved: (4,)."""
    x, y, z = (np.array(payload.com) + way * moved[1:]).tolist()
    return Payload(payload.mass * 2.0 ** float(moved[0]), (x, y, z))


def _without_a_name(study: Study, law: Effect, payload: Payload) -> float:
    """Log evidence of structure that has no name beside a law of the gears, with a payload."""
    there = replace(study, ready=study.ready.carrying(payload))
    trial = try_effect(there, law)
    base = there.base if trial is None else there.base + trial.best.block
    return grow(there.bench, family_of(there), base).without_a_name


def _payload(session: Session, mass: float) -> Payload:
    kin = session.robot.kinematics(session.q[:1])
    from_last_joint = kin.R_tool[0].T @ (kin.p_tcp[0] - kin.origin[0, -1])
    x, y, z = (-0.5 * from_last_joint).tolist()
    return Payload(mass, (x, y, z))


def _evidence(study: Study, laws: Sequence[Effect], payload: Payload | None) -> dict[str, float]:
    """Log evidence of each law of the gears, with a payload."""
    there = study if payload is None else replace(study, ready=study.ready.carrying(payload))
    found = {law.id: try_effect(there, law) for law in laws}
    return {name: trial.log_evidence for name, trial in found.items() if trial is not None}
