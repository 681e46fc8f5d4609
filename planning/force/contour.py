r"""Following a contour without a reference path ([L] 4.4).

"Such a reference may be degenerated to a single point, a working point or starting point of motion. Contour following
needs no reference trajectory. Instead, the local velocity is computed using only the actual sensor values." Every force
sample says where the contour is, at the instant it was felt: :math:`\hat x_a + \Delta x_a` with [L] (3). The last ones
give a local parabola; the tip moves along its tangent at the wanted speed and keeps the distance that makes the force.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from ideal_robot.arrays import Array, held
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.follower import Phase
from planning.path.desired_path import Smoother, planned_cycles
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory

# The plan of the coming cycles in two directions, which slides along with time.

SPARE = 0.072
"""Planned beyond the horizon [s]."""


class SlidingPlan:
    """Desired positions in two directions with their derivatives, and their joint angles, from the current cycle on.

    Args:
        n_d, t_ipo: desired joint positions of a horizon, and interpolation cycle [s].
        q_start, start: joint angles ``(n,)`` [rad] and position ``(2,)`` [m] at the beginning.
        cutoff: frequency up to which an estimate is followed [Hz].

    Attributes:
        samples: cycles that are planned at a time.
        q: joint angles of the same cycles ``(samples + 2, n)`` [rad].
        cycle: number of the current cycle.
    """

    def __init__(self, n_d: int, t_ipo: float, q_start: Array, start: Array, cutoff: float = 15.0) -> None:
        self.n_d, self.samples, self.cycle = n_d, planned_cycles(n_d, t_ipo, SPARE), 0
        self._smoother = Smoother(self.samples, t_ipo, cutoff)
        # By cycle: position, velocity and acceleration in both directions.
        self._states = np.zeros((self.samples + 2, 3, 2))
        self._states[:, 0] = start
        self.q = np.tile(q_start, (self.samples + 2, 1))

    @property
    def position(self) -> Array:
        """Planned positions in both directions, from the current cycle on ``(samples + 2, 2)`` [m]."""
        return self._states[:, 0]

    def advance(self, cycle: int) -> None:
        """Advances the plan to a cycle; beyond the end of the plan the last position is kept."""
        passed = cycle - self.cycle
        if passed <= 0:
            return
        first = min(passed, len(self.q) - 1)
        self._states = held(self._states[first:], after=first)
        self._states[-passed:, 1:] = 0.0
        self.q = held(self.q[first:], after=first)
        self.cycle = cycle

    def follow(self, estimate: Array, keep: int) -> None:
        """Plans anew towards ``estimate (samples, 2)`` [m]; the next ``keep`` cycles of the old plan are kept.

        The directions are planned separately, so that a large correction of one does not slow the other.
        """
        for direction in (0, 1):
            column = slice(direction, direction + 1)
            planned = self._smoother.plan(self._states[keep, :, column], estimate[:, column])
            self._states[keep + 1 : keep + 1 + self.samples, :, column] = planned.transpose(1, 0, 2)

    def solve(self, keep: int, joint_angles: Callable[[slice, Array], Array]) -> Array:
        """Computes the joint angles of the horizon ``(n_d, n)`` [rad]; those of the next ``keep`` cycles are kept.

        ``joint_angles`` solves the inverse kinematics of a slice of cycles, starting from their last solution ``(m,
        n)`` [rad].
        """
        rows = slice(keep + 1, self.n_d)
        if rows.start < rows.stop:
            self.q[rows] = joint_angles(rows, self.q[rows])
        return self.q[: self.n_d].copy()


LATELY = 0.08
"""Time over which the contour that was felt is forecast, to see whether what is felt fits it [s]."""


@dataclass(frozen=True)
class ContourSettings:
    """Desired motion along a contour, and the curvature that the contour is assumed to have.

    Attributes:
        force: F_r [N].
        elasticity: E that is assumed [N/m].
        speed, acceleration: along the contour [m/s], and up to that and down again [m/s²].
        length: way after which the motion ends [m].
        approach: speed towards the contour [m/s].
        reach: distance the approach may take before there has to be contact [m].
        touch: force from which there is contact [N].
        settle: time of contact before the motion along the contour begins [s].
        window: length of contour that the parabola is fitted to [m].
        ahead: of the newest point over which the parabola is continued, then straight [m].
        friction: coefficient that is assumed while the arm has not moved far enough to see the tangent.
    """

    force: float = 20.0
    elasticity: float = 4000.0
    speed: float = 0.1
    acceleration: float = 0.3
    length: float = 0.5
    approach: float = 0.03
    reach: float = 0.05
    touch: float = 3.0
    settle: float = 0.25
    window: float = 0.03
    ahead: float = 0.03
    friction: float = 0.15

    def __post_init__(self) -> None:
        for key in ("force", "elasticity", "speed", "acceleration", "length", "approach", "window", "ahead"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))


class ContourFollower:
    """Desired joint positions along a contour that only the force sensor shows.

    Args:
        robot: the arm.
        start: pose at which the arm rests, near the contour; the tool keeps its orientation and its height.
        axes: of the plane in which the contour lies ``(2, 3)``: towards the contour, and of the first motion along it.
        q_start: joint angles at the start ``(n,)`` [rad].
        n_d: desired positions a call of ``horizon`` gives.
        settings: settings of the run.
    """

    def __init__(self, robot: Robot, start: pin.SE3, axes: Array, q_start: Array, n_d: int,
                 settings: ContourSettings) -> None:
        self.robot, self.settings, self.n_d, self.q_start = robot, settings, n_d, q_start
        self.history = PoseHistory(robot)
        self._start, self._axes = start, axes
        self._T = robot.t_ipo
        self._kinematics = InverseKinematics(robot)
        self._plan = SlidingPlan(n_d, self._T, q_start, np.zeros(2))
        self._points: deque[tuple[float, Array]] = deque()
        self._contact_since: float | None = None
        self.force = 0.0
        self.travelled = 0.0
        """Way along the contour [m]."""
        self.last_touch = -np.inf
        self._normal = np.array([-1.0, 0.0])
        self.sideways = 0.0
        """Force along the contour of the last samples [N]."""
        self.recedes = 0.0
        """By how much the contour lies deeper than it was forecast a while ago, as a force on the tip [N]."""
        self._moving_from: float | None = None

    @property
    def phase(self) -> Phase:
        """The present phase of the motion; at the end of a contour the tip is not lifted."""
        if not self.in_contact:
            return Phase.APPROACH
        if self._moving_from is None:
            return Phase.SETTLE
        return Phase.TRAVEL if self.moving else Phase.DONE

    @property
    def descended(self) -> float:
        """Distance that the approach has descended [m]."""
        return float(self._plan.position[0, 0])

    def s_at(self, t: float) -> float:
        """Distance along the contour at ``t`` [m]."""
        return float(self._way(t))

    def speed_at(self, t: float) -> float:
        """Speed along the contour at ``t`` [m/s]."""
        return float(self._way(t + 1e-3) - self._way(t - 1e-3)) / 2e-3

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one; see ``planning.follower.Follower``."""
        return self.phase is Phase.DONE

    def desired_deviation(self, t: float) -> Array:
        """Desired position in the plane at the current cycle ``(2,)`` [m]."""
        return self._plan.position[0].copy()

    @property
    def in_contact(self) -> bool:
        """Whether the contour has been found."""
        return self._contact_since is not None

    @property
    def moving(self) -> bool:
        """Whether the motion along the contour has begun and not ended."""
        return self._moving_from is not None and self.travelled < self.settings.length - 1e-5

    def observe(self, t: float, q_a: Array) -> None:
        """Takes the arm angles ``(n,)`` [rad] at ``t`` [s]."""
        self.history.add(t, q_a)

    def press_as(self, elasticity: float) -> None:
        """Uses this elasticity of tip and surface [N/m] from now on."""
        self.settings = replace(self.settings, elasticity=elasticity)

    def measured(self, t: Array, contact: Array) -> None:
        """Adds contact forces ``(m, 3)`` [N, tool frame] measured at ``t (m,)`` [s]; there is no filter, so None."""
        sideways = 0.0
        for instant, force_tool in zip(t, contact, strict=True):
            pose = self.history.pose(max(float(instant), self.history.first))
            force = self._axes @ (pose.rotation @ force_tool)
            here = self._axes @ (pose.translation - self._start.translation)
            normal = self._felt_normal(force)
            self.force = float(force @ normal)
            sideways += abs(float(force @ [-normal[1], normal[0]]))
            if self.force < self.settings.touch:
                continue
            if self._contact_since is None:
                self._contact_since = float(instant)
            self.last_touch = max(self.last_touch, float(instant))
            # [L] (3) along the normal: the tip position at which the force would be F_r.
            wanted = here + normal * (self.force - self.settings.force) / self.settings.elasticity
            self._points.append((float(instant), wanted))
        newest = self._points[-1][1] if self._points else None
        while (
            newest is not None
            and len(self._points) > 12
            and (np.linalg.norm(self._points[0][1] - newest) > self.settings.window or len(self._points) > 400)
        ):
            self._points.popleft()
        self.recedes = self._deeper_than_forecast(len(t))
        self.sideways = sideways / len(t)

    def _deeper_than_forecast(self, count: int) -> float:
        """How much deeper than the parabola of older points the newest ``count`` ones lie, times E [N].

        With a sensor that does not answer the tip's own way counts as the contour: where too little is felt, it
        recedes.
        """
        points = np.array([point for _, point in self._points])
        older = sum(instant < self._points[-1][0] - LATELY for instant, _ in self._points) if len(points) else 0
        if older <= 12 or np.linalg.norm(points[older - 1] - points[0]) < 0.3 * self.settings.window:
            return 0.0
        tangent, bend, foot = self._parabola(points[:older])
        left = np.array([-tangent[1], tangent[0]])
        off = (points[-count:] - foot) @ left - 0.5 * bend * ((points[-count:] - foot) @ tangent) ** 2
        return float(-np.mean(off) * np.sign(left @ self._normal)) * self.settings.elasticity

    def _felt_normal(self, force: Array) -> Array:
        """Out of the contour: square to the tangent that was felt; until it is known, the force less its friction.

        A contour pushes: what pulls is felt against the last normal, and turns nothing round.
        """
        points = np.array([point for _, point in self._points])
        if len(points) > 12 and np.linalg.norm(points[-1] - points[0]) > 0.4 * self.settings.window:
            tangent, _, _ = self._parabola(points)
            normal = np.array([-tangent[1], tangent[0]])
            normal = normal if normal @ self._normal > 0 else -normal
        elif np.linalg.norm(force) > self.settings.touch:
            angle = np.arctan(self.settings.friction) if self._moving_from is not None else 0.0
            c, s = np.cos(angle), np.sin(angle)
            rotated = np.array([c * force[0] - s * force[1], s * force[0] + c * force[1]])
            normal = rotated / np.linalg.norm(rotated) if rotated @ self._normal > 0 else self._normal
        else:
            normal = self._normal
        self._normal = normal
        return normal

    def _parabola(self, points: Array) -> tuple[Array, float, Array]:
        """Unit tangent, curvature (positive towards the left of the tangent) and foot at the newest end."""
        chord = points[-1] - points[0]
        along = chord / np.linalg.norm(chord)
        left = np.array([-along[1], along[0]])
        u, w = (points - points[-1]) @ along, (points - points[-1]) @ left
        scale = max(float(np.ptp(u)), 1e-6)
        A = np.column_stack([np.ones(len(u)), u / scale, (u / scale) ** 2])
        # A weak prior for a straight line keeps short windows from curving.
        A_ridge = np.vstack([A, [0.0, 0.0, 0.3 * np.sqrt(len(u)) * 0.02]])
        c = np.linalg.lstsq(A_ridge, np.append(w, 0.0), rcond=None)[0]
        slope, bend = c[1] / scale, 2 * c[2] / scale**2
        tangent = along + slope * left
        tangent = tangent / np.linalg.norm(tangent)
        if self._moving_from is not None and tangent @ self._forward() < 0:
            tangent, bend = -tangent, -bend
        return tangent, float(bend / (1 + slope**2) ** 1.5), points[-1] + c[0] * left

    def _forward(self) -> Array:
        """Direction of travel: along the contour, square to the last normal."""
        return np.array([self._normal[1], -self._normal[0]])

    def horizon(self, t: float, anew: bool = True) -> Array:
        """Desired joint positions ``q_d(k) … q_d(k + n_d - 1)`` from ``t`` on ``(n_d, n)`` [rad].

        Raises ``OutOfReachError`` where the contour leads out of the arm's reach. There is always time to plan.
        """
        self._plan.advance(round(t / self._T))
        if self._moving_from is None and self.in_contact and t - float(self._contact_since or 0) > self.settings.settle:
            self._moving_from = t
        keep = 1
        self._plan.follow(self._estimate(t, keep), keep)
        self.travelled = float(self._way(t))
        return self._plan.solve(keep, self._joint_angles)

    def _joint_angles(self, rows: slice, guess: Array) -> Array:
        positions = self._start.translation + self._plan.position[rows] @ self._axes
        rotations = np.broadcast_to(self._start.rotation, (len(positions), 3, 3))
        return self._kinematics.refine_rows(np.ascontiguousarray(rotations), positions, guess)

    def _way(self, t: npt.ArrayLike) -> Array:
        """Way along the contour at ``t``: a trapezoid of speed, or a triangle where it is too short for the speed."""
        if self._moving_from is None:
            return np.zeros_like(np.asarray(t, dtype=float))
        s = self.settings
        speed = min(s.speed, math.sqrt(s.length * s.acceleration))
        ramp = speed / s.acceleration
        tau = np.maximum(np.asarray(t, dtype=float) - self._moving_from, 0.0)
        up = np.where(tau < ramp, 0.5 * s.acceleration * tau**2, speed * (tau - 0.5 * ramp))
        braking = s.length - 0.5 * speed * ramp
        late = np.maximum(tau - (braking / speed + 0.5 * ramp), 0.0)
        down = braking + speed * np.minimum(late, ramp) - 0.5 * s.acceleration * np.minimum(late, ramp) ** 2
        return np.where(up < braking, up, down)

    def _estimate(self, t: float, keep: int) -> Array:
        """Wanted positions ``(samples, 2)`` of the coming cycles in the plane."""
        ahead = (keep + 1 + np.arange(self._plan.samples)) * self._T
        if not self.in_contact:
            return np.column_stack([self.settings.approach * (t + ahead), np.zeros(len(ahead))])
        points = np.array([point for _, point in self._points])
        if self._moving_from is None:
            return np.tile(points[-20:].mean(axis=0), (len(ahead), 1))
        if len(points) > 12 and np.linalg.norm(points[-1] - points[0]) > 0.3 * self.settings.window:
            tangent, bend, foot = self._parabola(points)
        else:
            tangent, bend, foot = self._forward(), 0.0, points[-12:].mean(axis=0)
        # The newest point belongs to its own instant; from there the path follows the parabola.
        way = self._way(t + ahead) - self._way(self._points[-1][0])
        bent = np.minimum(way, self.settings.ahead)
        straight = way - bent
        left = np.array([-tangent[1], tangent[0]])
        angle = bend * bent
        end = np.cos(angle)[:, None] * tangent + np.sin(angle)[:, None] * left
        chord = bent * np.sinc(angle / (2 * np.pi))
        curve = (chord * np.cos(angle / 2))[:, None] * tangent + (chord * np.sin(angle / 2))[:, None] * left
        return np.asarray(foot + curve + straight[:, None] * end)

    @property
    def normal(self) -> Array:
        """Unit vector out of the contour, from the last contact ``(3,)`` [base frame]."""
        return np.asarray(self._normal @ self._axes)

    def contact_torque(self, q_d: Array) -> Array:
        """Expected joint torques of the contact over the horizon ``(n_d, n)`` [N m], [L] 2.2."""
        if not self.in_contact:
            return np.zeros_like(q_d)
        return np.tile(self._kinematics.torque(q_d[0], self.settings.force * self.normal), (len(q_d), 1))
