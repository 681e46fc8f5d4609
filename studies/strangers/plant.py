"""A plant: the true arm with its drives, as every engine is to build it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array
from studies.strangers import drive
from studies.strangers.arm import STEP, Arm, Motion

CONSTRAINT, TANH, BRISTLE, DAHL, MAXWELL = range(5)
"""How friction passes through standstill: hard, smooth in velocity, by bristles with damping, by Dahl's state, by
Maxwell's elements, which only the arm under an observer has."""
REGULARISATIONS = ("constraint", "tanh", "bristle", "dahl", "maxwell")
CONTROLLERS = ("cascade", "pd_gravity", "computed_torque")


@dataclass(frozen=True)
class Coupling:
    """A motor shaft that turns with two joints, with inertia and friction of its own.

    Attributes:
        joint, partner: from 0.
        sense: the shaft turns at ``qd_joint + sense qd_partner``.
        inertia, viscous, dry: [kg m², N m s/rad, N m].
    """

    joint: int
    partner: int
    sense: float
    inertia: float
    viscous: float
    dry: float


@dataclass(frozen=True)
class BalanceSpring:
    """A spring between a point of the link before and one of the link after a joint.

    Attributes:
        joint: from 0.
        stiffness, rest: [N/m, m].
        reach, lever: distances of the two points from the axis [m].
        angle: joint angle at which the points lie on one side [rad].
    """

    joint: int
    stiffness: float
    rest: float
    reach: float
    lever: float
    angle: float

    def torque(self, q: float) -> float:
        """Torque that the motor works against [N m]: dU/dq of ``k/2 (l - rest)²``."""
        length = math.sqrt(self.reach**2 + self.lever**2 - 2.0 * self.reach * self.lever * math.cos(q - self.angle))
        return self.stiffness * (length - self.rest) * self.reach * self.lever * math.sin(q - self.angle) / length


@dataclass(frozen=True)
class Plant:
    """The true arm.

    Attributes:
        arm: as drawn; its URDF and the ranges of motion.
        model: the true rigid body of this plant, gravity direction included; rotors not.
        block: friction, effects and controller of all drives, see ``drive``.
        rotor: inertia on the motor side ``(n,)`` [kg m²].
        stiffness, damping: of the gears ``(n,)``; infinite is rigid.
        gap: full backlash of the gears ``(n,)`` [rad]; a rigid gear with backlash gets a stiff stop.
        regularisation: of each joint's dry friction ``(n,)``.
        v_smooth: velocity over which ``tanh`` passes zero ``(n,)`` [rad/s].
        presliding: displacement over which bristles yield ``(n,)`` [rad].
        controller: one of ``CONTROLLERS``, or ``observer`` in the engine that was left out.
        cycle: of the controller, in steps.
        known: the controller's own idea of the rigid body, with errors.
        couplings, balancers: of some joints; two effects of a recording may be of one kind.
        filtered: time over which the command is averaged before an observer's drive gets it, twice [s].
    """

    arm: Arm
    model: pin.Model
    block: Array
    rotor: Array
    stiffness: Array
    damping: Array
    gap: Array
    regularisation: np.ndarray
    v_smooth: Array
    presliding: Array
    controller: str
    cycle: int
    known: pin.Model
    couplings: tuple[Coupling, ...] = ()
    balancers: tuple[BalanceSpring, ...] = ()
    filtered: float = 0.0

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n

    @property
    def elastic(self) -> np.ndarray:
        """Which gears have a motor that is not rigidly the link ``(n,)``."""
        return np.isfinite(self.stiffness) | (self.gap > 0.0)

    def springs(self) -> tuple[Array, Array]:
        """Stiffness and damping of all gears ``(n,)``, with the stop of rigid gears that have backlash."""
        stop = (2.0 * np.pi * 40.0) ** 2 * self.arm.mass
        k = np.where(np.isfinite(self.stiffness), self.stiffness, stop)
        return k, np.where(np.isfinite(self.stiffness), self.damping, 0.1 * np.sqrt(k * self.arm.mass))

    def wanted(self, motion: Motion) -> Array:
        """What the drives are given ``(N, 3, n)``: position, velocity, and the torque sent ahead of their loops.

        An observer's drives get the path averaged twice, and its acceleration in the place of a torque.
        """
        if self.controller == "observer":
            path, taps = motion.q - motion.q[0], max(round(self.filtered / STEP), 1)
            for _ in range(2):
                path = signal.lfilter(np.full(taps, 1.0 / taps), 1.0, path, axis=0)
            speed = np.gradient(path, STEP, axis=0)
            return np.stack([motion.q[0] + path, speed, np.gradient(speed, STEP, axis=0)], axis=1)
        forward = np.zeros_like(motion.q)
        if self.controller != "cascade":
            rows = np.unique(np.append(np.arange(0, len(motion.t), 8), len(motion.t) - 1))
            data, zero = self.known.createData(), np.zeros(self.n)
            coarse = np.array([
                pin.rnea(self.known, data, motion.q[k], zero, zero) if self.controller == "pd_gravity"
                else pin.rnea(self.known, data, motion.q[k], motion.qd[k], motion.qdd[k]) + self.rotor * motion.qdd[k]
                for k in rows])
            for j in range(self.n):
                forward[:, j] = np.interp(motion.t, motion.t[rows], coarse[:, j])
        return np.stack([motion.q, motion.qd, forward], axis=1)

    def holding(self, q: Array) -> Array:
        """Gravity torque at rest ``(n,)`` [N m]."""
        return np.asarray(pin.computeGeneralizedGravity(self.model, self.model.createData(), q)).copy()

    def held(self, q: Array) -> Array:
        """State of an observer's drives that hold the arm at ``q (n,)``, ``(drive.OBSERVER_STATES, n)``."""
        x, torque = np.zeros((drive.OBSERVER_STATES, self.n)), self.holding(q)
        for j in range(self.n):
            torque[j] += drive.resisted(self.block, j, 0.0, q[j])
        for spring in self.balancers:
            torque[spring.joint] += spring.torque(float(q[spring.joint]))
        x[drive.SEEN_Q], x[drive.NEXT :] = q, self.block[drive.GAIN] * torque + self.block[drive.OFFSET]
        x[drive.DISTURBED] = -x[drive.CURRENT] / self.block[drive.O_INERTIA]
        return x


@dataclass(frozen=True)
class Run:
    """What happened, every step: before any logger.

    Attributes:
        t: ``(N,)`` [s].
        q_d: desired, ``q`` motor, ``qa`` arm positions, ``tau`` torque the controller believes in, all ``(N, n)``.
    """

    t: Array
    q_d: Array
    q: Array
    qa: Array
    tau: Array


def draw_plant(rng: np.random.Generator, arm: Arm) -> Plant:
    """A healthy plant: dry and viscous friction, rotors, gears rigid or elastic everywhere, one way through standstill.

    Args:
        rng: source of the draw.
        arm: to be driven.
    """
    n = arm.n
    block = drive.parameters(n)
    block[drive.COULOMB] = arm.need * rng.uniform(0.08, 0.3, n)
    block[drive.VISCOUS] = arm.need * rng.uniform(0.05, 0.25, n) / arm.fast
    # The last axes of real arms are driven by rotors far heavier than what hangs on them, as the joint feels it.
    rotor = arm.mass * rng.uniform(0.3, 1.2, n) + 0.01 * np.max(arm.mass)
    elastic = rng.random() < 0.45
    frequency = rng.uniform(14.0, 35.0, n)
    link = np.maximum(arm.mass, 0.2 * rotor)
    stiffness = (2.0 * np.pi * frequency) ** 2 * link if elastic else np.full(n, np.inf)
    damping = 2.0 * rng.uniform(0.04, 0.1) * np.sqrt(np.where(np.isfinite(stiffness), stiffness, 0.0) * link)
    known = arm.model.copy()
    for i in range(1, known.njoints):
        body = known.inertias[i]
        factor = rng.uniform(0.8, 1.2)
        known.inertias[i] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)
    controller = str(rng.choice(CONTROLLERS))
    cycle = int(rng.choice([1, 2]))
    pace = rng.uniform(35.0, 70.0)
    inertia = rotor + (0.3 if elastic else 1.0) * arm.mass
    block[drive.C_KP] = inertia * pace
    block[drive.C_KV] = rng.uniform(12.0, 25.0) if controller == "cascade" else rng.uniform(0.25, 0.4) * pace
    block[drive.C_KFF] = rng.choice([0.0, 0.6, 0.95, 1.0]) if controller == "cascade" else 1.0
    block[drive.C_KI] = block[drive.C_KP] / (rng.uniform(0.05, 0.15) if controller == "cascade" else 0.6)
    block[drive.C_FILTER] = rng.choice([0.4, 0.7, 1.0])
    kind = int(rng.integers(4))
    return Plant(arm, arm.model, block, rotor, stiffness, damping, np.zeros(n), np.full(n, kind),
                 np.full(n, float(np.exp(rng.uniform(np.log(5e-4), np.log(5e-3))))),
                 np.exp(rng.uniform(np.log(2e-4), np.log(1.5e-3), n)), controller, cycle, known)


def with_observer(rng: np.random.Generator, plant: Plant) -> Plant:
    """The same arm with drives of another make and Maxwell's elements in all joints.

    The observer is three to five times as fast as the loop (Gao 2003; Herbst 2013). As a commissioner would, it stays
    below a fifth over the delay of cycle and current loop and below the frequency of soft gears. Encoders count 2^14
    to 2^20 a turn of the motor behind gears of 60 to 160.

    Args:
        rng: source of the draw.
        plant: healthy, as ``draw_plant`` has it.
    """
    n, block = plant.n, plant.block.copy()
    elastic = bool(plant.elastic.any())
    cycle = int(rng.choice([1, 2, 4]))
    block[drive.O_CURRENT] = rng.uniform(3e-4, 1e-3)
    block[drive.O_INERTIA] = (plant.rotor + (0.3 if elastic else 1.0) * plant.arm.mass) * rng.uniform(0.7, 1.2, n)
    ratio = rng.uniform(3.0, 5.0)
    watch = np.full(n, min(rng.uniform(15.0, 30.0) * ratio, 0.2 / (1.5 * cycle * STEP + block[drive.O_CURRENT, 0])))
    if elastic:
        watch = np.minimum(watch, 0.6 * np.sqrt(plant.stiffness / np.maximum(plant.arm.mass, 0.2 * plant.rotor)))
    block[drive.O_WATCH], block[drive.O_PACE] = watch, watch / ratio
    block[drive.O_COUNT] = 2.0 * np.pi / (2.0 ** rng.integers(14, 21) * rng.uniform(60.0, 160.0, n))
    return replace(plant, block=block, controller="observer", cycle=cycle, regularisation=np.full(n, MAXWELL),
                   filtered=float(rng.uniform(0.004, 0.02)))
