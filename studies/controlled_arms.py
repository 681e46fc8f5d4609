"""Arms behind joint controllers of many kinds, integrated plainly or by MuJoCo: what a command law is judged on.

Nothing here is shared with the model side or with the simulated world: forward dynamics are Pinocchio's or MuJoCo's,
friction is a smooth Coulomb law with viscous friction or MuJoCo's own, and each controller is written as its maker
would. MuJoCo has gears as springs where they are asked for; controllers and loggers see the motors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

STEP = 1e-3
"""Of the integration and of the controllers' inner loops [s]."""


@dataclass(frozen=True)
class Gains:
    """What is drawn of a controller; each kind uses what it has.

    Attributes:
        position: of the position loop [1/s].
        velocity: bandwidth of the velocity loop [1/s].
        reset: of its integrator [s].
        late: commands act so much later [s].
        filter: moving average, lag or the square root of the second-order smoothing [s]; see the kinds.
        share: of the velocity that is fed forward; by how much the gains change over the postures.
    """

    position: float = 20.0
    velocity: float = 80.0
    reset: float = 0.05
    late: float = 0.004
    filter: float = 0.0
    share: float = 0.0


@dataclass
class Plant:
    """An arm with its true bodies and friction, and a controller.

    Attributes:
        robot: kinematics and limits; its inertias are scaled by ``bodies``.
        kind: key of ``KINDS``.
        gains: of its controller.
        friction: Coulomb friction over the joint's largest holding torque.
        bodies: true masses over the URDF's.
        encoder: step of the positions [rad].
        torque_noise: standard deviation of logged torques over the joint's largest holding torque.
        engine: ``plain`` or ``mujoco``.
        elastic: whether gears are springs; MuJoCo's alone.
    """

    robot: Robot
    kind: str
    gains: Gains = field(default_factory=Gains)
    friction: float = 0.1
    bodies: float = 1.08
    encoder: float = 1e-5
    torque_noise: float = 0.01
    engine: str = "plain"
    elastic: bool = False

    def __post_init__(self) -> None:
        self.model = self.robot.pinocchio.copy()
        for i in range(1, self.model.njoints):
            body = self.model.inertias[i]
            self.model.inertias[i] = pin.Inertia(self.bodies * body.mass, body.lever, self.bodies * body.inertia)
        self.data = self.model.createData()
        n = self.model.nv
        M = np.mean([pin.crba(self.model, self.data, q) for q in self._postures()], axis=0)
        M = np.triu(M) + np.triu(M, 1).T
        # Rotors as heavy as what the joint moves, at most what makes a small wrist joint turn well.
        self.rotor = np.where(self.robot.rotor_inertia > 0.0, self.robot.rotor_inertia, 0.3 * np.diag(M) + 0.02)
        self.model.armature = self.rotor
        self.inertia = np.diag(M) + self.rotor
        holding = np.max([np.abs(pin.computeGeneralizedGravity(self.model, self.data, q)) for q in self._postures()],
                         axis=0)
        self.scale = np.maximum(holding, 10.0 * self.inertia)
        self.dry = self.friction * self.scale * np.linspace(1.0, 0.6, n)
        self.viscous = 0.3 * self.dry
        # 12 Hz of the joint's own inertia against the motor: as gears of industrial arms.
        self.stiffness = self.inertia * (2.0 * np.pi * 12.0) ** 2
        self.nominal = self.robot.pinocchio.copy()
        self.nominal.armature = self.rotor
        self.nominal_data = self.nominal.createData()

    def holding(self, q: Array) -> Array:
        """Torque that holds the arm at rest ``(n,)`` [N m]."""
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, np.asarray(q, dtype=float)))

    def _postures(self) -> Array:
        rng = np.random.default_rng(0)
        return self.robot.home + rng.uniform(-0.7, 0.7, (24, self.model.nv))

    def run(self, q_c: Array, t_cycle: float, t_log: float, rng: np.random.Generator) -> Recording:
        """The recording of commands ``(N, n)`` handed over every ``t_cycle`` [s], logged every ``t_log`` [s]."""
        at_work = AtWork(self, q_c[0], t_cycle, t_log, rng)
        for command in q_c:
            at_work.cycle(command)
        return at_work.recording()


class AtWork:
    """A plant that is commanded cycle by cycle, a ``RobotInterface``.

    Args:
        plant, q0: the arm, and where it rests ``(n,)`` [rad].
        t_ipo, t_log: from command to command, and from row to row of the log [s].
        rng: of the noise of logged torques.
    """

    def __init__(self, plant: Plant, q0: Array, t_ipo: float, t_log: float, rng: np.random.Generator) -> None:
        self.plant, self.t_ipo, self.rng = plant, t_ipo, rng
        self.every, self.log = round(t_ipo / STEP), round(t_log / STEP)
        self.law = KINDS[plant.kind](plant)
        self.engine: PlainEngine | MuJoCoEngine = (MuJoCoEngine if plant.engine == "mujoco" else PlainEngine)(plant, q0)
        self.law.start(np.array(q0), plant.holding(q0))
        self.late = plant.gains.late
        self.ticks, self.before, self.last = 0, np.array(q0), np.array(q0)
        self.seen: list[Array] = [np.array(q0)]
        self.filters = [np.array(q0), np.array(q0)]
        self.rows: list[tuple[Array, Array, Array]] = []

    def cycle(self, q_c: Array) -> RobotState:
        """See ``RobotInterface.cycle``; lines from command to command, reached a cycle later."""
        q_c = np.asarray(q_c, dtype=float)
        for k in range(self.every):
            self.seen.append(self.last + (k + 1.0) / self.every * (q_c - self.last))
            r = self._smoothed()
            tau = self.law.torque(r, (r - self.before) / STEP, self.engine.q, self.engine.v)
            self.before = r
            if self.ticks % self.log == 0:
                self.rows.append((q_c, *self._measured(tau)))
            self.engine.step(tau)
            self.ticks += 1
        self.last = q_c
        q, torque = self._measured(tau)
        return RobotState(self.ticks * STEP, q, torque)

    def _measured(self, tau: Array) -> tuple[Array, Array]:
        plant = self.plant
        return (plant.encoder * np.round(self.engine.q / plant.encoder),
                tau + plant.torque_noise * plant.scale * self.rng.standard_normal(len(tau)))

    def _smoothed(self) -> Array:
        """What the inner loops see of the commands now ``(n,)``."""
        g, late = self.plant.gains, round(self.late / STEP)
        if self.plant.kind == "moving_average":
            width = max(1, round(g.filter / STEP))
            rows = [self.seen[max(len(self.seen) - 1 - late - i, 0)] for i in range(width)]
            return np.asarray(np.mean(rows, axis=0))
        r = self.seen[max(len(self.seen) - 1 - late, 0)]
        stages = {"lag": 1, "smoothed": 2}.get(self.plant.kind, 0)
        for i in range(stages):
            r = self.filters[i] = self.filters[i] + (1.0 - np.exp(-STEP / g.filter)) * (r - self.filters[i])
        return r

    def recording(self) -> Recording:
        """What was logged: commands, angles, torques."""
        q_c, q, tau = (np.array(rows) for rows in zip(*self.rows, strict=True))
        return Recording.from_arrays(self.log * STEP * np.arange(float(len(q))), q_c=q_c, q=q, tau=tau,
                                     meta={"cycle_time": self.t_ipo})


class PlainEngine:
    """Rigid links by Pinocchio, semi-implicitly."""

    def __init__(self, plant: Plant, q0: Array) -> None:
        self.plant, self.q, self.v = plant, np.array(q0, dtype=float), np.zeros(len(q0))

    def step(self, tau: Array) -> None:
        """One step with motor torques ``(n,)``; friction implicitly, so that it stops a joint and drives none back."""
        plant, v = self.plant, self.v
        M = pin.crba(plant.model, plant.data, self.q)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(plant.model, plant.data, self.q, v)
        slope = plant.dry / 0.01 / (1.0 + np.abs(v) / 0.01) + plant.viscous
        self.v = np.linalg.solve(M + STEP * np.diag(slope), M @ v + STEP * (tau - bias))
        self.q = self.q + STEP * self.v


class MuJoCoEngine:
    """Links, and gears as springs where ``plant.elastic``, by MuJoCo, with its own dry friction."""

    def __init__(self, plant: Plant, q0: Array) -> None:
        import mujoco

        self.plant, self._mujoco = plant, mujoco
        self.model = mujoco.MjModel.from_xml_string(_mjcf(plant))
        self.data = mujoco.MjData(self.model)
        self._motors = np.array([self.model.joint(f"m{j + 1}").qposadr[0] for j in range(len(q0))])
        self.data.qpos[self._motors] = q0
        if plant.elastic:
            twists = np.array([self.model.joint(f"s{j + 1}").qposadr[0] for j in range(len(q0))])
            self.data.qpos[twists] = -plant.holding(q0) / plant.stiffness

    @property
    def q(self) -> Array:
        """Motor angles ``(n,)`` [rad]."""
        return np.array(self.data.qpos[self._motors])

    @property
    def v(self) -> Array:
        """Motor speeds ``(n,)`` [rad/s]."""
        return np.array(self.data.qvel[self._motors])

    def step(self, tau: Array) -> None:
        """See ``PlainEngine.step``; MuJoCo goes in steps of a quarter."""
        self.data.qfrc_applied[self._motors] = tau
        for _ in range(_FINER):
            self._mujoco.mj_step(self.model, self.data)


_FINER = 4


def _mjcf(plant: Plant) -> str:
    def text(values: Array | list[float]) -> str:
        return " ".join(f"{float(x):.12g}" for x in values)

    model, closing = plant.model, ""
    parts = [f'<mujoco><compiler angle="radian" autolimits="false" boundmass="1e-9" boundinertia="1e-12"/><option '
             f'timestep="{STEP / _FINER}" integrator="implicitfast" gravity="{text(model.gravity.linear)}"><flag '
             'contact="disable"/></option><worldbody>']
    for j in range(model.nv):
        place, body = model.jointPlacements[j + 1], model.inertias[j + 1]
        jacobian = pin.computeJointJacobian(model, model.createData(), pin.neutral(model), j + 1)
        axis = np.asarray(jacobian).reshape(6, -1)[:, j]
        kind = "hinge" if np.linalg.norm(axis[3:]) > 0.5 else "slide"
        axis = axis[3:] if kind == "hinge" else axis[:3]
        turn = pin.Quaternion(place.rotation)
        parts.append(f'<body pos="{text(place.translation)}" quat="{text([turn.w, turn.x, turn.y, turn.z])}"><joint '
                     f'name="m{j + 1}" type="{kind}" axis="{text(axis)}" armature="{plant.rotor[j]:.12g}" '
                     f'frictionloss="{plant.dry[j]:.12g}" damping="{plant.viscous[j]:.12g}"/>')
        closing = "</body>" + closing
        if plant.elastic:
            k = plant.stiffness[j]
            parts.append(f'<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/><body><joint '
                         f'name="s{j + 1}" type="{kind}" axis="{text(axis)}" stiffness="{k:.12g}" '
                         f'damping="{0.1 * np.sqrt(k * plant.inertia[j]):.12g}"/>')
            closing = "</body>" + closing
        i = body.inertia
        full = text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
        parts.append(f'<inertial pos="{text(body.lever)}" mass="{body.mass:.12g}" fullinertia="{full}"/>')
    return "".join(parts) + closing + "</worldbody></mujoco>"


class PPI:
    """P position loop over a PI velocity loop."""

    feedforward = 0.0

    def __init__(self, plant: Plant) -> None:
        g = plant.gains
        self.k_v, self.k_p, self.k_ff = g.position, g.velocity * plant.inertia, self.feedforward and g.share
        self.k_i = self.k_p / g.reset

    def start(self, q: Array, hold: Array) -> None:
        """Holds the arm at rest."""
        self.integral = hold / self.k_i

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """Of the motors ``(n,)`` [N m]."""
        k_v = self.k_v * self.factor(q)
        u = k_v * (r - q) + self.k_ff * rd - v
        self.integral = self.integral + STEP * u
        return self.k_p * u + self.k_i * self.integral

    def factor(self, q: Array) -> Array | float:
        """Gain over its usual value in a posture."""
        return 1.0


class FedForward(PPI):
    """The same with velocity fed forward."""

    feedforward = 1.0

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.k_ff = plant.gains.share or 0.9


class ByPosture(PPI):
    """The same with a position gain that changes with the posture of its own joint and the one before."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.share = plant.gains.share or 0.35
        self.home = plant.robot.home

    def factor(self, q: Array) -> Array:
        """See ``PPI.factor``."""
        return 1.0 + self.share * np.sin(1.5 * (q - self.home) + 0.7 * np.roll(q - self.home, 1))


class Impedance:
    """Stiffness and damping, gravity and Coriolis torques compensated with the nominal bodies."""

    def __init__(self, plant: Plant) -> None:
        w = 2.0 * plant.gains.position
        self.k, self.d = plant.inertia * w**2, 1.4 * plant.inertia * w
        self.model, self.data = plant.nominal, plant.nominal_data

    def start(self, q: Array, hold: Array) -> None:
        """Nothing is remembered."""

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """See ``PPI.torque``."""
        return self.k * (r - q) - self.d * v + pin.nonLinearEffects(self.model, self.data, q, v)


class PID:
    """PID on the position error, nothing known of the arm."""

    def __init__(self, plant: Plant) -> None:
        w = 3.0 * plant.gains.position
        self.k, self.d, self.i = plant.inertia * w**2, 1.4 * plant.inertia * w, plant.inertia * w**2 / 0.15

    def start(self, q: Array, hold: Array) -> None:
        """Holds the arm at rest."""
        self.integral = hold / self.i

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """See ``PPI.torque``."""
        e = r - q
        self.integral = self.integral + STEP * e
        smooth = getattr(self, "rate", 0.0 * rd)
        self.rate = smooth + 0.2 * (rd - smooth)
        return self.k * e + self.d * (self.rate - v) + self.i * self.integral


class InverseDynamics:
    """Inverse dynamics with bodies 10 % too heavy, and low gains."""

    def __init__(self, plant: Plant) -> None:
        w = 1.0 * plant.gains.position
        self.k, self.d = w**2, 1.4 * w
        self.model = plant.robot.pinocchio.copy()
        for i in range(1, self.model.njoints):
            body = self.model.inertias[i]
            self.model.inertias[i] = pin.Inertia(1.1 * plant.bodies * body.mass, body.lever,
                                                 1.1 * plant.bodies * body.inertia)
        self.model.armature = plant.rotor
        self.data = self.model.createData()
        self.rate = np.zeros(plant.model.nv)
        self.bend = np.zeros(plant.model.nv)

    def start(self, q: Array, hold: Array) -> None:
        """Nothing is remembered but the commands' rates."""

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """See ``PPI.torque``."""
        before = self.rate
        self.rate = self.rate + 0.05 * (rd - self.rate)
        self.bend = self.bend + 0.05 * ((self.rate - before) / STEP - self.bend)
        return np.asarray(pin.rnea(self.model, self.data, q, v,
                                   self.bend + self.d * (self.rate - v) + self.k * (r - q)))


class DisturbanceObserver:
    """Stiffness and damping by the joint's inertia, and an observer of all other torques, which are added."""

    def __init__(self, plant: Plant) -> None:
        w = 2.0 * plant.gains.position
        self.inertia, self.k, self.d = plant.inertia, w**2, 1.4 * w
        self.observed = 2.0 * w
        self.given = np.zeros_like(plant.inertia)
        self.filtered = np.zeros_like(plant.inertia)

    def start(self, q: Array, hold: Array) -> None:
        """Holds the arm at rest."""
        self.given, self.filtered = hold.copy(), hold.copy()

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """See ``PPI.torque``; torques that the last one did not accelerate the joint by are those of others."""
        moving = self.observed * self.inertia * v
        self.filtered = self.filtered + (1.0 - np.exp(-STEP * self.observed)) * (self.given + moving - self.filtered)
        self.given = self.inertia * (self.k * (r - q) - self.d * v) + self.filtered - moving
        return self.given


class ModelFollowing(PPI):
    """A third-order model of the wanted motion; a cascade follows it, its velocity and acceleration fed forward."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.inertia, self.w = plant.inertia, 1.5 * plant.gains.position

    def start(self, q: Array, hold: Array) -> None:
        """See ``PPI.start``; the model rests, too."""
        super().start(q, hold)
        self.p, self.pd, self.pdd = q.copy(), np.zeros_like(q), np.zeros_like(q)

    def torque(self, r: Array, rd: Array, q: Array, v: Array) -> Array:
        """See ``PPI.torque``."""
        w = self.w
        self.pdd = self.pdd + STEP * (w**3 * (r - self.p) - 3.0 * w**2 * self.pd - 3.0 * w * self.pdd)
        self.pd = self.pd + STEP * self.pdd
        self.p = self.p + STEP * self.pd
        u = self.k_v * (self.p - q) + self.pd - v
        self.integral = self.integral + STEP * u
        return self.k_p * u + self.k_i * self.integral + self.inertia * self.pdd


KINDS: dict[str, Callable[[Plant], PPI | Impedance | PID | InverseDynamics | DisturbanceObserver]] = {
    "cascade": PPI, "fed_forward": FedForward, "impedance": Impedance, "pid": PID,
    "inverse_dynamics": InverseDynamics, "moving_average": PPI, "lag": PPI, "smoothed": PPI, "posture": ByPosture,
    "disturbance_observer": DisturbanceObserver, "model_following": ModelFollowing}
USUAL = {"cascade": Gains(), "fed_forward": Gains(share=0.9), "impedance": Gains(), "pid": Gains(),
         "inverse_dynamics": Gains(), "moving_average": Gains(filter=0.048), "lag": Gains(filter=0.09),
         "smoothed": Gains(position=60.0, velocity=200.0, filter=0.04), "posture": Gains(share=0.35),
         "disturbance_observer": Gains(), "model_following": Gains()}
UNLISTED = ("disturbance_observer", "model_following")
"""Kinds that the command's law was not developed with."""


def drawn(kind: str, rng: np.random.Generator) -> Gains:
    """Gains of a kind about ``USUAL``, each drawn within a factor of 1.5; late by none to 12 ms."""
    usual = USUAL[kind]
    position, velocity, reset, smoothing = np.exp(rng.uniform(-1.0, 1.0, 4) * np.log(1.5))
    return Gains(usual.position * position, usual.velocity * max(velocity, position), usual.reset * reset,
                 STEP * rng.integers(0, 13), usual.filter * smoothing, usual.share * rng.uniform(0.7, 1.0))


def motion(robot: Robot, rng: np.random.Generator, duration: float, t_cycle: float, *, quick: float = 1.0) -> Array:
    """A motion ``(N, n)`` [rad] from rest to rest about the home posture: sinusoids of each joint's own."""
    t = t_cycle * np.arange(round(duration / t_cycle))
    swell = np.clip(np.minimum(t, duration - t - 0.5) / 1.5, 0.0, 1.0)
    swell = (swell**3 * (10 - 15 * swell + 6 * swell**2))[:, None]
    path = np.zeros((len(t), robot.n))
    for _ in range(3):
        f = quick * rng.uniform(0.1, 0.55, robot.n)
        path += rng.uniform(0.1, 0.3, robot.n) / quick * np.sin(2 * np.pi * f * t[:, None]
                                                              + rng.uniform(0, 2 * np.pi, robot.n))
    return np.asarray(robot.home + swell * path)
