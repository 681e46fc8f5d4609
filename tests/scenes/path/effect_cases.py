"""For every effect an arm that has it, by the simulator or by a formula of its own, and the true number.

Sizes are five times what can be seen at all: a quarter of the usual noise of currents (0.5 % of the limit) and arm
angles or tools (20 µrad, 20 µm), or 0.3 % of what the torque varies by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import frames_along
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.effects.registry import find
from ideal_robot.friction import PerJointFriction
from ideal_robot.friction.laws import ViscousCoulomb
from sim.arm.specimen import Specimen
from sim.arm.world import World
from tests.scenes.path import kind_arm as arm

TIMES = 5.0
NOISE, SHARE, ANGLE, PLACE = 0.005, 0.003, 2e-5, 2e-5


@dataclasses.dataclass(frozen=True)
class Case:
    """An arm whose only misfit is one effect.

    Attributes:
        world, individual: the arm; None for the exact individual.
        true: the effect with its true number.
        friction: viscous and dry friction of joint 2 that the model knows beforehand [N m s/rad, N m].
        shown: whether a recording shows the number well enough for a path. What currents alone say of a gear's give or
            a joint's zero is not: it is only taken over where a device on the arm's side confirms it.
    """

    world: World
    true: FittedEffect
    individual: Specimen | None = None
    friction: tuple[float, float] = (0.0, 0.0)
    shown: bool = True


@lru_cache(maxsize=1)
def signals() -> Signals:
    """Along the motion of ``kind_arm.recording`` of the exact arm."""
    plain = torque_regression(arm.recording(arm.WORLD), arm.ROBOT, arm.model(), payload=True).signals
    return dataclasses.replace(plain, frames=frames_along(arm.ROBOT, plain.q))


def visible(key: str, joint: int, unit: tuple[float, ...], theta: tuple[float, ...] = ()) -> FittedEffect:
    """An effect of five times the size that can be seen, its coefficients in proportion to ``unit``."""
    name, prefix = key.split("/")
    effect = find(name, prefix)
    added = effect.columns(signals(), joint, theta) @ np.array(unit)
    spread = np.std(added, axis=0)
    if effect.domain.prefix == "tau":
        least = np.maximum(0.25 * NOISE * arm.ROBOT.tau_max, SHARE * np.std(signals().torque, axis=0))
        times = float(np.max(spread / least))
        if times == 0.0:
            times = float(np.max(np.abs(added) / least))
    else:
        times = float(np.max(spread)) / (0.25 * (ANGLE if effect.domain.prefix == "qa" else PLACE))
    return FittedEffect(name, joint, effect.channel(joint), tuple(TIMES / times * u for u in unit), (), theta)


Torque = Callable[[float, Array, Array, Array], float]


def _with_torque(true: FittedEffect, torque: Torque, joint: int = arm.JOINT) -> Case:
    """The arm with a torque on one motor, against what the motor has to give."""
    unit = np.eye(arm.ROBOT.n)[joint - 1]
    return Case(arm.WORLD.replace(extra_torque=lambda *moved: -torque(*moved) * unit), true)


def _own(joint: int, value: float, other: float = 0.0) -> list[float]:
    return [value if j + 1 == joint else other for j in range(arm.ROBOT.n)]


def _along(v: float) -> float:
    """Direction of motion, passed within a few mrad/s."""
    return float(np.tanh(v / 2e-3))


TORQUES: dict[str, tuple[tuple[float, ...], tuple[float, ...], Callable[..., float]]] = {
    "viscous/tau": ((1.0,), (), lambda c, q, qd: c[0] * qd[1]),
    "coulomb/tau": ((1.0,), (), lambda c, q, qd: c[0] * _along(qd[1])),
    "degressive/tau": ((1.0,), (8.0,), lambda c, q, qd: c[0] * np.arctan(8.0 * qd[1])),
    "stribeck/tau": ((1.0,), (0.05,), lambda c, q, qd: c[0] * _along(qd[1]) * np.exp(-abs(qd[1]) / 0.05)),
    "stribeck/tau_bell": ((1.0,), (0.05,), lambda c, q, qd: c[0] * _along(qd[1]) * np.exp(-((qd[1] / 0.05) ** 2))),
    "current_offset/tau": ((1.0,), (), lambda c, q, qd: c[0]),
    "cable_spring/tau": ((1.0,), (), lambda c, q, qd: c[0] * q[1]),
    "cable_spring/tau_taut": ((1.0, 0.4), (-9.0, -1.5), lambda c, q, qd: (
        c[0] + c[1] * max(q[1] + 1.5, 0.0)) * max(q[1] + 1.5, 0.0)),
    "axis_coupling/tau": ((0.0, 1.0, 0.3), (3.0, 1.0, 1.0),
                          lambda c, q, qd: c[1] * qd[2] + c[2] * _along(qd[1] + qd[2])),
    "gravity_spring/tau": ((1.0, 0.5), (0.4, 0.5), lambda c, q, qd: np.sin(q[1] - 0.4) * (
        c[0] + c[1] * (1.0 / np.hypot(1.0 + 0.5 * np.cos(q[1] - 0.4), 0.5 * np.sin(q[1] - 0.4)) - 1.25**-0.5))),
}
"""Of joint 2: what the coefficients are in proportion to, nonlinear parameters, torque of coefficients, q and qd."""


def _of_torque(key: str) -> Case:
    unit, theta, torque = TORQUES[key]
    true = visible(key, 2, unit, theta)
    return _with_torque(true, lambda t, q, qd, q_a: torque(true.coefficients, q, qd))


def asymmetric_friction() -> Case:
    """Of viscous friction that is known: half the difference is less than all of it."""
    true = visible("asymmetric_friction/tau", 2, (1.0,))
    known = 2.0 * true.coefficients[0]
    case = _with_torque(true, lambda t, q, qd, q_a: known * qd[1] + true.coefficients[0] * abs(qd[1]))
    return dataclasses.replace(case, friction=(known, 0.0))


def _of_load(key: str, share: Callable[[float, float], float]) -> Case:
    """Friction per load of joint 2: of a unit, given the load and the direction."""
    true = visible(key, 2, (1.0,))
    model = arm.ROBOT.pinocchio
    data = model.createData()

    def torque(t: float, q: Array, qd: Array, q_a: Array) -> float:
        load = pin.nonLinearEffects(model, data, q_a, qd)[1]
        return float(true.coefficients[0] * share(load, _along(qd[1])))
    return _with_torque(true, torque)


def presliding_hysteresis() -> Case:
    """Dry friction is known, the way over which it turns is not."""
    dry = TIMES * max(0.25 * NOISE * float(arm.ROBOT.tau_max[1]), SHARE * float(np.std(signals().torque[:, 1])))
    world = arm.WORLD.replace(friction=True, friction_scale=_own(2, 1.0), coulomb=_own(2, dry, 1.0),
                              presliding=_own(2, 3e-3, 3e-4), stribeck=0.0, viscous=0.0, degressive=0.0,
                              load_friction=0.0)
    true = FittedEffect("presliding_hysteresis", 2, "tau_2", (dry,), (), (3e-3,))
    return Case(world, true, friction=(0.0, dry))


def torque_ripple() -> Case:
    order = 24.0
    unit = visible("torque_ripple/tau", 2, (1.0, 0.0), (order,))
    a = unit.coefficients[0]
    return _with_torque(dataclasses.replace(unit, coefficients=(0.6 * a, 0.8 * a)),
                        lambda t, q, qd, q_a: a * (0.6 * np.cos(order * q[1]) + 0.8 * np.sin(order * q[1])))


def drive_gain() -> Case:
    true = visible("drive_gain/tau", 2, (1.0,))
    gain = np.array(_own(2, 1.0 / (1.0 + true.coefficients[0]), 1.0))
    return Case(arm.WORLD, true, dataclasses.replace(arm.exact(), drive_gain=gain))


def rotor_inertia() -> Case:
    true = visible("rotor_inertia/tau", 2, (1.0,))
    return Case(arm.WORLD.replace(extra_rotor_inertia=_own(2, true.coefficients[0])), true)


def _body(key: str, link: int, joint: int) -> Case:
    """A point mass on a link."""
    centre = np.array([0.06, 0.03, 0.12])
    about = (centre @ centre) * np.eye(3) - np.outer(centre, centre)
    full = (1.0, *centre, about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2])
    true = visible(key, joint, full)
    mass = true.coefficients[0]
    return Case(arm.WORLD, true, arm.with_body(link, mass, centre))


def _turned(joint: int, shift: Array, turn: Array) -> Specimen:
    """All behind a joint is moved in the joint's frame."""
    bare = arm.exact()
    model: pin.Model = bare.model.copy()
    model.jointPlacements[joint + 1] = pin.SE3(pin.exp3(turn), shift) * model.jointPlacements[joint + 1]
    return dataclasses.replace(bare, model=model)


def zero_error() -> Case:
    """Five times what currents show of a zero would be 9°: half a degree stands for it."""
    true = FittedEffect("zero_error", 2, "tau_2", (0.008,))
    bare = arm.exact()
    model: pin.Model = bare.model.copy()
    axis = pin.getJointJacobian(model, _jacobians(model), 2, pin.ReferenceFrame.LOCAL)[3:, 1]
    placement = model.jointPlacements[2]
    model.jointPlacements[2] = placement * pin.SE3(pin.exp3(true.coefficients[0] * axis), np.zeros(3))
    return Case(arm.WORLD, true, dataclasses.replace(bare, model=model), shown=False)


def _jacobians(model: pin.Model) -> pin.Data:
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return data


def base_tilt() -> Case:
    """A base that leans, seen from the base: gravity comes from elsewhere."""
    true = visible("base_tilt/tau", 0, (1.0, 0.5, 0.0, 0.0))
    bare = arm.exact()
    model: pin.Model = bare.model.copy()
    gravity = np.array(model.gravity.linear)
    gravity[:2] += true.coefficients[:2]
    model.gravity.linear = gravity
    return Case(arm.WORLD, true, dataclasses.replace(bare, model=model))


def _softer(key: str) -> Case:
    k = arm.WORLD.per_joint("stiffness", arm.ROBOT.n)
    true = visible(key, 2, (1.0,))
    # Currents show all of a gear, arm angles what is beyond the known.
    of_currents = key.endswith("/tau")
    soft = k.copy()
    soft[1] = 1.0 / (true.coefficients[0] + (0.0 if of_currents else 1.0 / k[1]))
    return Case(arm.WORLD.replace(stiffness=soft.tolist()), true, shown=not key.partition("/")[2].startswith("tau"))


def _swinging() -> Case:
    """The gear of ``_softer``, said by the resonance of the arm behind it."""
    case = _softer("joint_elasticity/tau")
    swings = FittedEffect("joint_elasticity", 2, "tau_resonance_2", (1.0,), (), (1.0 / case.true.coefficients[0],))
    return dataclasses.replace(case, true=swings)


def _gap(prefix: str) -> Case:
    """In joint 1, whose load changes sign."""
    angle = TIMES * 0.25 * ANGLE
    true = FittedEffect("backlash", 1, f"{prefix}_1", (angle,), (), (10.0,))
    return Case(arm.WORLD.replace(backlash=_own(1, 2.0 * angle)), true, shown=prefix != "tau")


def _uneven(prefix: str) -> Case:
    amplitude = TIMES * 0.25 * ANGLE * np.sqrt(2.0)
    phase = float(arm.exact().phase[1])
    true = FittedEffect("transmission_error", 2, f"{prefix}_2",
                        (amplitude * np.sin(phase), amplitude * np.cos(phase)), (), (40.0,))
    return Case(arm.WORLD.replace(transmission_error=_own(2, amplitude)), true)


def kinematic_error() -> Case:
    true = visible("kinematic_error/tcp", 3, (1.0, 0.5, 1.0, -0.7))
    a, d, alpha, theta = true.coefficients
    frames = frames_along(arm.ROBOT, arm.ROBOT.home[None])
    # Axis and common normal in the joint's own frame, from those in the base frame.
    model = arm.ROBOT.pinocchio
    data = model.createData()
    pin.forwardKinematics(model, data, arm.ROBOT.home)
    back = data.oMi[3].rotation.T
    x, z = back @ frames.normal[0, 2], back @ frames.axis[0, 2]
    return Case(arm.WORLD, true, _turned(3, a * x + d * z, alpha * x + theta * z))


def warmth() -> Case:
    """Dry friction that is known is larger by three tenths, viscous by six: an oil that is cold."""
    dry = TIMES * max(0.25 * NOISE * float(arm.ROBOT.tau_max[1]), SHARE * float(np.std(signals().torque[:, 1]))) / 0.3
    viscous = dry / float(np.std(signals().qd[:, 1]))
    true = FittedEffect("warmth", 0, "tau", (0.3, 0.6))
    case = _with_torque(true, lambda t, q, qd, q_a: 1.6 * viscous * qd[1] + 1.3 * dry * _along(qd[1]), 2)
    return dataclasses.replace(case, friction=(viscous, dry))


CASES: dict[str, Callable[[], Case]] = {
    **{key: partial(_of_torque, key) for key in TORQUES},
    "asymmetric_friction/tau": asymmetric_friction, "warmth/tau": warmth,
    "load_dependent_friction/tau": lambda: _of_load(
        "load_dependent_friction/tau", lambda load, along: abs(load) * along),
    "load_direction_friction/tau": lambda: _of_load(
        "load_direction_friction/tau", lambda load, along: abs(load) * along if load * along > 0.0 else 0.0),
    "presliding_hysteresis/tau": presliding_hysteresis, "torque_ripple/tau": torque_ripple,
    "drive_gain/tau": drive_gain, "rotor_inertia/tau": rotor_inertia,
    "payload/tau": lambda: _body("payload/tau", 6, 0), "link_load/tau": lambda: _body("link_load/tau", 3, 3),
    "zero_error/tau": zero_error, "base_tilt/tau": base_tilt,
    **{f"joint_elasticity/{prefix}": partial(_softer, f"joint_elasticity/{prefix}")
       for prefix in ("tau", "tau_further", "qa", "tcp")},
    "joint_elasticity/tau_resonance": _swinging,
    **{f"backlash/{prefix}": partial(_gap, prefix) for prefix in ("tau", "qa_load", "tcp_load")},
    **{f"transmission_error/{prefix}": partial(_uneven, prefix) for prefix in ("qa", "tcp")},
    "kinematic_error/tcp": kinematic_error,
}


def friction_of(case: Case) -> PerJointFriction:
    """Friction that the model knows beforehand."""
    laws = list(arm.model().friction.laws)
    if any(case.friction):
        laws[1] = ViscousCoulomb(np.array(case.friction)[:, None])
    return PerJointFriction(laws)
