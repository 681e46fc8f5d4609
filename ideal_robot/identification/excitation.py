"""Fourier-series motions that excite all base parameters within the limits of the arm (Swevers et al. 1997).

The condition number of the scaled observation matrix is made small by random search over the coefficients, followed by
changes of single coefficients that are kept where they help. Every candidate is first scaled into the limits, so that
the result can be executed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.dynamics import base_parameters, full_regressor, torques
from ideal_robot.dynamics.newton_euler import chain_of, joint_places
from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot, spread_postures


@dataclass(frozen=True)
class Workspace:
    """Permitted space of the tool and the links, in the base frame.

    Attributes:
        z_min: lowest height of the tool and of every joint above the first two [m].
        r_min: smallest distance of the tool from the base axis while it is lower than ``z_free`` [m].
        z_free: height above which the base column is no obstacle [m].
        beyond: extra length beyond the tool frame that must also keep clear [m].
        cell: the arm's shapes and their obstacles; the arm itself and its base plane if None.
    """

    z_min: float = 0.15
    r_min: float = 0.35
    z_free: float = 1.2
    beyond: float = 0.0
    cell: Shapes | None = None

    @classmethod
    def of(cls, robot: Robot) -> Workspace:
        """The default workspace of an arm; in proportion to its reach where that is less than a metre.

        The floor is low enough for the tool and every joint to rise above it by half of their height or stroke, as the
        tools of turntables and SCARA arms reach down to their base.
        """
        span, heights = _points(robot, spread_postures(robot.q_min, robot.q_max), 0.0)
        small = min(1.0, float(span.max()))
        lowest_point = int(np.argmin(heights.max(axis=0)))
        highest, lowest = float(heights[:, lowest_point].max()), float(heights[:, lowest_point].min())
        # A first prismatic axis has no base column that the tool could hit.
        column = 0.0 if robot.prismatic[0] else small * cls.r_min
        rises = max(abs(highest), highest - lowest)
        return cls(min(small * cls.z_min, highest - 0.5 * rises), column, small * cls.z_free)

    def on_the_way(self, robot: Robot) -> Workspace:
        """The workspace for a motion from home: widened where home lies outside, with the shapes in ``cell``.

        An arm that stands upright at home moves down beside its own column, so its shapes are checked. They are not
        checked where home itself collides and no cell was given, as with a hanging arm. Raises InputError where home
        collides with the given cell.
        """
        shapes = self.cell or Shapes(robot)
        touch = shapes.first_touch(robot.home[None])
        if touch is not None and self.cell is not None:
            raise InputError(f"the motion begins at the home posture, and there {touch}; give another [joints] home",
                             field="home", value=[round(float(angle), 3) for angle in robot.home])
        wider = self.widened(robot, robot.home[None])
        if touch is not None:
            return replace(wider, cell=None)
        beside = float(_points(robot, robot.home[None], self.beyond)[0][0])
        return replace(wider, r_min=min(wider.r_min, beside), cell=shapes)

    def widened(self, robot: Robot, q: Array) -> Workspace:
        """The workspace widened by recorded positions ``(N, n)`` [rad], at which the arm did not collide."""
        span, heights = _points(robot, q[:: max(1, len(q) // 400)], self.beyond)
        beside = span[heights[:, 0] < self.z_free]
        return replace(self, z_min=float(heights.min(initial=self.z_min)), r_min=float(beside.min(initial=self.r_min)))


def clear_of_obstacles(robot: Robot, q: Array, workspace: Workspace) -> NDArray[np.bool_]:
    """Whether the arm keeps off floor and base column in postures ``(N, n)``: ``(N,)``.

    Args:
        robot, q: the arm, and postures ``(N, n)`` [rad].
        workspace: floor and base column.
    """
    low, near = _met(robot, q, workspace)
    return ~(low | near)


def obstacle(robot: Robot, q: Array, workspace: Workspace) -> str | None:
    """Name of the first obstacle, with the option that moves it; None for none. See ``clear_of_obstacles``."""
    low, near = _met(robot, q, workspace)
    met = low | near
    if not met.any():
        return None
    if low[np.argmax(met)]:
        return f"the tool or a joint would be lower than z_min = {workspace.z_min:.3g} m (--z-min)"
    return f"the tool would be nearer to the base than r_min = {workspace.r_min:.3g} m (--r-min)"


def _met(robot: Robot, q: Array, workspace: Workspace) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether in postures ``(N, n)`` the arm is too low, and the tool too near to the base, ``(N,)`` each."""
    span, heights = _points(robot, q, workspace.beyond)
    return heights.min(axis=1) < workspace.z_min, (heights[:, 0] < workspace.z_free) & (span < workspace.r_min)


def _points(robot: Robot, q: Array, beyond: float) -> tuple[Array, Array]:
    """How far from the base axis the tool is ``(N,)``; how high it and the joints above the second are ``(N, n - 1)``.

    The tool counts at ``beyond`` [m] its frame, along its z axis.
    """
    frame = robot.pinocchio.frames[robot.tool_id]
    point = frame.placement.act(np.array([0.0, 0.0, beyond]))
    rows = np.array(q, dtype=float, order="C")
    places = joint_places(chain_of(robot.pinocchio), rows, int(frame.parentJoint), point)
    tip = places[:, -1]
    return np.hypot(tip[:, 0], tip[:, 1]), np.column_stack([tip[:, 2], places[:, 2:-1, 2]])


LIMIT_SHARES = (0.75, 0.6, 0.8)
"""Of the limits of velocity, acceleration and position that a motion may use."""
LONGEST_PERIOD = 3600.0
"""Longest period of a motion [s]."""
LONGEST_APPROACH = 600.0
"""Longest way from rest to where a motion begins [s]."""
_WIDE = (1.0, 0.8, 0.6, 0.45)
"""Shares of the joints' travel that are tried …"""
_NARROW = (0.45, 0.3, 0.2, 0.12)
"""… and where all of them hit something."""
_LEAST_TRAVEL = 1e-3
"""A joint with less between its limits does not move [rad or m]: limits that nobody filled in are both 0."""
_AWAY = 50.0
"""How far from home a motion is looked for [rad or m]: a limit beyond stands for none."""


@dataclass(frozen=True)
class FourierMotion:
    """``q(t) = centre + Σ_k a_k sin(kωt)/(kω) - b_k cos(kωt)/(kω)``; at rest at ``t = 0`` and after each period.

    Attributes:
        centre: ``(n,)`` [rad].
        a, b: ``(K, n)`` [rad/s].
        period: [s].
        condition_number: of the scaled observation matrix over one period, viscous and dry friction included.
    """

    centre: Array
    a: Array
    b: Array
    period: float
    condition_number: float

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations ``(N, n)`` each at times ``(N,)``."""
        w = 2.0 * np.pi / self.period * np.arange(1, len(self.a) + 1)
        s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        q = self.centre + s @ (self.a / w[:, None]) - c @ (self.b / w[:, None])
        return q, c @ self.a + s @ self.b, (c * w) @ self.b - (s * w) @ self.a


def design_excitation(robot: Robot, rng: np.random.Generator, *, period: float = 20.0, harmonics: int = 5,
                      workspace: Workspace | None = None, trials: int = 150, refinements: int = 250) -> FourierMotion:
    """Designs a motion with a small condition number within position, velocity, acceleration and workspace limits.

    Args:
        robot: limits and kinematics; nominal inertias only weigh torque against its limit.
        rng: source of the random search.
        period: of the motion [s].
        harmonics: number of sines and cosines per joint, at least 3.
        workspace: keeps the arm off floor, column and cell; one in proportion to its reach if None.
        trials: random motions that the search begins with.
        refinements: changes that are tried of the best one.

    Raises:
        InputError: too few harmonics, a period that is not positive, a joint that moves nothing, or no motion within
            the limits was found.
    """
    _check_sums(harmonics, period)
    search = MotionSpace(robot, period, harmonics, workspace or Workspace.of(robot), *LIMIT_SHARES)
    independent = list(base_parameters(robot.pinocchio).independent)

    def better(best: FourierMotion | None, coefficients: Array, centre: Array | None) -> FourierMotion | None:
        motion = search.scaled(coefficients, rng, centre)
        if motion is None:
            return best
        motion = replace(motion, condition_number=_condition(robot, independent, *motion.at(search.t)))
        less = best is None or motion.condition_number < best.condition_number
        return motion if less and search.free(motion) else best

    best: FourierMotion | None = None
    for centre in (None, None, robot.home):
        for _ in range(trials):
            best = better(best, rng.uniform(-1, 1, (2, harmonics, robot.n)), centre)
        if best is not None:
            break
        # Large motions take the arm below the floor: smaller ones are searched, finally around its posture.
        search.narrow(widened=workspace is None)
    if best is None:
        raise InputError(f"no motion within the limits was found: {search.in_the_way()}", field="workspace")
    for _ in range(refinements):
        best = better(best, _changed(best, rng), best.centre) or best
    return best


def _check_sums(harmonics: int, period: float) -> None:
    if harmonics < 3:
        raise InputError("at least 3 harmonics are needed, two conditions make the motion start at rest",
                         field="harmonics", value=harmonics)
    if not 0.0 < period <= LONGEST_PERIOD:
        raise InputError(f"expected a period of more than 0 and at most {LONGEST_PERIOD:g} s", field="period",
                         value=period)


def _changed(motion: FourierMotion, rng: np.random.Generator) -> Array:
    """The coefficients ``(2, harmonics, n)`` of a motion, a single one changed at random."""
    coefficients = np.stack([motion.a, motion.b])
    step = np.zeros(coefficients.shape)
    step[tuple(rng.integers(size) for size in coefficients.shape)] = rng.normal(scale=0.5)
    return np.asarray(coefficients + step * np.abs(coefficients).max(axis=(0, 1)))


class MotionSpace:
    """Fourier motions of one period within the limits of an arm.

    Args:
        robot: limits and kinematics; nominal inertias only weigh torque against its limit.
        period: of the motions [s].
        harmonics: number of sines and cosines per joint.
        workspace: region in which tool and links may move.
        speed, acceleration, travel: shares of the limits that may be used.

    Raises:
        InputError: a joint whose limits leave it nothing to move.
    """

    def __init__(self, robot: Robot, period: float, harmonics: int, workspace: Workspace, speed: float,
                 acceleration: float, travel: float) -> None:
        self.robot, self.period, self.workspace = robot, period, workspace
        q_min, q_max = np.maximum(robot.q_min, robot.home - _AWAY), np.minimum(robot.q_max, robot.home + _AWAY)
        if np.any(q_max - q_min < _LEAST_TRAVEL):
            j = int(np.argmin(q_max - q_min))
            raise InputError(f"the limits of joint {j + 1} leave it nothing to move; give its true ones in the URDF",
                             field="limit", value=[float(robot.q_min[j]), float(robot.q_max[j])])
        half = 0.5 * travel * (q_max - q_min)
        # Several turns of a wrist joint add no excitation to one turn.
        self.half = np.minimum(half, np.pi)
        self.reach_low = np.maximum(q_min + 0.5 * (1 - travel) * (q_max - q_min), -1.2 * np.pi)
        self.reach_high = np.minimum(q_max - 0.5 * (1 - travel) * (q_max - q_min), 1.2 * np.pi)
        self.v_max = speed * np.where(np.isfinite(robot.v_max), robot.v_max, 2.0)
        self.a_max = acceleration * np.where(np.isfinite(robot.a_max), robot.a_max, 10.0)
        self._shrinks, self._shapes, self._refused = _WIDE, workspace.cell or Shapes(robot), Counter[str]()
        self.t = np.linspace(0.0, period, 120, endpoint=False)
        self.t_fine = np.linspace(0.0, period, 40 * harmonics, endpoint=False)

    def scaled(self, coefficients: Array, rng: np.random.Generator,
               centre: Array | None = None) -> FourierMotion | None:
        """The motion with these coefficients, made to start at rest and scaled into the limits; None if impossible.

        Args:
            coefficients: of sines and cosines ``(2, harmonics, n)``; their size does not matter.
            rng, centre: the posture about which it goes ``(n,)`` [rad], moved into the limits; drawn where it is None.
        """
        a, b = coefficients[0].copy(), coefficients[1].copy()
        k = np.arange(1, len(a) + 1)[:, None]
        a -= a.mean(axis=0)
        b -= k * np.sum(k * b, axis=0) / np.sum(k**2)
        motion = FourierMotion(np.zeros(self.robot.n), a, b, self.period, np.inf)
        q, qd, qdd = motion.at(self.t_fine)
        middle = 0.5 * (q.max(axis=0) + q.min(axis=0))
        extent = np.maximum(0.5 * np.ptp(q, axis=0), 1e-9)
        ratio = np.min([self.half / extent, self.v_max / np.abs(qd).max(axis=0), self.a_max / np.abs(qdd).max(axis=0)],
                       axis=0)
        for shrink in self._shrinks:
            gain = ratio * shrink
            room_low = self.reach_low + gain * extent
            room_high = np.maximum(self.reach_high - gain * extent, room_low)
            place = (rng.uniform(room_low, room_high) if centre is None
                     else np.clip(centre + gain * middle, room_low, room_high))
            # ``centre`` is the mean of the cosines and sines; the extremes are not symmetric about it.
            candidate = FourierMotion(place - gain * middle, a * gain, b * gain, self.period, np.inf)
            q, qd, qdd = candidate.at(self.t)
            reason = obstacle(self.robot, q, self.workspace) or self._too_weak(q, qd, qdd)
            if reason is None:
                return candidate
            self._refused[reason] += 1
        return None

    def narrow(self, widened: bool) -> None:
        """Searches smaller motions from now on, and extends a default workspace to the arm's posture."""
        self._shrinks = _NARROW
        if widened:
            self.workspace = self.workspace.widened(self.robot, self.robot.home[None])

    def free(self, motion: FourierMotion) -> bool:
        """Whether the arm collides neither with itself, its base plane, nor obstacles of the cell along a motion."""
        touch = self._shapes.first_touch(motion.at(self.t)[0])
        if touch is not None:
            self._refused[f"{touch} (the arm's shapes in the URDF)"] += 1
        return touch is None

    def in_the_way(self) -> str:
        """The reason why most motions were rejected, and the option that helps."""
        return self._refused.most_common(1)[0][0] if self._refused else "the joints have nothing to move"

    def _too_weak(self, q: Array, qd: Array, qdd: Array) -> str | None:
        """Which joint the nominal arm could not do it with, by three quarters of its torque; None if with all."""
        load = torques(self.robot.pinocchio, q[::3], qd[::3], qdd[::3]) + self.robot.rotor_inertia * qdd[::3]
        share = np.abs(load) / (0.75 * self.robot.tau_max)
        over = np.any(share > 1.0, axis=1)
        if not over.any():
            return None
        joint = int(np.argmax(share[np.argmax(over)])) + 1
        return f"joint {joint} would need more torque than its effort in the URDF allows"


def _condition(robot: Robot, independent: list[int], q: Array, qd: Array, qdd: Array) -> float:
    """Condition number of the scaled observation matrix of a motion, viscous and dry friction included."""
    n = robot.n
    W = full_regressor(robot.pinocchio, q, qd, qdd, independent)
    friction = np.zeros((len(q), n, 2 * n))
    joints = np.arange(n)
    friction[:, joints, joints] = qd
    friction[:, joints, n + joints] = np.sign(qd)
    W = np.concatenate([W, friction], axis=2)
    # Torques are weighted relative to the joint's limit.
    limited = np.isfinite(robot.tau_max)
    weight = robot.tau_max if limited.all() else np.where(limited, robot.tau_max, np.std(W, axis=(0, 2)) + 1e-9)
    flat = (W / weight[:, None]).reshape(len(q) * n, -1)
    flat /= np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
    # The normal matrix has the squared singular values, accurate up to condition numbers of a million.
    squares = np.linalg.eigvalsh(flat.T @ flat)
    return float(np.sqrt(squares[-1] / max(squares[0], 1e-24)))


def approach(start: Array, goal: Array, t_ipo: float, v_max: Array, a_max: Array) -> Array:
    """Commands ``(N, n)`` from rest to rest, all joints by one quintic, the start left out.

    Raises InputError where it would take longer than ``LONGEST_APPROACH``.

    Args:
        start, goal: ``(n,)`` [rad].
        t_ipo: interpolation cycle [s].
        v_max, a_max: limits ``(n,)`` [rad/s, rad/s²].
    """
    distance = np.abs(goal - start)
    # Largest velocity and acceleration of 10 s³ - 15 s⁴ + 6 s⁵ are 1.875 and 5.77.
    duration = max(np.max(1.875 * distance / (0.5 * v_max)), np.max(np.sqrt(5.78 * distance / (0.5 * a_max))), t_ipo)
    if not duration <= LONGEST_APPROACH:
        raise InputError(f"the way to where the motion begins would take {duration:.3g} s by the limits of velocity "
                         "and acceleration; check them", field="limits")
    count = int(np.ceil(duration / t_ipo))
    s = np.arange(1, count + 1)[:, None] / count
    return np.asarray(start + (10 * s**3 - 15 * s**4 + 6 * s**5) * (goal - start))
