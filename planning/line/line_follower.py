"""Sensor-based path planning along a line that a camera sees ahead of the tool ([L] 4, Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.robots.robot import Robot
from planning import LineLostError, LineNeverSeenError
from planning.follower import Phase
from planning.line.deviation_model import SHAPES, Expected, PathDeviation
from planning.line.fusion import DeviationFilter
from planning.line.measurement import (
    SEEN_AHEAD,
    Fused,
    LineAhead,
    Measurement,
    SeenLine,
    polynomial_measurement,
)
from planning.path.desired_path import DesiredPath, planned_cycles
from planning.path.path_kernels import displaced_frames, sensor_errors
from planning.path.pose_history import PoseHistory, check_cycle
from planning.path.reference import ReferencePath
from planning.path.speed_profile import SpeedProfile

MEASUREMENTS = ("polynomial", "points")
KNOCK = 0.01
"""How far a camera may be turned when somebody knocks it, standard deviation [rad]."""
BEND = 0.4
"""Distance over which a surface's bend becomes another [m]."""
SPREAD = 0.1
"""Length of line over which a field's points are spread [m]; ink missing over a third of it leaves three of five."""
ALONG = 0.03
"""How much earlier than its reference the line may end [m]: drawn elsewhere along the path, and seen point by point."""
SILENCE = 0.25
"""Time without any field after which the line counts as not seen [s]."""
REST = 0.2
"""Time at rest behind the end of the path until the motion is done [s]."""


@dataclass(frozen=True)
class FollowerSettings:
    """Assumed sensor errors and limits of a line follower.

    Attributes:
        noise: lateral error of a point in addition to that of its detection [m].
        common: lateral error common to all points of a field, different from field to field [m].
        yaw: error of the camera's mounting about the surface normal, standard deviation [rad]; estimated on the way.
        stamp: error of the time stamps, standard deviation [s]; estimated on the way.
        height, tilt, bow: how far the surface may be from the reference's along its normal [m], how far tilted about
            its axes [rad], how far bent [m], standard deviations. All are estimated during the motion from the changing
            view of the line ([L] 4.2), and the tool follows; with a height of 0 the surface is taken as known.
        shape, length: standard deviation of the line's shape from the reference's [m], and the distance over which that
            difference changes [m].
        points: number of line points per field.
        view: nearest and farthest distance ahead of the TCP at which the camera shows the line well [m].
        latency: usual age of a field when it arrives; decides where in ``view`` to look [s].
        max_gap: distance that may be travelled without seeing the line, whatever the map says [m].
        unsure: standard deviation of the line at the tool up to which the map is followed without new fields [m]. With
            the default the tool is on a line 3 mm wide with a probability of 95 %.
        max_search: distance that may be travelled before the line is seen first [m].
        measurement: which measurement is made of a field: ``polynomial``, value and slope of the polynomial through its
            points ([L] 5), or ``points``, each of them.
        line_span: arc lengths of the reference between which the line is [m]; all of it if None.
        eye: where the camera is in the tool frame [m]; without it heights are not estimated.
    """

    noise: float = 2e-5
    common: float = 1e-4
    yaw: float = 0.003
    stamp: float = 0.0005
    height: float = 0.003
    tilt: float = 0.015
    bow: float = 0.0003
    shape: float = SHAPES[0][0]
    length: float = SHAPES[0][1]
    points: int = 5
    view: tuple[float, float] = (0.02, 0.17)
    latency: float = 0.04
    max_gap: float = 0.15
    unsure: float = 0.75e-3
    max_search: float = 0.3
    measurement: str = "polynomial"
    line_span: tuple[float, float] | None = None
    eye: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.measurement not in MEASUREMENTS:
            raise InputError(f"expected one of {', '.join(MEASUREMENTS)}", field="measurement", value=self.measurement)
        for key in ("points", "max_gap", "unsure", "max_search", "shape", "length"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))
        for key in ("noise", "common", "yaw", "stamp", "height", "tilt", "bow", "latency"):
            if not getattr(self, key) >= 0:
                raise InputError("expected zero or a positive number", field=key, value=getattr(self, key))
        if not 0 <= self.view[0] < self.view[1]:
            raise InputError("expected the nearer distance first", field="view", value=self.view)


class LineFollower:
    r"""Desired joint positions over a horizon, from a reference path and camera fields at any times.

    Each seen point :math:`\hat x_a + \Delta x_a` of a field is compared with the reference *at the same place*:
    :math:`\Delta x_r = \Delta x_a - (x_r - \hat x_a)`, [L] (5), in the direction of the path's lateral normal, at the
    pose of the exposure. The deviations are fused into a map over arc length, so it does not matter when and how often
    a place was seen. The desired path is :math:`x_r(s(t)) + d(t)\, n(s(t))`, [L] (6), with the smoothed deviation
    ``d``; its speed is the reference's. In directions that are not sensed it is the reference. Other sensors are fused
    with ``fuse`` ([L] 4.3).

    "If multiple features can be sensed it is further possible to extract the distance d" ([L] 4.2): a pixel is a ray,
    so where the surface is higher than assumed by h, the point is displaced along the ray, and what is measured is

    .. math:: z = d - \frac{r_n}{r_u} h

    with the ray's components across the path and out of the surface. One place seen under different rays, as the line
    comes nearer in a curve, distinguishes d and h; the map holds both, and the desired path follows both.
    Raises ``InputError`` for a cycle too long for a camera.

    Args:
        robot, reference, profile: the arm, the reference path, and the travel along it.
        n_d: desired positions a call of ``horizon`` gives.
        settings: assumed sensor errors and limits.
        fusion: the filter; by default a map of the path with the camera's errors as ``settings`` say.
        t_start: controller time at which the travel begins [s].
    """

    phase = Phase.TRAVEL
    """Of a motion that touches nothing."""

    def __init__(self, robot: Robot, reference: ReferencePath, profile: SpeedProfile, n_d: int = 25, *,
                 settings: FollowerSettings | None = None, fusion: DeviationFilter | None = None,
                 t_start: float = 0.0) -> None:
        self.robot, self.reference, self.profile, self.n_d = robot, reference, profile, n_d
        self.settings = settings = settings or FollowerSettings()
        self.t_start = t_start
        check_cycle(robot)
        self.history = PoseHistory(robot)
        self._T, self._evenly = robot.t_ipo, np.linspace(0.0, 1.0, settings.points)
        # A little more than the horizon and the smoothing behind it.
        ahead = max(0.3, planned_cycles(n_d, self._T) * self._T * profile.top_speed + 0.05)
        self._eye = None if settings.eye is None else np.array(settings.eye)
        expects_height = settings.eye is not None and settings.height != 0
        up = Expected(settings.height, settings.tilt, settings.bow, BEND) if expects_height else None
        self.fusion = fusion or DeviationFilter(
            PathDeviation(reference, across=Expected(shape=settings.shape, length=settings.length), up=up, ahead=ahead),
            biases={"camera": (settings.yaw, settings.stamp)},
            moved={"camera": (KNOCK, settings.stamp)},
        )
        self.path = DesiredPath(robot, reference, profile, n_d, directions=self.fusion.model.directions,
                                t_start=t_start)
        self._line_span = settings.line_span or (0.0, reference.length)
        self._last_seen: tuple[float, float] | None = None
        self._front = -np.inf
        self._changed = False
        self._field_t = -np.inf

    def led_by(self, feedforward: Feedforward) -> None:
        """Limits corrections from now on to those that a feedforward's commands can make within the limits."""
        self.path.led_by(feedforward)

    @property
    def q_start(self) -> Array:
        """Joint angles ``(n,)`` [rad] at the start of the reference, where the arm has to rest."""
        return self.path.q_reference[0].copy()

    @property
    def q_reference(self) -> Array:
        """The reference in joint space at every cycle from the start on ``(K, n)`` [rad]: method ``none``."""
        return self.path.q_reference

    @property
    def duration(self) -> float:
        """Time from ``t_start`` until the end of the path [s]."""
        return self.profile.duration

    def finished(self, t: float) -> bool:
        """Whether the desired path has come to rest at its end."""
        return t - self.t_start >= self.profile.duration

    @property
    def lasts(self) -> int:
        """Cycles from the first to the last, in which the path has come to rest."""
        return int(np.ceil((self.t_start + self.duration + REST) / self._T))

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one; see ``planning.follower.Follower``."""
        return round(t / self._T) + 1 >= self.lasts

    def s_at(self, t: float) -> float:
        """Arc length of the travel at ``t`` [m]."""
        return float(self.profile.s(t - self.t_start))

    def speed_at(self, t: float) -> float:
        """Speed of the travel at ``t`` [m/s]."""
        return float(self.profile.speed(t - self.t_start))

    def contact_torque(self, q_d: Array) -> None:
        """None, as following by camera has no contact."""
        return

    def observe(self, t: float, q: Array) -> None:
        """Stores the joint angles ``q (n,)`` [rad] measured at ``t`` [s]; call it before each cycle's fields."""
        self.history.add(t, q)

    def predict(self, t: float) -> LineAhead:
        """The line as predicted for a field exposed at ``t`` [s], by the pose of the TCP then."""
        s_tcp, speed = self.profile.at(t - self.t_start)
        return line_ahead(self.reference, self.fusion, s_tcp + self._where_to_look(speed))

    def _where_to_look(self, speed: float) -> Array:
        """What the TCP passes before the field has come and gone into the plan need not be looked at, if there is more.

        Where the TCP passes nearly all of the view in that time the points are spread no less: those already passed
        hold the map at the place from which it goes on.
        """
        near, far = self.settings.view
        passed = speed * (self.settings.latency + 2 * self._T)
        first = min(max(near, passed), max(near, far - SPREAD))
        return first + (min(far, first + SPREAD) - first) * self._evenly

    def update(self, line: SeenLine, pose: pin.SE3 | None = None) -> Fused | None:
        """Fuses one field, whenever it arrives; None if it showed nothing.

        The TCP's ``pose`` at the exposure is interpolated from ``observe`` by default.
        """
        self._field_t = max(self._field_t, line.t)
        if not line.seen:
            return None
        used = np.asarray(line.used, dtype=bool) & np.isfinite(line.points_tcp).all(axis=1)
        if not used.any():
            return None
        points = self.measurement(line.t, line.points_tcp[used], line.sigma[used], pose)
        front = float(points.s.max())
        if self.settings.measurement == "points" or len(points.s) < 2:
            fused = self.fuse(points)
            front = float(points.s[fused.used].max()) if fused.dof else front
        else:
            fused = self.fuse(polynomial_measurement(points)[0])
        if fused.dof:
            sighting = (line.t, self.profile.at(line.t - self.t_start)[0])
            self._last_seen = max(self._last_seen or sighting, sighting)
            self._front = max(self._front, front)
        return fused

    def fuse(self, measurement: Measurement) -> Fused:
        """Fuses a measurement of any sensor, [L] 4.3; camera fields come through ``update``."""
        fused = self.fusion.update(measurement)
        self._changed = self._changed or fused.dof > 0
        return fused

    def measurement(self, t: float, points_tcp: Array, sigma: Array, pose: pin.SE3 | None = None) -> Measurement:
        """Deviations from the reference of points ``(m, 3)`` seen in the tool frame at ``t``, [L] (5).

        Args:
            t: instant of the exposure [s].
            points_tcp: ``(m, 3)`` [m].
            sigma: standard deviation of each point across the line ``(m,)`` [m].
            pose: of the TCP at the exposure; interpolated from ``observe`` if None.
        """
        pose = self.history.pose(t) if pose is None else pose
        lever = points_tcp @ pose.rotation.T
        points = lever + pose.translation
        s, value, height = self.reference.project(points, self.profile.at(t - self.t_start)[0] + SEEN_AHEAD)
        frames = self.reference.frames(s)
        covariance = np.diag(sigma**2 + self.settings.noise**2) + self.settings.common**2
        # A camera turned about itself moves a point by up × (point - camera), a wrong time stamp by the velocity the
        # point has on the tool.
        ray = lever if self._eye is None else lever - pose.rotation @ self._eye
        # Given poses have no history for a velocity: time stamps are taken as right.
        turned, moved, slant = sensor_errors(frames.normal, frames.up, ray, lever, *self.history.velocity(t))
        direction = None
        if self.fusion.model.directions > 1:
            direction = np.zeros((len(s), self.fusion.model.directions))
            direction[:, 0] = 1.0
            if self._eye is not None:
                direction[:, 1] = -slant
                value = value + direction[:, 1] * height
        return Measurement(t, s, value, covariance, direction, bias=np.stack([turned, moved], axis=1))

    def deviation(self, s: Array) -> tuple[Array, Array]:
        """Estimated lateral deviation of the line from the reference at ``s (m,)`` and its standard deviation [m]."""
        mean, variance = self.fusion.deviation(np.asarray(s, dtype=float))
        return mean[:, 0], np.sqrt(variance[:, 0])

    def desired_deviation(self, t: float) -> Array:
        """Desired deviation in the sensed directions at ``t`` ``(directions,)`` [m]."""
        return np.asarray(self.path.deviation(t)[0])

    def horizon(self, t: float, anew: bool = True) -> Array:
        """Desired joint positions ``q_d(k) … q_d(k + n_d - 1)`` from ``t`` on, shape ``(n_d, n)`` [rad].

        Only what a new estimate changes is planned again, so there is time for a plan in every cycle.

        Raises:
            LineLostError: nothing was seen for longer than allowed, and the map does not know the line at the tool.
            OutOfReachError: the seen line leads out of the arm's reach.
        """
        s = float(self.path.s[self.path.cycle(t)])
        self.fusion.travel(s)
        self._check_seen(t, s)
        q = self.path.horizon(t, self.fusion.mean, self._changed)
        self._changed = False
        return q

    def check(self, t: float) -> None:
        """Does nothing, as ``horizon`` already checks whether the line was seen."""
        return

    def _check_seen(self, t: float, s: float) -> None:
        """Limits what is travelled without a sight of the line, from field to field; late fields are not missing.

        Distance alone would end fast runs: the faster, the farther from field to field, and the farther ahead the line
        is seen. So the map leads on for as long as it is sure of the line where the tool is; behind the line's end
        there is nothing to be sure of.
        """
        begin, end = self._line_span
        looked = self.profile.at(max(self._field_t, t - SILENCE) - self.t_start)[0]
        if self._last_seen is None:
            if looked - begin > self.settings.max_search:
                raise LineNeverSeenError(t, s, self.settings.max_search)
        elif looked - max(self._last_seen[1], begin) > self.settings.max_gap and self._front < end - ALONG:
            sigma = float(self.deviation(np.array([min(s, end - ALONG)]))[1][0])
            if sigma > self.settings.unsure:
                raise LineLostError(t, s, *self._last_seen, self.settings.max_gap, sigma)


class Uncorrected:
    """The uncorrected reference, with the interface of a follower.

    Args:
        follower: for its reference and its tables; its map goes along, so that it says where the line should be.
    """

    def __init__(self, follower: LineFollower) -> None:
        self._follower = follower

    def horizon(self, t: float, q_d: Array) -> Array:
        """The reference over the horizon ``(n_d, n)`` [rad] from ``t`` [s] on."""
        f = self._follower
        f.fusion.travel(f.s_at(t))
        k = min(max(round((t - f.t_start) / f.robot.t_ipo), 0), len(f.q_reference) - f.n_d)
        return f.q_reference[k : k + f.n_d]

    def command(self, t: float, q_d: Array) -> Array | None:
        """None, which means that the reference is commanded as planned."""
        return None

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one; see ``planning.follower.Follower``."""
        return self._follower.done(t)


def line_ahead(reference: ReferencePath, fusion: DeviationFilter, s: Array) -> LineAhead:
    """The predicted line at some places, from the map of its deviation from the reference.

    Args:
        reference: the reference path.
        fusion: the map.
        s: arc lengths ``(m,)`` [m].
    """
    step, m = 1e-3, len(s)
    H = fusion.model.basis(np.concatenate([s, s - step, s + step]))
    covariance = fusion.covariance(H[:m, 0])
    deviation = H @ fusion.state
    slope = (deviation[2 * m :] - deviation[m : 2 * m]) / (2 * step)
    frames = reference.frames(s)
    points, tangents, up = displaced_frames(frames.position, frames.tangent, frames.normal, frames.up, frames.curvature,
                                            deviation[:m], slope)
    return LineAhead(s, points, tangents, up, np.sqrt(covariance.diagonal()), covariance)
