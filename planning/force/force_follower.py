"""Keeps a contact force along a surface of unknown shape, and follows a line on it at the same time ([L] 4.2, 4.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.follower import Phase
from planning.force.contact import ASKED, FORCE_ERRORS, LOUDEST, SLOPE, TOGETHER, ContactSettings
from planning.force.contour import SPARE, SlidingPlan
from planning.force.force_noise import ForceNoise
from planning.force.surface_forecast import surfaces
from planning.line.filter_bank import FilterBank
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement
from planning.path.desired_path import FROZEN, ReferenceTable, planned_cycles
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory
from planning.path.reference import ReferencePath
from planning.path.speed_profile import SpeedProfile
from sensing.force.sensors import force_deviation

CUTOFF = 25.0
"""Frequency up to which the estimated surface is followed [Hz]."""
STEEPEST = 0.5
"""Largest slope of the surface against its nominal plane that is assumed."""
KNOWN_LATERAL = 0.001
"""Standard deviation of the lateral deviation below which the line counts as known [m]."""
STEP = 0.006
"""Distance of the heights that the slope along the path is taken from [m]."""
FRICTION = 0.3
"""Standard deviation of the tip's coefficient of friction: along a slope that is not known yet it counts as force."""
SLIDES = 1e-4
"""Way over which friction turns against a tip that begins to move [m]."""
KNOWN_AFTER = 0.03
"""Way after which the slope along the path is known from the map [m]."""

SURELY = 5.0
"""Standard deviations of the mean of a cycle's samples from which on a force is none of the noise's."""

Errors = tuple[float, float, float]
"""Standard deviations of ln E over the assumed E, of how late forces are [s], and of the coefficient of friction."""


def surface_filter(errors: Errors) -> FilterBank:
    """The filter of a surface's height, of which nothing is known but that it is smooth."""
    return FilterBank([DeviationFilter(model, biases={"force": errors}) for model in surfaces()])


class SurfaceFollower:
    r"""Desired joint positions over a horizon from a reference path, wrenches and, with a camera, line points.

    Both sensors measure the same thing, the deviation :math:`\Delta x_r` of the path from its reference, in directions
    that are neither the same nor orthogonal: the camera across the path in the nominal plane, the force along the
    surface's own normal. One filter holds a map of the deviation in two directions over arc length; late samples are
    assigned to the place where the arm was ([L] (5)), so delay does not harm them.

    Args:
        robot: the arm.
        reference: the reference path; ``up`` points out of the nominal surface.
        profile: the travel along it.
        n_d: desired positions a call of ``horizon`` gives.
        settings: settings of the run.
        fusion: makes the filter over models with two directions, from the errors of the force that it estimates.
        lateral: whether a sensor shows the lateral deviation, too; without one the path is the reference's there.
    """

    def __init__(self, robot: Robot, reference: ReferencePath, profile: SpeedProfile, n_d: int,
                 settings: ContactSettings, *, fusion: Callable[[Errors], FilterBank] = surface_filter,
                 lateral: bool = False) -> None:
        self.robot, self.reference, self.profile, self.n_d, self.settings = robot, reference, profile, n_d, settings
        self.history = PoseHistory(robot)
        self.noise = ForceNoise(settings.noise)
        """Of the force sensor, as the approach and the travel have shown it."""
        self._T = robot.t_ipo
        self._kinematics = InverseKinematics(robot)
        samples, start_height = planned_cycles(n_d, self._T, SPARE), settings.start_height
        self._force_errors, self._made = settings.force_errors, fusion
        self.fusion = self._fresh()
        self._table = table = ReferenceTable(self._kinematics, reference, profile, 2 * samples)
        first = pin.SE3(table.rotations[0], table.frames.position[0] + start_height * table.frames.up[0])
        self._q_start = self._kinematics.solve(first, table.q[0])
        self._plan = SlidingPlan(n_d, self._T, self._q_start, np.array([0.0, start_height]), CUTOFF)
        self.phase = Phase.APPROACH
        self._lateral = lateral
        self._height = start_height
        self._contact_since: float | None = None
        self._near_since: float | None = None
        self.t_travel = np.inf
        """Instant at which the travel began; infinite before [s]."""
        self._t_lift = np.inf
        self.last_touch = -np.inf
        """Last instant at which there was contact [s]."""
        self.force = self.sideways = 0.0
        """Normal force of the last samples, and that along the surface [N]."""
        self.felt = np.zeros((0, 4))
        """Of the last samples instant [s], arc length, height over the reference [m], normal force [N] ``(m, 4)``."""
        self.slope = np.zeros(2)
        """Slopes of the surface along and across the path, as the map and the force vector show them."""

    @property
    def q_start(self) -> Array:
        """Joint angles ``(n,)`` [rad] above the start of the reference, where the arm has to rest."""
        return self._q_start.copy()

    def observe(self, t: float, q_a: Array) -> None:
        """Stores the arm angles ``(n,)`` [rad] measured at ``t`` [s]; call it before each cycle's samples."""
        self.history.add(t, q_a)

    def speed_at(self, t: float) -> float:
        """Speed of the travel at ``t`` [m/s]."""
        return self.profile.at(t - self.t_travel)[1] if np.isfinite(self.t_travel) else 0.0

    def s_at(self, t: float) -> float:
        """Arc length of the travel at ``t`` [m]."""
        return self.profile.at(t - self.t_travel)[0] if np.isfinite(self.t_travel) else 0.0

    def press_as(self, elasticity: float) -> None:
        """Uses this elasticity of tip and surface [N/m] from now on."""
        self.settings = replace(self.settings, elasticity=elasticity)
        if self._contact_since is None:
            self.fusion = self._fresh()

    def ask(self, amplitude: float) -> None:
        """Makes the tip oscillate by this force [N] from now on, limited to ``LOUDEST`` of the desired one."""
        self.settings = replace(self.settings, asking=min(amplitude, LOUDEST * self.settings.force))

    def _fresh(self) -> FilterBank:
        """The filter of a surface that has not been touched, for a contact of the assumed elasticity."""
        return self._made(self.errors)

    @property
    def errors(self) -> Errors:
        """Estimated errors of the force for a contact of the assumed elasticity."""
        ratio, lateness = self._force_errors
        return ratio, min(lateness, self.settings.lateness), FRICTION

    def fuse(self, t: Array, measurement: Measurement) -> Fused:
        """Fuses a measurement that ``measured`` returned, and updates the noise of the forces by its innovations."""
        fused = self.fusion.update(measurement)
        if self.phase is Phase.TRAVEL:
            self.noise.hear(t, self.settings.elasticity * fused.innovation[:, None])
        return fused

    def measured(self, t: Array, contact: Array) -> Measurement | None:
        """A measurement of the deviation by the contact forces since the last cycle; None before there is contact.

        Args:
            t: instants they belong to ``(m,)`` [s].
            contact: forces of the environment on the tool ``(m, 3)`` in the tool frame [N], bias and weight taken away.
        """
        poses = [self.history.pose(max(float(instant), self.history.first)) for instant in t]
        points = np.array([pose.translation for pose in poses])
        forces = np.array([pose.rotation @ f for pose, f in zip(poses, contact, strict=True)])
        s, lateral, height = self.reference.project(points, self.s_at(float(t[-1])), span=TOGETHER)
        # Before the travel the tip stays at one place. Its deflection there while the force rises is no slope.
        s = np.where(t < self.t_travel, 0.0, s)
        frames = self.reference.frames(s)
        middle = len(t) // 2
        up, across, along = frames.up[middle], frames.normal[middle], frames.tangent[middle]
        normal = self._normal(float(s[middle]), forces.mean(axis=0), along, across, up)
        self.felt = np.column_stack([t, s, height, forces @ normal])
        self.force = float(np.mean(self.felt[:, 3]))
        self.sideways = float(np.linalg.norm(forces.mean(axis=0) - self.force * normal))
        if not self._in_contact(t):
            if self.phase is Phase.APPROACH:
                self.noise.hear(t, contact)
            return None
        settings = self.settings
        deviations = [force_deviation(f, up, settings.force, settings.elasticity, sigma=self.noise.std, normal=normal)
                      for f in forces]
        value = np.array([deviation.value for deviation in deviations])
        # A tip with damping adds a force proportional to its velocity into the surface; along the surface there is
        # none.
        sinking = float(self.history.velocity(max(float(t[middle]), self.history.first + 2e-3))[0] @ normal)
        covariance = np.diag([deviation.sigma**2 for deviation in deviations]) + self._in_common(value, sinking)
        if self._lateral and self._lateral_sigma(s[middle : middle + 1]) < KNOWN_LATERAL:
            # With a camera the force measures the distance along the surface's normal, not along the reference's. While
            # the line is not known the force refers to the tip's place, and says nothing lateral.
            direction = np.tile([normal @ across, normal @ up], (len(t), 1))
            origin, value = direction[:, 0] * lateral + direction[:, 1] * height, value * float(normal @ up)
        else:
            direction, origin = np.tile([0.0, 1.0], (len(t), 1)), height
        value = origin + value
        # With E assumed too large a deviation is measured as too small, by a ratio.
        wrong = np.column_stack([np.zeros(len(t)), np.full(len(t), sinking),
                                 np.full(len(t), self._by_friction(float(s.mean())))])
        return Measurement(float(t[-1]), s, value, covariance, direction, "force", wrong,
                           origin=None if self.phase is Phase.SETTLE else origin, at=float(s.max()))

    def _in_contact(self, t: Array) -> bool:
        """Whether what was felt at ``t (m,)`` [s] is a contact that is kept; the first one ends the approach."""
        # Noise alone exceeds this in one of some three million means.
        if self.force > max(self.settings.touch, SURELY * self.noise.std / np.sqrt(len(t))):
            self.last_touch = max(self.last_touch, float(np.max(t)))
            if self._contact_since is None:
                self._contact_since = float(t[-1])
                self.phase = Phase.SETTLE
        return self._contact_since is not None and self.phase not in (Phase.LIFT, Phase.DONE)

    def _in_common(self, value: Array, sinking: float) -> Array:
        """Covariance ``(m, m)`` [m²] of what a cycle's samples have in common; ``sinking``: the tip's way out [m/s]."""
        if self.phase is Phase.SETTLE:
            # At the desired force the height is known whatever E is; while the force rises E is as uncertain as at
            # first. The deflection while the force rises tells little of E along the path.
            return self.settings.position_noise**2 + FORCE_ERRORS[0] ** 2 * np.outer(value, value)
        # The delay error of the arm's oscillation is not constant over the path. A forecast with a short length scale
        # would mistake it for surface, enlarge it thirty times, and excite the arm even more.
        common = self.settings.position_noise**2 + (FORCE_ERRORS[1] * sinking) ** 2
        return np.full((len(value), len(value)), common)

    def _lateral_sigma(self, s: Array) -> float:
        """Standard deviation of the map across the path, in which members that differ along ``up`` alone agree [m]."""
        return float(np.sqrt(self.fusion.likeliest.deviation(s)[1][0, 0]))

    def _normal(self, s: float, force: Array, along: Array, across: Array, up: Array) -> Array:
        """Surface normal: slope along the path from the map, since friction falsifies it, across from the force.

        A slope that was only just felt would be taken from the very force it is to correct, so it counts by the way
        travelled.
        """
        if self._contact_since is not None:
            self.slope[0] = self._known(s) * float(np.clip(self._slope_along(s, STEP), -STEEPEST, STEEPEST))
            if force @ up > self.settings.touch:
                across_now = float(np.clip(-(force @ across) / (force @ up), -STEEPEST, STEEPEST))
                self.slope[1] += 0.1 * (across_now - self.slope[1])
        normal = up - self.slope[0] * along - self.slope[1] * across
        return np.asarray(normal / np.linalg.norm(normal))

    def _known(self, s: float) -> float:
        """How far the slope along the path is known at arc length ``s`` [m]: from 0 to 1."""
        return min(max(s - 2 * STEP, 0.0) / KNOWN_AFTER, 1.0)

    def _by_friction(self, s: float) -> float:
        """Height at arc length ``s`` [m] that friction with coefficient 1 hides while the slope is not known [m]."""
        slides = -np.expm1(-max(s, 0.0) / SLIDES)
        return float((1.0 - self._known(s)) * slides * SLOPE * self.settings.force / self.settings.elasticity)

    def _slope_along(self, s: float, step: float) -> float:
        """Slope along the path at arc length ``s``, from heights ``step`` [m] apart."""
        before, after = self.fusion.mean(np.array([s - step, s + step]))[:, 1]
        return float(after - before) / (2 * step)

    @property
    def descended(self) -> float:
        """Distance that the approach has descended [m]."""
        return self._height - float(self._plan.position[0, 1])

    def horizon(self, t: float, anew: bool = True) -> Array:
        """Desired joint positions ``q_d(k) … q_d(k + n_d - 1)`` from ``t`` on, shape ``(n_d, n)`` [rad].

        A cycle without time for a new plan (``anew``) continues the last one. Raises ``OutOfReachError`` where the
        surface leads out of the arm's reach.
        """
        self.advance(t)
        k, keep = self._plan.cycle, FROZEN
        if anew:
            self._plan.follow(self._estimate(t, keep, self._rows(k + keep + 1 + np.arange(self._plan.samples))), keep)
        return self._plan.solve(keep, self._joint_angles)

    def _joint_angles(self, rows: slice, guess: Array) -> Array:
        cycles = self._rows(self._plan.cycle + np.arange(rows.start, rows.stop))
        positions = self._table.displaced(cycles, self._plan.position[rows])
        return self._kinematics.refine_rows(self._table.rotations[cycles], positions, guess,
                                            wanted=self._table.q[cycles])

    def _rows(self, cycles: NDArray[np.int_]) -> NDArray[np.int_]:
        """Rows of the tables for absolute cycles: the first one before the travel, the last one behind it."""
        travel = round(self.t_travel / self._T) if np.isfinite(self.t_travel) else np.iinfo(np.int64).max // 2
        return np.clip(cycles - travel, 0, len(self._table) - 1).astype(int)

    def advance(self, t: float) -> None:
        """Advances to the cycle ``t`` [s] and starts the next phase when it is due; part of ``horizon``."""
        k = round(t / self._T)
        self.fusion.travel(self.s_at(t))
        self._plan.advance(k)
        if self.phase is Phase.SETTLE:
            near = abs(self.force - self.settings.force) < 0.15 * self.settings.force
            self._near_since = (self._near_since if self._near_since is not None else t) if near else None
            if self._near_since is not None and t - self._near_since >= self.settings.settle:
                self.phase = Phase.TRAVEL
                self.t_travel = (k + FROZEN + 1) * self._T
        elif self.phase is Phase.TRAVEL and t > self.t_travel + self.profile.duration + self.settings.settle:
            self.phase = Phase.LIFT
            self._t_lift = t
            self._lift_from = self._plan.position[0].copy()
        elif self.phase is Phase.LIFT:
            risen = self._plan.position[0, 1] - self._lift_from[1]
            if risen > 0.95 * self.settings.lift:
                self.phase = Phase.DONE

    def _estimate(self, t: float, keep: int, rows: NDArray[np.int_]) -> Array:
        """Wanted deviation ``(samples, 2)`` of the coming cycles: descending, on the map, or lifting."""
        ahead = (keep + 1 + np.arange(self._plan.samples)) * self._T
        estimate = self.fusion.mean(self._table.s[rows])
        if self._contact_since is None:
            estimate[:, 1] = self._height - self.settings.approach * (t + ahead)
        elif self.phase in (Phase.SETTLE, Phase.TRAVEL):
            # The oscillation begins at the touch, so that the sensor is tested before the tip leaves that place.
            depth = self.settings.asking / self.settings.elasticity
            estimate[:, 1] -= depth * np.sin(2.0 * np.pi * ASKED * (t + ahead - self._contact_since))
        elif self.phase in (Phase.LIFT, Phase.DONE):
            rise = np.clip((t + ahead - self._t_lift) * 0.05, 0.0, self.settings.lift)
            estimate = self._lift_from + np.column_stack([np.zeros(len(rise)), rise])
        return np.asarray(estimate)

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one; see ``planning.follower.Follower``."""
        return self.phase is Phase.DONE

    def desired_deviation(self, t: float) -> Array:
        """Desired deviation (lateral, up) at the current cycle ``(2,)`` [m]."""
        return self._plan.position[0].copy()

    @property
    def normal(self) -> Array:
        """Unit vector out of the surface at the tip, by map and force ``(3,)`` [base frame]."""
        frames = self.reference.frames(np.array([self.s_at(self._plan.cycle * self._T)]))
        normal = frames.up[0] - self.slope[0] * frames.tangent[0] - self.slope[1] * frames.normal[0]
        return np.asarray(normal / np.linalg.norm(normal))

    def contact_torque(self, q_d: Array) -> Array:
        """Expected joint torques τ_d of the contact over the horizon ``(n_d, n)`` [N m], [L] 2.2.

        Jᵀ F_d with the wanted force along the surface's normal; zero without contact.
        """
        if self._contact_since is None or self.phase in (Phase.LIFT, Phase.DONE):
            return np.zeros_like(q_d)
        return np.tile(self._kinematics.torque(q_d[0], self.settings.force * self.normal), (len(q_d), 1))


# Direct force feedback, [L] (1): the usual method, and the baseline.

class DirectForceFeedback:
    r"""Adds the force error, times a gain, to the command at every cycle.

    .. math:: x_c(k) = x_c(k-1) + (x_r(k) - x_r(k-1)) + K_p\, \Delta s(k) + K_d\, (\Delta s(k) - \Delta s(k-1))

    [L] (1) with the reference's own motion added; Δs is the force error along the nominal normal. Approach and phases
    are the follower's; only the force control differs.

    Args:
        follower: for reference, phases and the record of poses; its map is not used.
        k_p, k_d: gains on the error and on its change [m/N per cycle, m/N].
        limit: largest change of the command in a cycle [m].
    """

    def __init__(self, follower: SurfaceFollower, k_p: float, k_d: float = 0.0, limit: float = 0.002) -> None:
        if not k_p >= 0:
            raise InputError("expected zero or a positive number", field="k_p", value=k_p)
        self._follower, self._k_p, self._k_d, self._limit = follower, k_p, k_d, limit
        self._kinematics = InverseKinematics(follower.robot)
        self._height: float | None = None
        self._error = self._last_error = 0.0
        self._q = follower.q_start
        self.lifted = 0.0
        """How far the tip has been lifted at the end [m]."""

    def horizon(self, t: float, q_d: Array) -> Array:
        """The follower's horizon ``(n_d, n)`` [rad] until there is contact; this controller's own path from then on."""
        if self._follower.phase is Phase.APPROACH:
            return self._follower.horizon(t)
        self._follower.advance(t)
        return q_d

    def done(self, t: float) -> bool:
        """Whether the tip is off the surface at the end of its path."""
        return self.lifted >= self._follower.settings.lift

    def update(self, force: float) -> None:
        """Stores the newest normal force [N]."""
        self._error = force - self._follower.settings.force

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint angles ``(n,)``; before contact those of ``q_d``, the follower's horizon."""
        follower = self._follower
        if follower.phase is Phase.APPROACH:
            self._q = q_d[0].copy()
            return self._q
        if self._height is None:
            pose = self._kinematics.fk(self._q)
            self._height = float(follower.reference.project(pose.translation[None], 0.0)[2][0])
            self._last_error = self._error
        change = self._k_p * self._error + self._k_d * (self._error - self._last_error)
        self._last_error = self._error
        if follower.phase in (Phase.LIFT, Phase.DONE):
            change = 0.05 * follower.robot.t_ipo
            self.lifted += change
        self._height += float(np.clip(change, -self._limit, self._limit))
        s = follower.s_at(t)
        frames = follower.reference.frames(np.array([s]))
        target = pin.SE3(follower.reference.rotation(s), frames.position[0] + self._height * frames.up[0])
        self._q = self._kinematics.refine([target], self._q[None])[0]
        return self._q.copy()
