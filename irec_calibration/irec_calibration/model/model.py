# SPDX-License-Identifier: Apache-2.0
"""An elastic model of one robot: a list of effects with parameter values, and what it predicts."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..effects import is_predicted, parameters_of
from ..effects.scene import Scene
from ..robot import Payload
from ..typing import Array, Json
from .displacements import total_displacement
from .term import Term

SIX_DOF = ("joint_torsion",)
EIGHTEEN_DOF = ("joint_torsion", "link_bending")
GEOMETRIC = ("station_pose", "marker_position", "geometry_error")  # where absolute sessions start from
MOST_SAG = 1.5  # times what the masses of a robot description say


@dataclass(frozen=True)
class Envelope:
    """The range that a model was identified in.

    Attributes:
        q_lower, q_upper: joint angles, (k,), rad.
        force, torque: largest magnitude at the TCP, N and N m.
    """

    q_lower: tuple[float, ...]
    q_upper: tuple[float, ...]
    force: float
    torque: float = 0.0


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that is known although its members are not.

    Attributes:
        weights: parameter (effect.parameter) -> weight in the sum.
        value, se: of the sum, in the members' unit.
    """

    weights: dict[str, float]
    value: float
    se: float

    def __str__(self) -> str:
        parts = [
            f"{'-' if w < 0 else '+'} {'' if abs(abs(w) - 1) < 1e-6 else f'{abs(w):.3g} '}{n}" for n, w in self.weights.items()
        ]
        return " ".join(parts).removeprefix("+ ") + f" = {self.value:.4g} (std. error {self.se:.2g})"


@dataclass(frozen=True)
class Model:
    """Effects with values, and whose robot they belong to.

    Attributes:
        urdf_sha256: SHA-256 of the robot description.
        tool: name or note of the tool that was mounted.
        made: how it was made: session, solver, version, date, parent.
        figures: what it earned: fit_rms_m, cv_rms_m, noise_floor_m, rank, ...
        combinations: sums that are known of parameters which are not known singly.
        edited: the file that it was read from has other values than were written there.
    """

    terms: tuple[Term, ...]
    serial: str = ""
    urdf: str = ""
    urdf_sha256: str = ""
    tool: str = ""
    envelope: Envelope | None = None
    made: Json = field(default_factory=dict)
    figures: Json = field(default_factory=dict)
    combinations: tuple[Combination, ...] = ()
    history: tuple[Json, ...] = ()
    edited: bool = False

    @property
    def effects(self) -> tuple[str, ...]:
        """Effect ids in order."""
        return tuple(t.effect.id for t in self.terms)

    @property
    def sag_share(self) -> float:
        """Share of what the arm sags more on the way from the reference, by its springs and the masses of its description, that
        its loaded sessions show; 0 where the controller corrects for all of it."""
        share = self.made.get("sag_share", 1.0) if isinstance(self.made, dict) else 1.0
        return float(share) if isinstance(share, (int, float)) and 0.0 <= share <= MOST_SAG else 1.0

    @property
    def carried(self) -> Payload | None:
        """Payload that its session showed without stating one, and that its laws of gears count on; None where it stated it."""
        found = self.made.get("payload_as_shown") if isinstance(self.made, dict) else None
        if not isinstance(found, dict):
            return None
        x, y, z = (float(v) for v in found["com"])
        return Payload(float(found["mass"]), (x, y, z))

    def standing(self, scene: Scene) -> Scene:
        """A loaded scene with the arm as it stands by a geometry error of the model: springs turn about other lines; and with the
        payload that the model's session showed, where it states none."""
        if scene.kind == "loaded" and scene.gravity.payload is None and self.carried is not None:
            scene = scene.carrying(self.carried)
        for term in self.terms:
            if term.effect.moves_joints and scene.kind == "loaded":
                scene = term.effect.standing(scene, term.theta(parameters_of(term.effect, scene)))
        return scene

    def predict(self, scene: Scene) -> Array:
        """Deflection of the TCP in each row, (n, 3), m, in base_link.

        In `loaded` sessions what the process force causes since the row's reference, evaluated at the force that really acts
        (sensor effects) on the arm as it stands: what a geometry error makes of the commanded displacement, what is left of a
        motion, what passes with time and what only instruments see is no part of it, as in the live correction; what gears still
        creep under the arm's weight, where the model says so, is (the live correction leaves it out). In `absolute`
        sessions where the physical TCP is relative to the controller's, without what passes with time and what only instruments
        see.

        Args:
            scene: rows that observe the TCP (`scene_of(session, observe="tcp")`).
        """
        moving = [t for t in self.terms if is_predicted(t.effect.cause, scene.kind)]
        return scene.change(total_displacement(moving, self.standing(scene)))
