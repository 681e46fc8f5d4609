"""A plant: the true arm with its drives, as every engine is to build it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from studies.strangers import drive
from studies.strangers.arm import Arm, Motion

CONSTRAINT, TANH, BRISTLE, DAHL = range(4)
"""How friction passes through standstill: hard, smooth in velocity, by bristles with damping, by Dahl's state."""
REGULARISATIONS = ("constraint", "tanh", "bristle", "dahl")
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
        controller: one of ``CONTROLLERS``.
        cycle: of the controller, in steps.
        known: the controller's own idea of the rigid body, with errors.
        couplings, balancers: of some joints; two effects of a recording may be of one kind.
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
        """Desired position and velocity, and the torque that the controller sends ahead of its loops ``(N, 3, n)``."""
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
