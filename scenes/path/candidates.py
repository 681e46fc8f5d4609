"""Changes of the model that a diagnosis suggests, in the forms in which they may be taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.final_fit import beside_held_model, friction_anew
from ideal_robot.diagnosis.validation.transfer import adopted, behind_gears, with_joint
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.measured import Measured

_ONLY_BEHIND = ("only a device on the arm's side, or a clamped flange ([J]), shows a gear's give or a joint's zero; "
                "motor angles and currents do not")
_SHOWN_BEHIND = "the arm angles, which are measured, show what a gear gives better than currents"
_HELD = "the model's parameters held"
_REFITTED = "with the joint's friction fitted anew"


@dataclass(frozen=True)
class Candidate:
    """One form of a change.

    Attributes:
        label: what it is.
        change: makes the changed model of the present one.
        effects: that it adds; none where friction is fitted anew and that is all.
    """

    label: str
    change: Callable[[Model], Model]
    effects: tuple[FittedEffect, ...]

    @classmethod
    def adding(cls, label: str, effects: tuple[FittedEffect, ...]) -> Candidate:
        """Effects on top of the model."""
        return cls(label, partial(_added, effects=effects), effects)

    @property
    def at_tool(self) -> bool:
        """Whether it was seen at the tool."""
        return bool(self.effects) and all(effect.domain == TCP_POSITION for effect in self.effects)

    @property
    def shows_in_loop(self) -> bool:
        """Whether joints move otherwise with it; where the tool is for given joints does not show there."""
        changes = [effect.effect.loop_change(effect.coefficients, effect.theta) for effect in self.effects]
        return not changes or not all(change.geometry is not None or change.zero for change in changes)


@dataclass(frozen=True)
class Refusal:
    """What is not tried.

    Attributes:
        label: what was found.
        reason: why not.
    """

    label: str
    reason: str


Forms = tuple[Candidate, ...]


def candidates(model: Model, found: Diagnosis, moved: Recording, run: Recording, robot: Robot,
               measured: Measured) -> tuple[Forms, list[Forms], list[Refusal]]:
    """Everything together, joint by joint, and what is not tried.

    Effects of the torque come in two forms: as large as they are beside the model as it is, and with the friction that
    their joint has in the joint fit, for dry friction that rises towards standstill leaves less to the Coulomb term.
    Where the parameters of the model do not hold, what explains most of the recording with them held is tried, too:
    effects of another name that the diagnosis then reports may be such as do not act on a path. Of these, changes of
    parameters are candidates one by one, for beside them stands what only makes up for the rest: as large as they are
    alone, or with the others.
    Where refitting the model alone explains a joint's error, its friction is a change of its own: as the joint fit has
    it, or fitted beside all else.

    Args:
        model: that the diagnosis was given.
        found: what it found.
        moved: the recording it was found in.
        run: the last play of the path, as far as it was measured.
        robot: the arm.
        measured: what the arm measures.
    """
    refused, torque, behind = _sorted([one.fitted for one in (*found.effects, *found.unknown)], measured)
    whole_behind = () if measured == "motor" else behind_gears(model, found, run, robot)
    # What does not act on the path takes its share of the recording all the same.
    of_torque = [one.fitted for one in (*found.effects, *found.unknown)]
    regression = torque_regression(moved, robot, model, payload=True)
    sized = beside_held_model(regression, model, of_torque)
    held = tuple(effect for effect in sized if _place(effect) in {_place(one) for one in torque})
    whole: list[Candidate] = []
    if held or whole_behind:
        whole.append(Candidate.adding(f"all that was found, {_HELD}", (*held, *whole_behind)))
    predicting = adopted(model, found, run, robot)
    more = predicting.effects[len(model.effects):]
    changed = more or any(a is not b for a, b in zip(predicting.friction.laws, model.friction.laws, strict=True))
    if changed and not any(_not_of_currents(effect, measured) for effect in more):
        whole.append(Candidate("all that predict the run better", lambda _: predicting, more))
    hidden: dict[tuple[str, int], list[FittedEffect]] = {}
    for own in found.beside_known:
        _, acting, _ = _sorted(beside_held_model(regression, model, own), measured)
        if acting:
            whole.append(Candidate.adding("all that explains it with the model as it was", (*acting, *whole_behind)))
        for effect in acting:
            if effect.effect.absorbed_by_base:
                sizes = hidden.setdefault((effect.name, effect.joint), [])
                sizes += [effect] if sizes else [*beside_held_model(regression, model, (effect,)), effect]
    apart: list[Forms] = [(Candidate.adding(_name(effect), (effect,)),) for effect in behind]
    for joint in dict.fromkeys(effect.joint for effect in torque):
        own = tuple(effect for effect in torque if effect.joint == joint)
        of_held = tuple(effect for effect in held if effect.joint == joint)
        label = " and ".join(effect.name for effect in own) + (f" in joint {joint}" if joint else "")
        forms = [Candidate.adding(f"{label}, {_HELD}", of_held)] if of_held else []
        if found.model is not None and joint:
            forms.append(Candidate(f"{label}, {_REFITTED}", partial(with_joint, fitted=found.model, joint=joint,
                                                                    effects=own), own))
        if forms:
            apart.append(tuple(forms))
    apart += [tuple(Candidate.adding(f"{_name(own[0])}, {_HELD}", (effect,)) for effect in own)
              for own in hidden.values()]
    for joint, anew in friction_anew(regression, model, tuple(one.joint for one in found.refitted)).items():
        label = f"friction of joint {joint} fitted anew"
        fits = [anew] if found.model is None else [anew, found.model]
        apart.append(tuple(Candidate(label, partial(with_joint, fitted=fit, joint=joint, effects=()), ())
                           for fit in fits))
    return tuple(whole), apart, refused


def _sorted(effects: Sequence[FittedEffect],
            measured: Measured) -> tuple[list[Refusal], list[FittedEffect], list[FittedEffect]]:
    """What is not tried, effects of the torque, and those behind the gears."""
    refused, torque, behind = list[Refusal](), list[FittedEffect](), list[FittedEffect]()
    for effect in effects:
        nowhere = effect.effect.loop_change(effect.coefficients, effect.theta).nowhere
        if effect.domain == SENSOR:
            nowhere = "no sensor takes part in this path"
        if nowhere:
            refused.append(Refusal(_name(effect), f"does not act: {nowhere}"))
        elif reason := _not_of_currents(effect, measured):
            refused.append(Refusal(_name(effect), reason))
        elif effect.domain != MOTOR_TORQUE:
            behind.append(effect)
        else:
            torque.append(effect)
    return refused, torque, behind


def _added(model: Model, effects: tuple[FittedEffect, ...]) -> Model:
    return model.with_effects(effects)


def _place(effect: FittedEffect) -> tuple[str, str, tuple[float, ...]]:
    return effect.name, f"{effect.channel}:{effect.joint}:{dict(effect.data)}", effect.theta


def _name(effect: FittedEffect) -> str:
    return f"{effect.name} in joint {effect.joint}" if effect.joint else effect.name


def _not_of_currents(effect: FittedEffect, measured: Measured) -> str:
    """Why what currents say of a gear or a joint's zero is not taken; empty where it may be, or they did not say it."""
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    gear = change.gear_compliance is not None or bool(change.half_gap)
    if effect.domain != MOTOR_TORQUE or not (gear or change.zero):
        return ""
    if measured == "motor":
        return _ONLY_BEHIND
    return _SHOWN_BEHIND if gear else ""
