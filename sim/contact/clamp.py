"""Elastic equilibrium of an arm whose flange is clamped to the environment, and its recordings.

Quasi-static ([J] 2.1): the controller keeps the motors in place; gears, links and environment deflect until

    k (q_m − q) = G(q) + J(q)ᵀ F_e                                   [J] (1)
    F_e = (C_environment + C_links)⁻¹ · displacement of the flange

The environment is stiff, not rigid; links bend; motors have dry friction with presliding; the drive gain of the data
sheet is wrong by a few per cent; the wrench sensor has its own clock. None of that is known to the model side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, G, interpolated
from ideal_robot.jit import jit
from ideal_robot.robots.joints import own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim import SimError
from sim.arm.history import POSE
from sim.contact.clamp_world import ClampWorld

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")

@dataclass(frozen=True)
class Push:
    """One load case: the controller shifts all motors along ``motion (n,)`` [rad per unit of level].

    It keeps each of the levels ``(m,)`` for a while, one after the other.
    """

    motion: Array
    levels: Array


@dataclass(frozen=True)
class ClampTruth:
    """True values that are not recorded: gear stiffness, and drive gain over that of the data sheet."""

    stiffness: Array
    gain_factor: Array


class ClampedArm:
    """Elastic equilibrium of an arm whose flange is clamped in all six degrees of freedom.

    Args:
        robot, world: kinematics and masses, and the truth.
        q0: joint angles at which the clamp was closed without force ``(n,)`` [rad].
    """

    def __init__(self, robot: Robot, world: ClampWorld, q0: Array) -> None:
        self.robot, self.world, self.q0 = robot, world, np.array(q0, dtype=float)
        self._data = robot.pinocchio.createData()
        self._anchor = self._pose(self.q0)
        # A tiny compliance keeps the rigid clamp of an ideal world solvable.
        self._clamp = np.linalg.inv(self._compliance() + 1e-12 * np.eye(6))
        self.qm0 = self.q0 + self._gravity(self.q0) / world.stiffness

    def _pose(self, q: Array) -> pin.SE3:
        pin.framesForwardKinematics(self.robot.pinocchio, self._data, q)
        return self._data.oMf[self.robot.tool_id].copy()

    def _jacobian(self, q: Array) -> Array:
        return np.array(pin.computeFrameJacobian(self.robot.pinocchio, self._data, q, self.robot.tool_id, pin.LOCAL))

    def _gravity(self, q: Array) -> Array:
        return np.array(pin.computeGeneralizedGravity(self.robot.pinocchio, self._data, q))

    def _compliance(self) -> Array:
        """C_environment + Σ_j J_vj J_vjᵀ / k_link,j in the tool frame; J_vj: rotations of link j across its axis."""
        total = np.diag([1 / self.world.environment[0]] * 3 + [1 / self.world.environment[1]] * 3)
        for stiffness, joint in zip(self.world.link_stiffness, own_joints(self.robot.pinocchio), strict=True):
            bending = (self._anchor.inverse() * self._data.oMi[joint]).action[:, 3:5]
            total = total + bending @ bending.T / stiffness
        return total

    def wrench(self, q: Array) -> Array:
        """F_e of the arm on the environment in the tool frame ``(6,)`` at arm angles ``q``."""
        return self._clamp @ np.array(pin.log6(self._anchor.inverse() * self._pose(q)).vector)

    def equilibrium(self, q_m: Array, start: Array) -> Array:
        """Arm angles at motor angles ``q_m (n,)``: Newton on [J] (1) from ``start``; ``SimError`` if it fails."""
        q = start.copy()
        k = self.world.stiffness
        for _ in range(40):
            wrench = self.wrench(q)
            jacobian = self._jacobian(q)
            residual = k * (q_m - q) - self._gravity(q) - jacobian.T @ wrench
            if np.all(np.abs(residual) < 1e-6 * (1 + np.abs(k * (q_m - q)))):
                return q
            step = np.linalg.solve(np.diag(k) + jacobian.T @ self._clamp @ jacobian, residual)
            q = q + step
            if np.max(np.abs(step)) < 1e-13:
                return q
        raise SimError("no elastic equilibrium found; the shift is too large for this clamp")

    def curve(self, motion: Array, low: float, high: float, *, points: int = 25) -> tuple[Array, Array, Array]:
        """Equilibria along a motor motion: shifts ``(m,)``, arm angles ``(m, n)`` and wrenches ``(m, 6)``.

        Args:
            motion: direction of the motors' shift ``(n,)``.
            low: smallest multiple of ``motion``, ≤ 0.
            high: largest multiple, ≥ 0.
            points: number of equilibria ``m``.
        """
        shifts = np.linspace(low, high, points)
        middle = int(np.argmin(np.abs(shifts)))
        angles, wrenches = np.empty((points, self.robot.n)), np.empty((points, 6))
        for part in (range(middle, points), range(middle, -1, -1)):
            q = self.q0
            for i in part:
                q = self.equilibrium(self.qm0 + motion * shifts[i], q)
                angles[i], wrenches[i] = q, self.wrench(q)
        return shifts, angles, wrenches

    def press(self, forces: Array, rng: np.random.Generator) -> Push:
        """The push of [J] 4.3 whose levels are contact forces along −z of the tool ``(m,)`` [N].

        Force control shifts the motors until the flange pushes along z alone; ``world.force_control`` is its accuracy.
        """
        down = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
        soft = np.linalg.inv(self._clamp)
        jacobian = self._jacobian(self.q0)
        motion = jacobian.T @ down / self.world.stiffness + np.linalg.solve(jacobian, soft @ down)
        motion *= 1 + self.world.force_control * rng.standard_normal(self.robot.n)
        shifts, _, wrenches = self.curve(motion, 0.0, 1.2 * float(np.max(forces)))
        return Push(motion, np.interp(forces, -wrenches[:, 2], shifts))

    def guarded(self, motion: Array, shares: Array, *, torque: Array, force: float, moment: float) -> Push:
        """The push along ``motion`` that stops at shares of the limits of motor torques, force and moment.

        Args:
            motion: direction of the motors' shift ``(n,)``.
            shares: levels as shares of the largest allowed shift, −1 … 1.
            torque: allowed change of motor torque ``(n,)`` [N m].
            force: allowed norm at the flange [N].
            moment: allowed norm at the flange [N m].
        """
        probe = 1e-4
        _, angles, wrenches = self.curve(motion, 0.0, probe, points=2)
        loads = [np.abs(self.world.stiffness * (motion * probe - (angles[1] - angles[0]))) / torque,
                 [np.linalg.norm(wrenches[1, :3]) / force, np.linalg.norm(wrenches[1, 3:]) / moment]]
        return Push(motion, shares * probe / float(np.max(np.concatenate(loads))))

    def play(self, pushes: list[Push], rng: np.random.Generator, *,
             gain_rng: np.random.Generator | None = None, components: tuple[str, ...] = WRENCH, hold: float = 2.0,
             ramp: float = 0.7, approach: float = 0.0) -> tuple[Recording, ClampTruth]:
        """Applies all levels of all pushes one after the other and records them, as a controller and a sensor do.

        The recording has ``t``, ``q_i``, ``current_i`` on the controller's clock, ``t_wrench`` and the wrench
        ``components`` on the sensor's clock, padded with NaN; the true values are returned separately.

        Args:
            pushes: load cases.
            rng: for everything that scatters.
            gain_rng: for the drive gains, which are the same in all recordings of one arm; None: ``rng``.
            components: wrench components that are recorded.
            hold: time at a level [s].
            ramp: time between levels [s].
            approach: distance from which the flange first approaches along −z under position control [m].
        """
        world, robot = self.world, self.robot
        q_m, q, wrench = self._motion(pushes, hold, ramp, approach)
        t = np.arange(len(q_m)) / world.rate_motor
        gain_factor = 1 + world.drive_gain_std * (gain_rng or rng).standard_normal(robot.n)
        torque = world.stiffness * (q_m - q) + _dry_friction(q_m, world.friction * robot.tau_max, world.presliding)
        torque += world.current_noise * robot.tau_max * rng.standard_normal(torque.shape)
        encoder = np.round(q_m / world.encoder) * world.encoder if world.encoder > 0 else q_m
        sensor_clock, sensed = self._sense(t, wrench, rng)
        columns: dict[str, Array] = {"q": encoder, "current": torque / (robot.drive_gain * gain_factor),
                                     "t_wrench": _padded(sensor_clock, len(t))}
        for name in components:
            columns[name] = _padded(sensed[:, WRENCH.index(name)], len(t))
        meta = {"robot": robot.name, "kind": "clamped", "rate_motor": world.rate_motor,
                "rate_wrench": world.rate_wrench, "wrench_frame": robot.tool_frame,
                "wrench_sign": "arm on environment", "source": "simulated"}
        truth = ClampTruth(world.stiffness, gain_factor)
        return Recording.from_arrays(t, meta=meta, source="simulated", **columns), truth

    def _motion(self, pushes: list[Push], hold: float, ramp: float, approach: float) -> tuple[Array, Array, Array]:
        """Motor angles, arm angles and wrenches over time, without what the instruments add."""
        ramp_n, hold_n = round(ramp * self.world.rate_motor), round(hold * self.world.rate_motor)
        blend = (1 - np.cos(np.pi * np.arange(1, ramp_n + 1) / ramp_n)) / 2
        q_m, q, wrench = [], [], []
        if approach > 0:
            back = np.linalg.solve(self._jacobian(self.q0), np.array([0.0, 0.0, approach, 0.0, 0.0, 0.0]))
            away = np.concatenate([np.ones(hold_n), 1 - blend])
            q_m.append(self.qm0 + np.outer(away, back))
            q.append(self.q0 + np.outer(away, back))
            wrench.append(np.zeros((len(away), 6)))
        for push in pushes:
            profile = [np.zeros(hold_n)]
            previous = 0.0
            for level in [*push.levels, 0.0]:
                profile += [previous + (level - previous) * blend, np.full(hold_n, level)]
                previous = level
            shift = np.concatenate(profile)
            low, high = min(0.0, float(np.min(push.levels))), max(0.0, float(np.max(push.levels)))
            nodes, angles, wrenches = self.curve(push.motion, low, high)
            q_m.append(self.qm0 + np.outer(shift, push.motion))
            q.append(CubicSpline(nodes, angles)(shift))
            wrench.append(CubicSpline(nodes, wrenches)(shift))
        return np.concatenate(q_m), np.concatenate(q), np.concatenate(wrench)

    def _sense(self, t: Array, wrench: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        world = self.world
        true_time = np.arange(0.0, t[-1], 1 / world.rate_wrench)
        sensed = interpolated(true_time, t, wrench)
        sensed += np.repeat(world.wrench_bias, 3) * rng.standard_normal(6)
        sensed += np.repeat(world.wrench_noise, 3) * rng.standard_normal(sensed.shape)
        keep = np.ones(len(true_time), dtype=bool)
        if world.gaps:
            period = t[-1] / 6
            keep = (true_time % period) < 0.85 * period
        return (true_time[keep] - world.clock_offset) / (1 + world.clock_drift), sensed[keep]


def _padded(values: Array, length: int) -> Array:
    return np.concatenate([values, np.full(length - len(values), np.nan)])


@jit()
def _dry_friction(q: Array, level: Array, presliding: float) -> Array:
    """Friction torque ``(N, n)`` of motors that move along ``q (N, n)`` [rad], up to ``level (n,)`` [N m].

    By Dahl's law dz = dq − |dq| z / presliding, the way over which friction builds up [rad].
    """
    torque = np.zeros_like(q)
    state = np.zeros(q.shape[1])
    for i in range(1, q.shape[0]):
        for j in range(q.shape[1]):
            move = q[i, j] - q[i - 1, j]
            ratio = np.exp(-abs(move) / presliding)
            state[j] = np.sign(move) * (1 - ratio) + state[j] * ratio
            torque[i, j] = level[j] * state[j]
    return torque


# The alternative to a clamp: known masses hung on the flange; the motors stand and a tracker watches the flange.

_SAMPLES = 50
"""Recorded of each mass."""


def hang_payloads(robot: Robot, world: ClampWorld, postures: Array, masses: Array, lever: Array,
                  rng: np.random.Generator, *, tracker: tuple[float, float] = (2e-5, 3e-5)) -> Recording:
    """Records motor angles and flange pose under known masses: ``t``, ``q_i``, ``payload`` [kg], ``x y z qx qy qz qw``.

    Args:
        robot: kinematics and masses.
        world: truth; gears and links deflect, there is no clamp.
        postures: motor angles of the postures ``(p, n)`` [rad].
        masses: hung one after the other in each posture ``(m,)`` [kg].
        lever: where the masses' centre hangs in the tool frame ``(3,)`` [m].
        rng: for the tracker's noise.
        tracker: standard deviation of the measured position [m] and rotation [rad].
    """
    rows_q, rows_pose, rows_mass = [], [], []
    for q_m in postures:
        for mass in masses:
            pose = _loaded_pose(robot, world, q_m, float(mass), lever)
            for _ in range(_SAMPLES):
                error = pin.exp3(tracker[1] * rng.standard_normal(3))
                tracked = pin.SE3(error @ pose.rotation, pose.translation + tracker[0] * rng.standard_normal(3))
                rows_q.append(q_m)
                rows_pose.append(pin.SE3ToXYZQUAT(tracked))
                rows_mass.append(mass)
    poses = np.array(rows_pose)
    meta = {"robot": robot.name, "kind": "payload", "payload_lever": [float(x) for x in lever], "source": "simulated"}
    return Recording.from_arrays(
        np.arange(float(len(rows_q))) * 0.1, source="simulated", meta=meta, q=np.array(rows_q),
        payload=np.array(rows_mass), **{name: poses[:, i] for i, name in enumerate(POSE)})


def _loaded_pose(robot: Robot, world: ClampWorld, q_m: Array, mass: float, lever: Array) -> pin.SE3:
    """Flange pose at rest with a mass [kg] hung on it: gears by fixed-point iteration, links to first order.

    ``lever (3,)`` [m] is the mass' centre in the flange frame.
    """
    data = robot.pinocchio.createData()
    q = np.array(q_m, dtype=float)
    for _ in range(50):
        pin.framesForwardKinematics(robot.pinocchio, data, q)
        flange = data.oMf[robot.tool_id].copy()
        force = flange.rotation.T @ np.array([0.0, 0.0, -mass * G])
        wrench = np.concatenate([force, np.cross(lever, force)])
        jacobian = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL)
        load = pin.computeGeneralizedGravity(robot.pinocchio, data, q) - jacobian.T @ wrench
        change = q_m - load / world.stiffness - q
        q = q + change
        if np.max(np.abs(change)) < 1e-13:
            break
    bending = np.zeros(6)
    for stiffness, joint in zip(world.link_stiffness, own_joints(robot.pinocchio), strict=True):
        across = (flange.inverse() * data.oMi[joint]).action[:, 3:5]
        bending += across @ (across.T @ wrench) / stiffness
    return flange * pin.exp6(pin.Motion(bending))
