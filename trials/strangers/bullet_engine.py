"""Our PyBullet arm as the plant: its world keys where it has them, the rest as additional torque on the motors."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.bullet import pybullet
from trials.strangers import drive
from trials.strangers.integrator import spring_torque
from trials.strangers.motion import STEP, Motion
from trials.strangers.plant import Plant, Run

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
    path = folder / "stranger.urdf"
    path.write_text(plant.arm.urdf, encoding="utf-8")
    robot, n = Robot.load(path), plant.n
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
            result[spring.joint] -= spring_torque(spring, float(q[spring.joint]))
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


def simulate(plant: Plant, motion: Motion) -> Run:
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
