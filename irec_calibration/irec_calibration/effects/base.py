# SPDX-License-Identifier: Apache-2.0
"""The protocol that every physical effect follows, one effect per file.

An effect says where the observed point of a row is moved to by one physical cause. A `loaded` session observes the change of
that against the reference row, an `absolute` session observes it directly; an effect need not care which.

To write one: subclass `Effect`, give `id`, `label`, `physics`, `parameters()` and `displacement()`. That is all; `regressor()`
then comes from differences. An effect that is linear in its parameters should give `regressor()` instead, and gets
`displacement()` for nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..session.data import Session
from ..typing import Array, BoolArray, Json
from .live import ByDisplacement, LeftOut, LiveForm, Refused
from .scene import Scene
from .state import ElasticResponse
from .traits import Ageing, Axes, Cause, Evidence, Family

NOT_IN_PRODUCTION = ("time", "order", "step", "temperature")  # needs that a live correction can't meet in general


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: unique within the effect, e.g. `c_3`.
        unit: e.g. `rad/(N m)`.
        scale: a typical magnitude where the effect is strong; sets numerical scaling and the width of weak priors.
        lower, upper: physical bounds; a fit never leaves them.
        plausible: range beyond which a fitted value is called implausible (not a bound of the fit); defaults to the bounds.
        start: value where a fit starts and where the effect is absent (nonlinear ones: a mid value).
        group: parameters that may be present on their own, e.g. `axis 3`; empty: only together with the others.
        grid: for a parameter that enters nonlinearly: values over which it is profiled. Empty: linear.
        kinds: the values of the grid are kinds, and nothing lies between them.
        shapes: group whose parameters alone depend on the grid value; empty: all of the effect do.
        refines: it comes in beside other parts of the effect only, and is no evidence that the effect is there.
        flat: only the session says anything about it (no prior, and a fit starts from its present value).
        width: standard deviation of the prior about 0, in multiples of `scale`.
        axis: joint that the parameter belongs to, counted from 0; None: to none.
        first: where a session can't determine all parameters of the effect, those with `first` are chosen before the others.
        takes_from: compliance of an axis (`c_3`) that this parameter, 0 or less, takes away as the axis is loaded. The prior of
            that compliance is meant for a loaded axis; beside this parameter it is as much wider as this one may be large. What
            refers to the springs (creep, hoses) refers to the loaded axis.
        goes_with: compliance (`c_2a`) that this parameter is proportional to; `width` is for one as soft as its scale, and the
            prior is as much wider or narrower as the session shows that compliance.
        share_of: parameter of the effect (`a_3`) that this one multiplies: nothing shows it where that is 0, and every fit that
            has that one has it.
        level: of an effect that completes the form of springs: those with the same text are large or small together, and the
            session says how large they are.
    """

    name: str
    unit: str
    scale: float
    lower: float = -np.inf
    upper: float = np.inf
    plausible: tuple[float, float] | None = None
    start: float = 0.0
    group: str = ""
    grid: tuple[float, ...] = ()
    kinds: bool = False
    shapes: str = ""
    refines: bool = False
    flat: bool = False
    width: float = 1.0
    axis: int | None = None
    first: bool = False
    takes_from: str = ""
    goes_with: str = ""
    share_of: str = ""
    level: str = ""

    @property
    def prior_width(self) -> float:
        """Standard deviation of the prior about 0, in multiples of `scale`; infinite where there is none."""
        return np.inf if self.flat else self.width

    @property
    def plausible_range(self) -> tuple[float, float]:
        return self.plausible if self.plausible is not None else (self.lower, self.upper)


WHY_LEFT_OUT = {
    Cause.STATE: "does not depend on the process force",
    Cause.MOTION: "depends on the motion before, whatever the process force",
    Cause.TIME: "passes with time whatever the process force",
    Cause.MEASUREMENT: "is seen by the measuring instrument only and moves no tool",
}


class Effect(ABC):
    """One physical cause of disagreement between the controller's TCP and the measured one.

    Class attributes:
        id: stable name used in files.
        label: for plots, a few words.
        physics: one paragraph: what it is, how it looks when it is missing.
        acts_on: `arm` (moves the physical TCP: part of predictions), `wrench` (changes the force that the model is evaluated
            at) or `instrument` (only the measurement sees it: left out of predictions).
        cause: what its displacement comes from; decides about predictions and the live correction.
        elastic: a spring of the structure: part of the elastic response that other effects refer to.
        needs_elastic: reads `scene.elastic`.
        loads_arm: a force on the arm beside process and weight (`torque_of_pull`): an absolute session shows it as soon as the
            model has springs.
        moves_joints: in a loaded session springs turn about other lines than the robot description has: reads
            `scene.response.by_geometry`, and has `standing`, which predictions rest on.
        needs: what the scene must have: any of `time`, `order`, `temperature`, `ext`, `step`, `load`, `tracker`,
            `relaxed` (a reference row without load), `weight` (masses of the arm, where a payload's weight shows springs).
        in_readings: moves each reading of a loaded session by itself, and by far more than the differences that it is found in.
        readings_against: nats by which the readings at the references can be against it at most.
        registers: places instruments of an absolute session; belongs to the session, not to the robot.
        evidence: where a session shows it.
        family: effects that pass for each other; None: not known (effects of users).
        everywhere: kinds of session in which every robot has it and shows it, only its size is not known.
        usual_in: kinds of session in which it may be no larger than in every robot (`is_usual`).
        usual_by_known: of values that the session does not know by itself that is not asked.
        usual_at_most: share of the deflection, RMS, that it moves for certain, above which it is more, however little is seen.
        usual_visible: share of the deflection, RMS, up to which it is as in every robot whatever its values, counted of what the
            rest of the model does not take up; in a loaded session.
        usual_alone: share of that, from which it is a cause whatever its values where a loaded session has no other;
        usual_beside: likewise beside others, whose forms it may mend.
        beside: id of an effect that a robot which has this one has too: weighed beside that one first, and by itself only where
            that one does not come in.
        special_of: id of an effect that has this one's form with further parameters beside it: no rival of this one unless it
            explains more.
        completes: id of an effect that every robot has and whose form it completes: never named as a cause, but weighed beside it
            in every diagnosis, so that what it does passes for no other.
        obsolete: patterns of parameter names that models of an earlier form had; such a model is refused, not misread.
        compliance_of: its parameters are the compliances of these axes; None: they are something else. The level of their prior
            is set by the session, and no axis is taken out for want of evidence.
        by_angle: the compliance of its axes goes with their own angle, in one form of many.
        softens_with: joint from 0 with whose angle what it gives way varies, as the arm sees it, in one form of many.
        turns_by_angle: turns each axis by a law of its own angle, whatever the load.
        stands_in: describes what has no name, and is none itself: never weighed for a verdict (`diagnose/stand_in.py`).
        chosen_by_poses: in an absolute session it gets, without values, those parameters that the poses determine.
    """

    id: ClassVar[str]
    label: ClassVar[str]
    physics: ClassVar[str]
    acts_on: ClassVar[Literal["arm", "wrench", "instrument"]] = "arm"
    cause: ClassVar[Cause] = Cause.LOAD
    elastic: ClassVar[bool] = False
    needs_elastic: ClassVar[bool] = False
    loads_arm: ClassVar[bool] = False
    moves_joints: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ()
    in_readings: ClassVar[bool] = False
    readings_against: ClassVar[float] = np.inf
    registers: ClassVar[bool] = False
    evidence: ClassVar[Evidence] = Evidence.DISPLACEMENTS
    family: ClassVar[Family | None] = None
    everywhere: ClassVar[tuple[str, ...]] = ()
    usual_in: ClassVar[tuple[str, ...]] = ("loaded",)
    usual_by_known: ClassVar[bool] = False
    usual_visible: ClassVar[float] = 0.0
    usual_at_most: ClassVar[float] = np.inf
    usual_alone: ClassVar[float] = np.inf
    usual_beside: ClassVar[float] = np.inf
    beside: ClassVar[str] = ""
    special_of: ClassVar[str] = ""
    completes: ClassVar[str] = ""
    compliance_of: ClassVar[Axes | None] = None
    by_angle: ClassVar[bool] = False
    softens_with: ClassVar[int | None] = None
    turns_by_angle: ClassVar[bool] = False
    stands_in: ClassVar[bool] = False
    chosen_by_poses: ClassVar[bool] = False
    obsolete: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Parameters of this effect for the robot and columns of a scene, the same whatever the load."""

    def displacement(self, scene: Scene, theta: Array) -> Array:
        """Displacement of the observed point in base_link, (n, 3), m, for parameter values theta (p,)."""
        return self.regressor(scene, theta) @ theta

    def regressor(self, scene: Scene, theta: Array) -> Array:
        """Derivative of the displacement by each parameter at theta, (n, 3, p)."""
        parameters = self.parameters(scene)
        out = np.empty((len(scene), 3, len(parameters)))
        for i, parameter in enumerate(parameters):
            h = 1e-4 * parameter.scale
            ahead, behind = theta.copy(), theta.copy()
            ahead[i] = min(theta[i] + h, parameter.upper)
            behind[i] = max(theta[i] - h, parameter.lower)
            out[:, :, i] = (self.displacement(scene, ahead) - self.displacement(scene, behind)) / (ahead[i] - behind[i])
        return out

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array | None:
        """What the displacement changes by where the elastic response of the scene does, (n, 3, p), m; None: by next to nothing.

        Needed of effects that follow the elastic response with a large share, so that a joint fit with its springs converges.

        Args:
            change: of the response by p parameters of a spring, p is the last axis of each field.
        """
        return None

    def by_torque(self, scene: Scene, theta: Array, change: Array, read: bool) -> Array | None:
        """What the displacement changes by where the torque about the actuated axes does, (n, 3, p), m; None where an effect does
        not say: it is asked a small step beside then.

        Args:
            change: of the torque by p parameters of another effect, (n, k, p); read: whether it is of the process wrench
                (`Scene.tau`) or of what no sensor reads (`Scene.tau_unseen`).
        """
        return None

    def standing(self, scene: Scene, theta: Array) -> Scene:
        """For `moves_joints`: the scene with the arm as it stands by these values, (p,).

        The controller's joint angles, the wrench in tool0 and the torque of gravity stay.
        """
        raise NotImplementedError(f"{self.id} does not move joints")

    def reached(self, scene: Scene, theta: Array) -> BoolArray | None:
        """Whether the rows of a session come to where the law of each parameter bends, (p,), at its shape values; None: always.

        A value that is read off the tail of a law far from there would move the tool by far more where it bends.
        """
        return None

    def same_shape(self, scene: Scene, shape: Mapping[str, float]) -> dict[str, float]:
        """Other shape values that mean the same and can be searched one by one, where there are such (a phase far from where
        the rows are goes with the period); the same values else."""
        return dict(shape)

    def log_odds(self, scene: Scene) -> float:
        """How much more likely (less: negative) the effect is than others before a session is seen, natural log."""
        return 0.0

    def log_odds_of(self, groups: Sequence[str]) -> float:
        """How much more likely (less: negative) it is that just these groups of its parameters are there than other sets of as
        many, before a session is seen, natural log."""
        return 0.0

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        """Why fitted values can't be, by themselves or beside the compliances of the axes in the model; empty where they can.

        Args:
            values: parameter -> value and standard error; compliance: `c_k` -> compliance of axis k, rad/(N m);
                scene: the session that they were fitted to.
        """
        return ""

    def rather(self, values: Mapping[str, float], compliance: Mapping[str, float], scene: Scene) -> str:
        """Id of another effect that fitted values are rather than this one, where both explain alike; empty where there is none.

        Args:
            values: of each parameter that was fitted; compliance: of each axis, as of `why_impossible`.
        """
        return ""

    def simpler(self, values: Mapping[str, float]) -> bool:
        """Whether fitted values are likelier than the effect of which this one is a special form (`special_of`), where both
        explain alike.

        Args:
            values: of each parameter that was fitted.
        """
        return True

    def ends_at(self, values: Mapping[str, float], scene: Scene) -> str:
        """Id of another effect that begins where fitted values end, as where a fit came to a bound; empty where there is none.

        Args:
            values: of each parameter that was fitted.
        """
        return ""

    def holds(self, values: Mapping[str, float]) -> tuple[str, dict[str, float], frozenset[str]] | None:
        """Another effect that a part of this one is by itself: its id, its values, and the parameters that are that part; None
        where there is none.

        Args:
            values: of each parameter that was fitted.
        """
        return None

    def not_told(self, scene: Scene) -> str:
        """Why no session like that of a scene tells the effect from others, whatever its values: it is not weighed then; else
        empty."""
        return ""

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        """Whether an effect is no larger than in every robot: it is there then, and no cause that anybody has to look for.

        Args:
            values: parameter -> fitted value; share: RMS of its displacement over that of the whole model, in an absolute session
                of its springs; scene: the session that they were fitted to.
        """
        return False

    def where_to_look(self, values: Mapping[str, float], proven: Sequence[str]) -> str:
        """What its values say to somebody who goes to look for it in the cell: a clause with "it" for the effect,
        without a full stop; empty where they say nothing.

        Args:
            values: parameter -> fitted value, without those that stand at a bound; proven: groups of parameters that it surely
                has.
        """
        return ""

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        """Id of another effect that these values would be under another torque limit of the drives, where the robot description
        states none, that begins where they end, or that does the same to all that a session sees; else empty.

        Args:
            theta, se: values of all parameters and their standard errors, 0 where these are not known, (p,).
        """
        return ""

    def ageing(self, scene: Scene) -> tuple[Ageing, ...]:
        """Changes of the robot over the years that its parameters describe, for a robot like that of a scene."""
        return ()

    def wrench(self, scene: Scene, theta: Array) -> tuple[Array, Array]:
        """For `acts_on = wrench`: the force and torque in tool0 that really act, (n, 3) each, N and N m."""
        raise NotImplementedError(f"{self.id} does not act on the wrench")

    def in_wrist(self, scene: Scene) -> BoolArray:
        """For `elastic`: which parameters are springs of wrist axes, (p,), which what pulls between forearm and flange bends."""
        return np.array([p.axis is not None and p.axis >= scene.wrist[0] for p in self.parameters(scene)], dtype=bool)

    def torque_of_pull(self, scene: Scene, theta: Array) -> Array:
        """For `loads_arm`: torque about the actuated axes, (n, k), N m, that laws of gears answer to too, in proportion to the
        parameters without a grid and the same whatever the load; none where an effect does not say."""
        return np.zeros((len(scene), scene.n_joints))

    def placed(self, session: Session, values: dict[str, float]) -> Json:
        """For `registers`: where the values put the session's instruments, for the model's provenance."""
        return {}

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        """What this effect is in the live correction (effects/live.py); its own `displacement` where it gives nothing faster.

        Args:
            scene: rows of the robot in production, from which `parameters` come.
            theta: values of `parameters(scene)`, (p,).
        """
        return ByDisplacement()

    def no_live_form(self) -> LeftOut | Refused | None:
        """Why this effect has no part in a live correction, whatever the robot; None where it may have one."""
        if self.cause is not Cause.LOAD:
            return LeftOut(WHY_LEFT_OUT[self.cause])
        if type(self).live is not Effect.live:
            return None
        missing = not_in_production(self)
        if missing:
            return missing
        if self.acts_on == "wrench":
            return Refused("changes the wrench and gives no real-time form of it (a SensorMap)")
        return None


def not_in_production(effect: Effect) -> Refused | None:
    """Why an effect can't be used where nothing but a robot's own state and the process force is known; None where it can."""
    missing = [n for n in NOT_IN_PRODUCTION if n in effect.needs]
    return Refused(f"needs {', '.join(missing)}, which a correction does not have as a session does") if missing else None


def follows_springs(effect: Effect, scene: Scene) -> bool:
    """Whether an effect reads the elastic response in a scene."""
    return effect.needs_elastic or (effect.moves_joints and scene.kind == "loaded")


def parameters_of(effect: Effect, scene: Scene) -> tuple[Parameter, ...]:
    """As `Effect.parameters`, kept with the scene: a fit asks for the same thousands of times."""
    if id(effect) not in scene.asked:
        scene.asked[id(effect)] = effect, tuple(effect.parameters(scene))
    return scene.asked[id(effect)][1]


def weightless(scene: Scene) -> bool:
    """Whether what loads an arm is its own weight, of which the robot description says nothing."""
    return scene.kind == "absolute" and not np.any(scene.arm.robot.moved_masses)


def absent(scene: Scene, needs: tuple[str, ...]) -> str:
    """Why a scene can't show an effect that needs something, or an empty string.

    Args:
        needs: names as in `Effect.needs`.
    """
    for need in needs:
        if need == "tracker" and scene.instruments.by_contact:
            return "no tracker measured in this session"
        if need in ("time", "order", "step", "relaxed") and scene.instruments.by_contact:
            return "without a tracker the reference row is under load already, and what was before is not known"
        if need == "time" and scene.clock != "time":
            return "the session has no usable time stamps"
        if need in ("order", "step") and scene.clock == "none":
            return "the order of the rows is not known"
        if need == "temperature" and not scene.temperature:
            return "no temperature was logged"
        if need == "ext" and not scene.ext:
            return "no external axis was logged"
        if need == "load" and not np.any(scene.force_in_tool) and not np.any(scene.torque_in_tool):
            if scene.kind == "loaded":
                return "no process force acts in this session"
            if not np.any(scene.tau_gravity):
                return "no process force acts in this session and the robot description gives no masses"
        if need == "weight" and weightless(scene) and np.any(scene.tau_gravity):
            return "the robot description gives no masses but the payload's, and what the arm's own weight does would pass for it"
    return ""
