r"""A line seen by a camera on a surface of unknown height ([L] 4.3, sensors that are not orthogonal).

A pixel is a ray, not a point. Where the surface is higher than assumed, the seen point is displaced along the ray, so
a field measures the deviation :math:`\Delta x_r` not along the path's lateral normal but across the ray,

.. math:: g = (1,\; -r_n / r_u)

with the components :math:`r_n, r_u` of the ray across the path and out of the surface. The force measures along the
surface's normal: two sensors whose directions are neither the same nor orthogonal, and one filter for both. A camera
that looks nearly straight down (``OBLIQUE``) hardly determines the height, which is then taken from the map with its
variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning import LineLostError, LineNeverSeenError
from planning.follower import Phase
from planning.force.force_follower import SurfaceFollower
from planning.line.measurement import SEEN_AHEAD, Fused, LineAhead, Measurement, SeenLine
from planning.path.path_kernels import sensor_errors, unit

NARROW = 0.06
"""Length of line over which a field's points are spread at least, however much of the view the tool passes [m]."""
OBLIQUE = 0.1
"""Slope of the rays across the path from which a field says something of the height, too."""


@dataclass(frozen=True)
class SightSettings:
    """Assumed errors of the camera, and when a field is rejected.

    Attributes:
        noise: lateral error of a point in addition to that of its detection [m].
        common: lateral error common to all points of a field [m].
        yaw, stamp, scale: standard deviations of mounting angle [rad], time stamps [s] and relative distance (or focal
            length); all are estimated on the way.
        view: nearest and farthest distance ahead of the TCP at which the camera shows the line well [m].
        latency: assumed age of a field when it arrives [s]: where to look depends on it, no measurement does.
        max_gap: distance that may be travelled without seeing the line [m].
        scatter: largest scatter of a field's points about the estimated line, moved and turned [m].
        doubt: time without a good field after which one field alone is not used any more [s].
        agreement: largest difference between two consecutive fields then [m].
        distance_ratio: assumed over true distance from camera to surface, 1 unless an error is to be studied.
    """

    noise: float = 3e-5
    common: float = 4e-5
    yaw: float = 0.003
    stamp: float = 0.0005
    scale: float = 0.2
    view: tuple[float, float] = (0.02, 0.17)
    latency: float = 0.04
    max_gap: float = 0.2
    scatter: float = 4e-4
    doubt: float = 0.12
    agreement: float = 6e-4
    distance_ratio: float = 1.0

    def __post_init__(self) -> None:
        if not self.distance_ratio > 0 or not self.max_gap > 0:
            raise InputError("expected positive max_gap and distance_ratio", field="camera")


class LineOnSurface:
    """Predicts the line for the camera, and measures the deviation in both directions from its fields.

    Args:
        follower: the surface follower whose map is used and updated; made with ``lateral=True``.
        camera: pose of the camera in the tool frame.
        settings: assumed errors.
        line_span: arc lengths of the reference between which the line is [m].
    """

    def __init__(
        self, follower: SurfaceFollower, camera: pin.SE3, settings: SightSettings, line_span: tuple[float, float]
    ) -> None:
        self.follower, self.settings, self._camera, self._span = follower, settings, camera, line_span
        self._last_seen: tuple[float, float] | None = None
        self._front = -np.inf
        self._candidate: tuple[float, float, Array] | None = None

    @property
    def _sunk(self) -> float:
        """Depth of the undeformed tip below the surface at the wanted force [m]."""
        return self.follower.settings.force / self.follower.settings.elasticity

    def predict(self, t: float) -> LineAhead:
        """The line as predicted for a field exposed at ``t`` [s]."""
        follower = self.follower
        s_now = follower.s_at(t)
        near, far = self.settings.view
        passed = float(follower.speed_at(t)) * (self.settings.latency + 2 * follower.robot.t_ipo)
        first = min(max(near, passed), max(near, far - NARROW))
        s = s_now + np.linspace(first, min(far, first + 0.1), 5)
        step, m = 1e-3, len(s)
        # The map does not cover what the tool has passed: for a late field such places take the values at the tool.
        places = np.maximum(np.concatenate([s, s - step, s + step]), follower.fusion.s)
        d, variance = follower.fusion.deviation(places)
        slope = (d[2 * m :] - d[m : 2 * m]) / (2 * step)
        frames = follower.reference.frames(s)
        height = d[:m, 1] + self._sunk
        tangents = unit(frames.tangent + slope[:, :1] * frames.normal + slope[:, 1:] * frames.up)
        points = frames.position + d[:m, :1] * frames.normal + height[:, None] * frames.up
        return LineAhead(s, points, tangents, frames.up, np.sqrt(variance[:m, 0]))

    def update(self, line: SeenLine, pose: pin.SE3 | None = None) -> Fused | None:
        """Fuses one field, whenever it arrives; None if it showed nothing.

        The TCP's ``pose`` at the exposure is by default interpolated from the observed arm angles.
        """
        if not line.seen:
            return None
        used = np.asarray(line.used, dtype=bool) & np.isfinite(line.points_tcp).all(axis=1)
        if not used.any():
            return None
        measurement = self._measurement(line.t, line.points_tcp[used], line.sigma[used], pose)
        reason = self._implausible(measurement)
        # Places that the tool has passed do not inform about those ahead, and would make the filter go back in time.
        ahead = measurement.s >= self.follower.fusion.s
        if reason or not ahead.any():
            nothing = np.zeros(len(measurement.s), dtype=bool)
            return Fused(nothing, np.zeros(len(nothing)), float("nan"), 0, reason or "behind the tool by now")
        if not ahead.all():
            measurement = self._measurement(line.t, line.points_tcp[used][ahead], line.sigma[used][ahead], pose)
        fused = self.follower.fusion.update(measurement)
        if fused.dof:
            self._last_seen = max(self._last_seen or (-np.inf, 0.0), (line.t, self.follower.s_at(line.t)))
            self._front = max(self._front, float(measurement.s[fused.used].max()))
        return fused

    def _measurement(self, t: float, points_tcp: Array, sigma: Array, pose: pin.SE3 | None = None) -> Measurement:
        follower, settings = self.follower, self.settings
        pose = follower.history.row_pose(t) if pose is None else pose
        eye = pose.act(self._camera.translation)
        axis = self._camera.rotation[:, 2]
        beside = points_tcp - self._camera.translation
        beside -= np.sum(beside * axis, axis=1)[:, None] * axis
        # A wrong distance to the surface scales the seen points about the optical axis.
        lever = (points_tcp + (settings.distance_ratio - 1.0) * beside) @ pose.rotation.T
        beside = beside @ pose.rotation.T
        points = lever + pose.translation
        s, lateral, height = follower.reference.project(points, follower.s_at(t) + SEEN_AHEAD)
        frames = follower.reference.frames(s)
        # Derivatives as in ``LineFollower``: rotation about the camera, displacement of the tool.
        ray = points - eye
        turned, moved, _ = sensor_errors(frames.normal, frames.up, ray, lever, *follower.history.velocity(t))
        g = np.column_stack([np.ones(len(s)), -np.vecdot(ray, frames.normal) / np.vecdot(ray, frames.up)])
        wrong = np.column_stack([turned, moved, np.sum(frames.normal * beside, axis=1)])
        value = g[:, 0] * lateral + g[:, 1] * (height - self._sunk)
        extra = np.zeros(len(s))
        if np.max(np.abs(g[:, 1])) < OBLIQUE:
            # From nearly above a picture hardly shows the height, which is taken from the map with its variance.
            # Otherwise a small lateral contradiction would become a large error of the height, which the force measures
            # better.
            d, variance = follower.fusion.deviation(s)
            value = value - g[:, 1] * d[:, 1]
            extra = g[:, 1] ** 2 * variance[:, 1]
            g = np.column_stack([g[:, 0], np.zeros(len(s))])
        covariance = np.diag(sigma**2 + settings.noise**2 + extra) + settings.common**2
        return Measurement(t, s, value, covariance, g, "camera", wrong, at=follower.s_at(t))

    def _implausible(self, measurement: Measurement) -> str:
        """Why a field cannot be of the line; empty if it can.

        The map ahead has a small variance only where the line was seen. After wrong or missing fields over more than
        the camera's range ahead the variance excludes nothing, so the field itself is tested: its points lie on one
        line, and two fields in a row show the same one.
        """
        settings, s = self.settings, measurement.s
        d = self.follower.fusion.mean(s)
        off = measurement.value - np.sum(measurement.direction * d, axis=1)  # type: ignore[operator]
        trend = np.column_stack([np.ones(len(s)), s - s.mean()])
        fit = np.linalg.lstsq(trend, off, rcond=None)[0]
        if len(s) > 2 and float(np.sqrt(np.mean((off - trend @ fit) ** 2))) > settings.scatter:
            return "points are not on one line"
        before, self._candidate = self._candidate, (measurement.t, float(s.mean()), fit)
        if self._last_seen is not None and measurement.t - self._last_seen[0] <= settings.doubt:
            return ""
        if before is None or measurement.t - before[0] > 2 * settings.doubt:
            return "first field after a while, waiting for another one"
        apart = 0.5 * (float(s.mean()) - before[1])
        earlier, here = before[2] @ [1.0, apart], fit @ [1.0, -apart]
        return "" if abs(earlier - here) < settings.agreement else "does not agree with the field before"

    def check(self, t: float) -> None:
        """Raises ``LineLostError`` if the line has not been seen over too long a distance of the travel."""
        if self.follower.phase is not Phase.TRAVEL:
            return
        s, limit = self.follower.s_at(t - self.settings.latency), self.settings.max_gap
        begin, end = self._span
        if self._last_seen is None:
            if s - begin > limit:
                raise LineNeverSeenError(t, s, limit)
        elif s - max(self._last_seen[1], begin) > limit and self._front < end - 0.03:
            raise LineLostError(t, s, *self._last_seen, limit)
