"""Rigid arms behind joint controllers of many kinds, integrated plainly: what a command law is developed and judged on.

Nothing here is shared with the model side or with the simulated world: forward dynamics are Pinocchio's, friction is a
smooth Coulomb law with viscous friction, and each controller is written as its maker would.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter

from ideal_robot.arrays import Array
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
    """

    robot: Robot
    kind: str
    gains: Gains = field(default_factory=Gains)
    friction: float = 0.1
    bodies: float = 1.08
    encoder: float = 1e-5
    torque_noise: float = 0.01

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
        self.nominal = self.robot.pinocchio.copy()
        self.nominal.armature = self.rotor
        self.nominal_data = self.nominal.createData()

    def _postures(self) -> Array:
        rng = np.random.default_rng(0)
        return self.robot.home + rng.uniform(-0.7, 0.7, (24, self.model.nv))

    def run(self, q_c: Array, t_cycle: float, t_log: float, rng: np.random.Generator) -> Recording:
        """The recording of commands ``(N, n)`` handed over every ``t_cycle`` [s], logged every ``t_log`` [s]."""
        n, dt = self.model.nv, STEP
        every, log = round(t_cycle / dt), round(t_log / dt)
        fine = self._command(q_c, every)
        law = KINDS[self.kind](self)
        q, v = np.array(q_c[0]), np.zeros(n)
        tau_hold = pin.computeGeneralizedGravity(self.model, self.data, q)
        law.start(q, tau_hold)
        rows = len(fine) // log
        out_q, out_tau = np.empty((rows, n)), np.empty((rows, n))
        before = fine[0]
        for k in range(len(fine)):
            tau = law.torque(fine[k], (fine[k] - before) / dt, q, v)
            before = fine[k]
            if k % log == 0 and k // log < rows:
                out_q[k // log], out_tau[k // log] = q, tau
            M = pin.crba(self.model, self.data, q)
            M = np.triu(M) + np.triu(M, 1).T
            bias = pin.nonLinearEffects(self.model, self.data, q, v)
            # Friction implicitly in the velocity: it stops the joint and does not drive it back.
            slope = self.dry / 0.01 / (1.0 + np.abs(v) / 0.01) + self.viscous
            A = M + dt * np.diag(slope)
            v = np.linalg.solve(A, M @ v + dt * (tau - bias))
            q = q + dt * v
        q_log = self.encoder * np.round(out_q / self.encoder)
        tau_log = out_tau + self.torque_noise * self.scale * rng.standard_normal(out_tau.shape)
        held = np.repeat(q_c, every, axis=0)[::log][:rows]
        return Recording.from_arrays(t_log * np.arange(float(rows)), q_c=held, q=q_log, tau=tau_log,
                                     meta={"cycle_time": t_cycle})

    def _command(self, q_c: Array, every: int) -> Array:
        """What the inner loops see ``(M, n)``: lines from command to command, reached a cycle later."""
        g, dt = self.gains, STEP
        nodes = np.concatenate([q_c[:1], q_c])
        share = (np.arange(every) + 1.0)[:, None] / every
        fine = (nodes[:-1, None] + share * np.diff(nodes, axis=0)[:, None]).reshape(-1, q_c.shape[1])
        late = round(g.late / dt)
        fine = np.concatenate([np.repeat(fine[:1], late, axis=0), fine])[: len(fine)] if late else fine
        zero = fine[0]
        if self.kind == "moving_average":
            w = max(1, round(g.filter / dt))
            return zero + lfilter(np.ones(w) / w, [1.0], fine - zero, axis=0)
        if self.kind in ("lag", "smoothed"):
            a = np.exp(-dt / g.filter)
            for _ in range(2 if self.kind == "smoothed" else 1):
                fine = zero + lfilter([1 - a], [1, -a], fine - zero, axis=0)
        return fine


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


KINDS: dict[str, Callable[[Plant], PPI | Impedance | PID | InverseDynamics]] = {
    "cascade": PPI, "fed_forward": FedForward, "impedance": Impedance, "pid": PID,
    "inverse_dynamics": InverseDynamics, "moving_average": PPI, "lag": PPI, "smoothed": PPI, "posture": ByPosture}
USUAL = {"cascade": Gains(), "fed_forward": Gains(share=0.9), "impedance": Gains(), "pid": Gains(),
         "inverse_dynamics": Gains(), "moving_average": Gains(filter=0.048), "lag": Gains(filter=0.09),
         "smoothed": Gains(position=60.0, velocity=200.0, filter=0.04), "posture": Gains(share=0.35)}


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
    return np.asarray(robot.home + swell * (path - 0.0))
