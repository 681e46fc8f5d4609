"""Changes of the model that a diagnosis suggests, in the forms in which they may be taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.validation.refit import beside_held_model, friction_anew
from ideal_robot.diagnosis.validation.transfer import adopted, behind_gears, with_joint
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import Form, Forms, Group, Step, places_of, said
from scenes.closing.result import Measured

_ONLY_BEHIND = ("only a device on the arm's side, or a clamped flange ([J]), shows a gear's give or a joint's zero; "
                "motor angles and currents do not")
_SHOWN_BEHIND = "the arm angles, which are measured, show what a gear gives better than currents"
_NO_SIZE = "beside the model as it is it has no size that physics allows"
_HELD = "the model's parameters held"
_REFITTED = "with the joint's friction fitted anew"
Effects = tuple[FittedEffect, ...]


@dataclass(frozen=True)
class Candidates:
    """What a diagnosis of an arm suggests.

    Attributes:
        model: that the diagnosis was given.
        found: what it found.
        moved: the recording it was found in.
        run: the last play of the path, as far as it was measured.
        robot: the arm.
        measured: what the arm measures.
    """

    model: Model
    found: Diagnosis
    moved: Recording
    run: Recording
    robot: Robot
    measured: Measured

    def groups(self) -> tuple[tuple[Group, ...], tuple[Step, ...]]:
        """All that moves the joints, together and apart, then all that only the tool shows; and what is not tried.

        Effects of the torque come in two forms: as large as they are beside the model as it is, and with the friction
        that their joint has in the joint fit, for dry friction that rises towards standstill leaves less to the Coulomb
        term. Where the parameters of the model do not hold, what explains most of the recording with them held is
        tried, too: effects of another name that the diagnosis then reports may be such as do not act on a path. Of
        these, changes of parameters are tried one by one, for beside them stands what only makes up for the rest: as
        large as they are alone, or with the others. Where refitting the model alone explains a joint's error, its
        friction is a change of its own: as the joint fit has it, or fitted beside all else.
        """
        effects = [one.fitted for one in (*self.found.effects, *self.found.unknown)]
        refused, torque, others = _sorted(effects, self.measured)
        at_tool = [effect for effect in others if effect.domain == TCP_POSITION]
        behind = [effect for effect in others if effect.domain != TCP_POSITION]
        regression = torque_regression(self.moved, self.robot, self.model, payload=True)
        # What does not act on the path takes its share of the recording all the same.
        wanted = {_place(one) for one in torque}
        held = tuple(one for one in beside_held_model(regression, self.model, effects) if _place(one) in wanted)
        of_gears = () if self.measured == "motor" else behind_gears(self.model, self.found, self.run, self.robot)
        explaining, hidden = self._beside_known(regression, of_gears)
        whole = [*([Form.adding(f"all that was found, {_HELD}", (*held, *of_gears))] if held or of_gears else []),
                 *self._predicting(), *explaining]
        by_joint, no_size = self._by_joint(torque, held)
        apart = [*((Form.adding(said(one.name, one.joint), (one,)),) for one in behind), *by_joint, *hidden,
                 *self._friction_anew(regression)]
        return (Group(tuple(whole), tuple(apart)), Group.adding(at_tool)), (*refused, *no_size)

    def _predicting(self) -> list[Form]:
        """The changed joints that predict the last play better, and gears whose give it shows."""
        predicting = adopted(self.model, self.found, self.run, self.robot)
        more = predicting.effects[len(self.model.effects):]
        laws = zip(predicting.friction.laws, self.model.friction.laws, strict=True)
        changed = more or any(a is not b for a, b in laws)
        if not changed or any(_not_of_currents(effect, self.measured) for effect in more):
            return []
        return [Form("all that predict the run better", lambda model, run: predicting, places_of(more))]

    def _beside_known(self, regression: Regression, of_gears: Effects) -> tuple[list[Form], list[Forms]]:
        """What explains most with the parameters held: together, and each change of a parameter by itself."""
        whole, sizes = list[Form](), dict[tuple[str, int], list[FittedEffect]]()
        for own in self.found.beside_known:
            _, acting, _ = _sorted(beside_held_model(regression, self.model, own), self.measured)
            if acting:
                whole.append(Form.adding("all that explains it with the model as it was", (*acting, *of_gears)))
            for effect in acting:
                if effect.effect.absorbed_by_base:
                    known = sizes.setdefault((effect.name, effect.joint), [])
                    known += [effect] if known else [*beside_held_model(regression, self.model, (effect,)), effect]
        return whole, [tuple(Form.adding(f"{said(*place)}, {_HELD}", (one,)) for one in own)
                       for place, own in sizes.items()]

    def _by_joint(self, torque: Sequence[FittedEffect], held: Effects) -> tuple[list[Forms], list[Step]]:
        """The effects of each joint's torque, and those that come in no form."""
        result, refused = list[Forms](), list[Step]()
        for joint in dict.fromkeys(effect.joint for effect in torque):
            own = tuple(effect for effect in torque if effect.joint == joint)
            of_held = tuple(effect for effect in held if effect.joint == joint)
            label = " and ".join(said(effect.name, effect.joint) for effect in own)
            forms = [Form.adding(f"{label}, {_HELD}", of_held)] if of_held else []
            if self.found.model is not None and joint:
                forms.append(self._refitted(f"{label}, {_REFITTED}", self.found.model, joint, own))
            result += [tuple(forms)] if forms else []
            refused += [] if forms else [Step(label, _NO_SIZE, places=places_of(own))]
        return result, refused

    def _friction_anew(self, regression: Regression) -> list[Forms]:
        """The friction of joints whose error refitting the model alone explains."""
        joints = tuple(one.joint for one in self.found.refitted)
        return [tuple(self._refitted(f"friction of joint {joint} fitted anew", fit, joint, ())
                      for fit in (anew, self.found.model) if fit is not None)
                for joint, anew in friction_anew(regression, self.model, joints).items()]

    @staticmethod
    def _refitted(label: str, fitted: Model, joint: int, effects: Effects) -> Form:
        return Form(label, lambda model, run: with_joint(model, fitted, joint, effects), places_of(effects))


def _sorted(effects: Sequence[FittedEffect],
            measured: Measured) -> tuple[list[Step], list[FittedEffect], list[FittedEffect]]:
    """What is not tried, effects of the torque, and those behind the gears."""
    refused, torque, behind = list[Step](), list[FittedEffect](), list[FittedEffect]()
    for effect in effects:
        nowhere = effect.effect.loop_change(effect.coefficients, effect.theta).nowhere
        if effect.domain == SENSOR:
            nowhere = "no sensor takes part in this path"
        if reason := f"does not act: {nowhere}" if nowhere else _not_of_currents(effect, measured):
            refused.append(Step(said(effect.name, effect.joint), reason, places=places_of((effect,))))
        else:
            (torque if effect.domain == MOTOR_TORQUE else behind).append(effect)
    return refused, torque, behind


def _place(effect: FittedEffect) -> tuple[str, str, tuple[float, ...]]:
    return effect.name, f"{effect.channel}:{effect.joint}:{dict(effect.data)}", effect.theta


def _not_of_currents(effect: FittedEffect, measured: Measured) -> str:
    """Why what currents say of a gear or a joint's zero is not taken; empty where it may be, or they did not say it."""
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    gear = change.gear_compliance is not None or bool(change.half_gap)
    if effect.domain != MOTOR_TORQUE or not (gear or change.zero):
        return ""
    if measured == "motor":
        return _ONLY_BEHIND
    return _SHOWN_BEHIND if gear else ""
