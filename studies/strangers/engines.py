"""The engines: MuJoCo, our PyBullet arm and DART as the plant, beside the independent integrator.

MuJoCo has effects by its own means wherever it can: dry friction is its ``frictionloss``, whose level changes with what
the drive says and whose softness, some mrad/s of creep, is the engine's own default; smooth friction is its implicit
joint damping. Elastic gears are a second joint in series with a spring, a gap is a limit of that joint, cables and
balance springs are tendons, a shaft that turns two joints is a tendon with inertia and friction, a tilted base is
tilted gravity. PyBullet's arm has its world keys, and the rest as additional torque on the motors. DART, which was left
out while the diagnosis was made, has drives and friction of its own, and gears by its implicit joint springs.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.bullet import pybullet
from studies.strangers import drive, integrator
from studies.strangers.arm import STEP, Motion, joint_axes, sliding, written
from studies.strangers.drive import ACTING, BELIEVED, CABLE, CABLE_REST, FLUID, LEVEL, RESULTS, STATES, drive_step
from studies.strangers.plant import BRISTLE, CONSTRAINT, DAHL, TANH, Plant, Run


def mjcf(plant: Plant) -> str:
    """The plant in MuJoCo's format; joints ``m1 …`` are the motors, ``s1 …`` the twist of gears that are not rigid."""
    model, elastic = plant.model, plant.elastic
    axes, slides = joint_axes(model), sliding(model)
    k_gear, d_gear = plant.springs()
    gravity = " ".join(f"{g:.12g}" for g in model.gravity.linear)
    parts = [f'<mujoco><compiler angle="radian" autolimits="false" boundmass="1e-9" boundinertia="1e-12"/>'
             f'<option timestep="{STEP}" integrator="implicitfast" gravity="{gravity}" iterations="50" '
             f'tolerance="1e-10"><flag contact="disable"/></option><worldbody>']
    closing: list[str] = []
    for j in range(plant.n):
        placement, body = model.jointPlacements[j + 1], model.inertias[j + 1]
        axis = axes[j, :3] if slides[j] else axes[j, 3:]
        kind = f'type="{"slide" if slides[j] else "hinge"}" axis="{_text(axis)}"'
        across, balancers = _across(axis), [s for s in plant.balancers if s.joint == j]
        parts += [f'<site name="frame{j + 1}" pos="{_text(placement.act(s.reach * across))}"/>' for s in balancers]
        turn = pin.Quaternion(placement.rotation)
        parts.append(f'<body pos="{_text(placement.translation)}" quat="{_text([turn.w, turn.x, turn.y, turn.z])}">'
                     f'<joint name="m{j + 1}" {kind} armature="{plant.rotor[j]:.12g}" frictionloss="1e-9"/>')
        closing.append("</body>")
        if elastic[j]:
            play = plant.gap[j] > 0.0
            # A limit's stiffness and damping are given per inertia: those of a stop as stiff as the gear.
            stop = (f'limited="true" range="{-0.5 * plant.gap[j]:.12g} {0.5 * plant.gap[j]:.12g}" solreflimit="'
                    f'{-k_gear[j] / plant.arm.mass[j]:.12g} {-d_gear[j] / plant.arm.mass[j]:.12g}" '
                    f'solimplimit="0.99 0.99 0.001"' if play else
                    f'stiffness="{k_gear[j]:.12g}" damping="{d_gear[j]:.12g}"')
            parts.append('<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
                         f'<body><joint name="s{j + 1}" {kind} {stop}/>')
            closing[-1] += "</body>"
        i = body.inertia
        parts.append(f'<inertial pos="{_text(body.lever)}" mass="{body.mass:.12g}" fullinertia="'
                     f'{_text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])}"/>')
        for s in balancers:
            back = pin.exp3(-s.angle * axis) @ across
            parts.append(f'<site name="link{j + 1}" pos="{_text(s.lever * back)}"/>')
    return "".join([*parts, *reversed(closing), "</worldbody>", _tendons(plant), "</mujoco>"])


def _tendons(plant: Plant) -> str:
    parts = []
    for j in np.flatnonzero(plant.block[CABLE]):
        k, rest = plant.block[[CABLE, CABLE_REST], j]
        parts.append(f'<fixed stiffness="{k:.12g}" springlength="{rest:.12g}">'
                     f'<joint joint="m{j + 1}" coef="1"/></fixed>')
    for c in plant.couplings:
        parts.append(f'<fixed armature="{c.inertia:.12g}" damping="{c.viscous:.12g}" frictionloss="{c.dry:.12g}">'
                     f'<joint joint="m{c.joint + 1}" coef="1"/><joint joint="m{c.partner + 1}" coef="{c.sense:g}"/>'
                     "</fixed>")
    for s in plant.balancers:
        parts.append(f'<spatial stiffness="{s.stiffness:.12g}" springlength="{s.rest:.12g}">'
                     f'<site site="frame{s.joint + 1}"/><site site="link{s.joint + 1}"/></spatial>')
    return f"<tendon>{''.join(parts)}</tendon>" if parts else ""


def _text(values: Array | list[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)


def _across(axis: Array) -> Array:
    """A direction across an axis."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = other - axis * (axis @ other)
    return np.asarray(across / np.linalg.norm(across))


@jit()
def _friction_of(rub: Array, out: Array, v: Array, x: Array) -> None:
    """What MuJoCo gets as friction for the next step: its constraint, its damping, or the torque of bristles.

    ``rub (4, n)``: way through standstill, velocity of tanh, way and damping of bristles; ``x (5, n)``, in place:
    bristles, constraint, damping, torque that acts, friction but for the constraint.
    """
    for j in range(v.shape[0]):
        level, kind = out[LEVEL, j], rub[0, j]
        loss, damping, torque = 1e-9, out[FLUID, j], out[ACTING, j]
        friction = out[FLUID, j] * v[j]
        if kind == CONSTRAINT:
            loss = level
        elif kind == TANH:
            # tanh as a secant damping, which the integrator takes implicitly.
            ratio = abs(v[j]) / rub[1, j]
            damping += level / rub[1, j] * (math.tanh(ratio) / ratio if ratio > 1e-6 else 1.0)
            friction += level * math.tanh(v[j] / rub[1, j])
        else:
            towards = 1.0 if v[j] > 0.0 else -1.0
            before = x[0, j]
            x[0, j] = towards + (before - towards) * math.exp(-abs(v[j]) * STEP / rub[2, j])
            dry = level * x[0, j]
            if kind == BRISTLE:
                dry += rub[3, j] * (x[0, j] - before) / STEP * rub[2, j]
            torque -= dry
            friction += dry
        x[1, j], x[2, j], x[3, j], x[4, j] = loss, damping, torque, friction


def _in_mujoco(plant: Plant, motion: Motion) -> Run:
    n, N = plant.n, len(motion.t)
    model = mujoco.MjModel.from_xml_string(mjcf(plant))
    data = mujoco.MjData(model)
    address = np.array([model.joint(f"m{j + 1}").dofadr[0] for j in range(n)])
    elastic = np.flatnonzero(plant.elastic)
    twist = np.array([model.joint(f"s{j + 1}").dofadr[0] for j in elastic], dtype=int)
    k_gear, _ = plant.springs()
    wanted, block = plant.wanted(motion), plant.block.copy()
    block[drive.CABLE] = 0.0
    load, before = plant.holding(motion.q[0]), np.zeros(n)
    data.qpos[address] = motion.q[0]
    data.qpos[twist] = -(load / k_gear + np.sign(load) * 0.5 * plant.gap)[elastic]
    controller, out, x = np.zeros((STATES, n)), np.zeros((RESULTS, n)), np.zeros((5, n))
    kinds = plant.regularisation
    # Bristles are lightly damped against the rotor.
    damped = np.where((kinds == BRISTLE) | (kinds == DAHL),
                      0.6 * np.sqrt(plant.block[0] / plant.presliding * plant.rotor), 0.0)
    rub, hard = np.array([kinds, plant.v_smooth, plant.presliding, damped]), kinds == CONSTRAINT
    log, qpos, qvel = np.zeros((3, N, n)), data.qpos, data.qvel
    for k in range(N):
        q, v = qpos[address], qvel[address]
        drive_step(k, plant.cycle, block, controller, np.array([q, load, v]), wanted[k], out)
        log[0, k], log[1, k], log[2, k] = q, q, out[BELIEVED]
        if len(twist):
            log[1, k, elastic] += qpos[twist]
        _friction_of(rub, out, v, x)
        model.dof_frictionloss[address], model.dof_damping[address], data.qfrc_applied[address] = x[1], x[2], x[3]
        mujoco.mj_step(model, data)
        now = qvel[address]
        dry = np.where(hard, -data.qfrc_constraint[address], 0.0)
        load = out[ACTING] - x[4] - dry - plant.rotor * (now - before) / STEP
        before = now
    if not np.isfinite(log[0]).all() or np.abs(log[0] - motion.q).max() > 2.0:
        raise RuntimeError("the plant left its path")
    return Run(motion.t, motion.q, *log)


_CYCLE = 0.002
"""Interpolation cycle that the arm is driven with [s]."""
_SETTLING = 2.0
"""Time for which an arm with a spring is held where its motion begins before that is recorded [s]."""
_BY_WORLD = (drive.COULOMB, drive.SURPLUS, drive.LOAD, drive.VISCOUS, drive.DEGRESSIVE, drive.RIPPLE)
"""Rows that the world has keys for."""
_BY_TORQUE = (drive.DRY_THERMAL, drive.DRIVING, drive.PLACE, drive.DRAG, drive.VISCOUS_SIDE, drive.VISCOUS_THERMAL,
              drive.CABLE, drive.BUMP, drive.HOSE, drive.PULSE, drive.OFFSET)
"""Rows that it has none for: sizes of effects that act as additional torque."""


def world_of(plant: Plant) -> World:
    """The plant as a world: nothing else in it than what the plant says."""
    block, limit = plant.block, 1.0e3 * plant.arm.need

    def each(values: Array) -> tuple[float, ...]:
        return tuple(float(v) for v in values)

    coulomb = np.maximum(block[drive.COULOMB], 1e-9)
    # A limit that is never reached: the world counts load and ripple relative to it.
    k_gear, d_gear = plant.springs()
    return World(
        robot="stranger", stiffness=each(np.where(plant.elastic, k_gear, np.inf)),
        damping=each(np.where(plant.elastic, d_gear, 1.0)), backlash=each(plant.gap), friction=True,
        coulomb=each(coulomb), stribeck=each(block[drive.SURPLUS]),
        stribeck_velocity=each(np.maximum(block[drive.V_SURPLUS], 1e-3)),
        presliding=each(plant.presliding), viscous=each(block[drive.VISCOUS]),
        degressive=each(block[drive.DEGRESSIVE]), degressive_velocity=each(block[drive.V_DEGRESSIVE]),
        load_friction=each(block[drive.LOAD] * limit / coulomb), thermal=False, quantisation=False, current_noise=0.0,
        torque_limits=True, torque_ripple=each(np.abs(block[drive.RIPPLE]) / limit), ripple_order=1.0,
        low_pass=0.0, correction_delay=False, t_ipo=_CYCLE, t_position=0.001, t_velocity=STEP,
        position_gain=each(block[drive.C_KV]), velocity_feedforward=each(block[drive.C_KFF]),
        velocity_gain=each(block[drive.C_KP]),
        integral_time=each(block[drive.C_KP] / np.maximum(block[drive.C_KI], 1e-9)), velocity_filter=0.001,
        current_lag=0.0, inertia_tolerance=0.0, drive_gain_error=0.0, log_cycle=STEP)


def robot_of(plant: Plant, folder: Path) -> Robot:
    """The robot whose data sheet is the plant itself, limits out of the way."""
    robot, n = written(plant.arm.urdf, folder / "stranger.urdf"), plant.n
    # The world counts the ripple's order per motor turn.
    order = np.where(plant.block[drive.RIPPLE] != 0.0, plant.block[drive.RIPPLE_ORDER], 1.0)
    return dataclasses.replace(robot, pinocchio=plant.model, rotor_inertia=plant.rotor, drive_gain=np.ones(n),
                               tau_max=1.0e3 * plant.arm.need, v_max=np.full(n, np.inf), gear_ratio=order,
                               q_min=np.full(n, -1e3), q_max=np.full(n, 1e3), t_ipo=_CYCLE)


def _rest(plant: Plant) -> Callable[[float, Array, Array, Array], Array] | None:
    """The torque of what the world has no key for, friction of it with a smooth sign; None where there is nothing."""
    block, plain = plant.block.copy(), drive.parameters(plant.n)
    block[list(_BY_WORLD)] = 0.0
    if not plant.balancers and not block[list(_BY_TORQUE)].any():
        return None
    rows = [*_BY_WORLD, drive.V_SURPLUS, drive.V_DEGRESSIVE]
    plain[rows] = plant.block[rows]
    carries = _Load(plant) if block[drive.DRIVING].any() else None
    zero = np.zeros(plant.n)

    def torque(t: float, q: Array, v: Array, q_a: Array) -> Array:
        load = zero if carries is None else carries(t, q_a)
        result = np.empty(plant.n)
        for j in range(plant.n):
            speed, carried = float(v[j]), float(load[j])
            # Effects may lower friction: the whole less the world's share.
            level = (drive.dry_level(plant.block, j, t, q, speed, carried)
                     - drive.dry_level(plain, j, t, q, speed, carried))
            fluid = drive.fluid(plant.block, j, t, speed) - drive.fluid(plain, j, t, speed)
            result[j] = (-drive.resisted(block, j, t, float(q[j])) - block[drive.OFFSET, j] - fluid * speed
                         - level * math.tanh(speed / 2e-3))
        for spring in plant.balancers:
            result[spring.joint] -= spring.torque(float(q[spring.joint]))
        return result

    return torque


class _Load:
    """Torque at the gears' outputs ``(n,)`` [N m], by what the arm did in its last two steps; its weight at first.

    Args:
        plant: the arm.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._data = plant, plant.model.createData()
        self._seen: list[tuple[float, Array]] = []

    def __call__(self, t: float, q_a: Array) -> Array:
        self._seen = [*self._seen[-2:], (t, q_a.copy())]
        if len(self._seen) < 3:
            return self._plant.holding(q_a)
        (first, a), (middle, b), (last, c) = self._seen
        earlier, later = (b - a) / (middle - first), (c - b) / (last - middle)
        acceleration = (later - earlier) / (last - middle)
        return np.asarray(pin.rnea(self._plant.model, self._data, q_a, later, acceleration)).copy()


def _in_pybullet(plant: Plant, motion: Motion) -> Run:
    """Plays a motion on a plant.

    Args:
        plant: the arm; its way through standstill is that of the world, by bristles.
        motion: desired motion, every ``STEP``.
    """
    with tempfile.TemporaryDirectory(prefix="stranger-") as folder:
        robot = robot_of(plant, Path(folder))
        world = world_of(plant).replace(extra_torque=_rest(plant))
        # The world begins with weights held, but no spring: what it pulls is taken up before anything is recorded.
        settling = 0 if not plant.balancers else round(_SETTLING / _CYCLE)
        with SimulatedArm(robot, world, np.random.default_rng(0), motion.q[0]) as arm:
            pybullet.setGravity(*[float(g) for g in plant.model.gravity.linear], physicsClientId=arm.client)
            every = round(_CYCLE / STEP)
            for _ in range(settling):
                arm.cycle(motion.q[0])
            for k in range(every, len(motion.t), every):
                arm.cycle(motion.q[k])
            history = {name: values[settling * every :] for name, values in arm.history().items()}
    history["t"] = history["t"] - history["t"][0]
    rows = len(history["t"])
    if not np.isfinite(history["q"]).all() or np.abs(history["q"] - motion.q[:rows]).max() > 2.0:
        raise RuntimeError("the plant left its path")
    return Run(history["t"], motion.q[:rows], history["q"], history["q_a"], history["tau"])


def dart() -> Any:
    """The module of DART.

    Raises:
        InputError: it is not installed, or the system lacks what its viewer is linked to.
    """
    try:
        import dartpy
    except ImportError as error:
        raise InputError(f"DART cannot be loaded ({error}): pip install dartpy, and on Linux apt-get install libgl1",
                         field="--engine", value="dart") from error
    return dartpy


def _tree(plant: Plant) -> Any:
    """The plant in DART: joints ``m1 …`` of the motors, ``s1 …`` of the twist of gears that are not rigid.

    DART's joint damping D is implicit: with D = J/STEP, and ``D v`` given back as torque, a joint has a rotor's J.
    """
    dartpy = dart()
    tree, dynamics, body = dartpy.dynamics.Skeleton("stranger"), dartpy.dynamics, None
    tree.setTimeStep(STEP)
    tree.setGravity(plant.model.gravity.linear)
    slides, axes, (k_gear, d_gear) = sliding(plant.model), joint_axes(plant.model), plant.springs()

    def below(name: str, j: int, placement: pin.SE3) -> Any:
        kind = "Prismatic" if slides[j] else "Revolute"
        properties = getattr(dynamics, f"{kind}JointProperties")()
        properties.mName, properties.mAxis = f"{name}{j + 1}", axes[j, :3] if slides[j] else axes[j, 3:]
        properties.mT_ParentBodyToJoint = dartpy.math.Isometry3(placement.homogeneous)
        return getattr(tree, f"create{kind}JointAndBodyNodePair")(body, properties)

    for j in range(plant.n):
        joint, body = below("m", j, plant.model.jointPlacements[j + 1])
        joint.setDampingCoefficient(0, plant.rotor[j] / STEP)
        if plant.elastic[j]:
            body.setInertia(dynamics.Inertia(1e-9, np.zeros(3), 1e-12 * np.eye(3)))
            joint, body = below("s", j, pin.SE3.Identity())
            joint.setSpringStiffness(0, k_gear[j])
            joint.setDampingCoefficient(0, d_gear[j])
        link = plant.model.inertias[j + 1]
        body.setInertia(dynamics.Inertia(link.mass, link.lever, link.inertia))
    return tree


def _in_dart(plant: Plant, motion: Motion) -> Run:
    n, N, tree, block = plant.n, len(motion.t), _tree(plant), plant.block
    dofs = {dof.getName(): i for i, dof in enumerate(tree.getDofs())}
    motor, elastic = np.array([dofs[f"m{j + 1}"] for j in range(n)]), np.flatnonzero(plant.elastic)
    twist = np.array([dofs[f"s{j + 1}"] for j in elastic], dtype=int)
    (k_gear, d_gear), load = plant.springs(), plant.holding(motion.q[0])
    stops = [(dofs[f"s{j + 1}"], 0.5 * plant.gap[j], k_gear[j], d_gear[j]) for j in np.flatnonzero(plant.gap)]
    q, force = np.zeros(len(dofs)), np.zeros(len(dofs))
    q[motor], q[twist] = motion.q[0], -(load / k_gear + np.sign(load) * 0.5 * plant.gap)[elastic]
    tree.setPositions(q)
    x, out = plant.held(motion.q[0]), np.zeros((RESULTS, n))
    slip, friction = np.zeros((drive.ELEMENTS, n)), np.zeros(n)
    # The elements are lightly damped against the rotor.
    damping = 0.6 * np.sqrt(block[drive.COULOMB] / plant.presliding * plant.rotor)
    wanted, log = plant.wanted(motion), np.zeros((3, N, n))
    for k in range(N):
        q, v = tree.getPositions(), tree.getVelocities()[motor]
        log[0, k] = log[1, k] = q[motor]
        log[1, k, elastic] += q[twist]
        drive.observer_step(k, plant.cycle, block, x, np.array([log[0, k], load, v]), wanted[k], out)
        log[2, k] = out[BELIEVED]
        drive.slipped(out[LEVEL], plant.presliding, damping, v, slip, friction)
        acts = out[ACTING] - friction - out[FLUID] * v
        for s in plant.balancers:
            acts[s.joint] -= s.torque(float(log[0, k, s.joint]))
        force[motor] = acts + plant.rotor / STEP * v
        for i, half, stiffness, damper in stops:
            joint, touches = tree.getJoint(i), float(abs(q[i]) > half)
            joint.setRestPosition(0, math.copysign(half, q[i]))
            joint.setSpringStiffness(0, touches * stiffness)
            joint.setDampingCoefficient(0, touches * damper)
        tree.setForces(force)
        tree.computeForwardDynamics()
        tree.integrateVelocities(STEP)
        tree.integratePositions(STEP)
        load = acts - plant.rotor * (tree.getVelocities()[motor] - v) / STEP
    if not np.isfinite(log[0]).all() or np.abs(log[0] - motion.q).max() > 2.0:
        raise RuntimeError("the plant left its path")
    # The drive reports what its encoder read.
    log[0] = block[drive.O_COUNT] * np.round(log[0] / block[drive.O_COUNT])
    return Run(motion.t, motion.q, *log)


Engine = Callable[[Plant, Motion], Run]

ENGINES: dict[str, Engine] = {
    "mujoco": _in_mujoco, "pybullet": _in_pybullet, "integrator": integrator.simulate, "dart": _in_dart,
}
TURNS = ("mujoco", "pybullet", "integrator")
"""The engines that the diagnosis was made with, in which seeds are drawn by turns."""
NOT_IN = {"pybullet": frozenset({"axis_coupling", "drive_gain"}), "dart": frozenset({"axis_coupling"})}
"""Effects that an engine has no means for."""
