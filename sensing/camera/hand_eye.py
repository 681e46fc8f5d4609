"""Calibration of the camera on the tool from the drawn line itself, while the arm moves ([L] 4.4).

"Calibration can simply be reached by moving the sensor and comparing the sensor values with the simultaneously measured
actual positions of the TCP." One piece of the line is seen from many tool poses. Its points, projected back with the
right camera, fall on one curve; with a wrong camera, on as many as there are poses. Neither the line's place nor its
shape is assumed: its deviation from the reference path is a cubic B-spline, solved for along the way.

With pixels u_ij of pose i, camera parameters θ and the intersection x_ij(θ) of their rays with the surface,

    min over θ, c of  Σ ((d(x_ij(θ)) - B(s(x_ij(θ))) c) / σ_ij)² + Σ (θ_k / σ_k)²

d and s being lateral distance from and arc length on the reference path: Gauss-Newton over θ and c together, with

    ∂d/∂θ = n · ∂x/∂θ,   ∂s/∂θ = t · ∂x/∂θ

n, t the reference's normal and tangent at the foot of x. The surface's slope is solved for as well, and its bend along
the line where its shape is unknown: they are the same in the base frame at all poses, the camera's errors are the same
in the tool frame. Of a height only the sum is seen, h = h_camera - h_surface: by what was known before, the surface has
the share σ_s² / (σ_s² + σ_c²) of it.

Joints that are not where the arm's description has them are no parameters: gears that give way and rub move the tool by
as much in other patterns, and would be found as joints. They are *considered*: with columns C of what they do to the
residuals and their prior covariance P, the covariance of the estimate A⁻¹ Jᵀ r is that of the noise and
A⁻¹ Jᵀ C P Cᵀ J A⁻¹ (S. F. Schmidt, Application of State-Space Methods to Navigation Problems, 1966).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import BSpline

from ideal_robot.arrays import Array
from sensing import SensingError
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_polynomial import Polyline

TILT, RISE, BEND = "surface_tilt", "surface_rise", "surface_bend"
NO_CAMERA = ("time_offset", TILT, RISE, BEND)
"""What is found beside the camera itself."""
PRIOR = {
    "roll": 0.01,
    "pitch": 0.01,
    "yaw": 0.01,
    "height": 0.003,
    "lateral": 0.002,
    "forward": 0.002,
    "focal": 0.01,
    "principal_u": 2.0,
    "principal_v": 2.0,
    "k1": 0.03,
    "time_offset": 0.003,
    TILT: 0.02,
    RISE: 0.01,
}
"""Standard deviations of a camera mounted by hand: 0.6°, 3 mm, 1 %, 2 px, 3 ms; and of the surface's slope along the
line, 1°, and its height, 10 mm. A turn of the surface about the line is no parameter: it shows nowhere."""
BENT = PRIOR | {BEND: 0.5}
"""The same on a surface of unknown shape: near one place it is bent along the line, by a radius of 2 m [1/m]. A fall of
4 mm over 0.1 m that is taken for even is found as distance, focal length and lens."""


UNCALIBRATED = (3e-4, 5e-4)
"""Standard deviations of the places of an arm's joints [m] and of their turns [rad], in each direction: together they
put the tool of an arm as delivered a millimetre beside where its angles say."""

_SMALL = 1e-5
"""Correction by which a slope is measured [rad, m or none]: far below any that is found."""
_STILL, _NEAR = 1e-3, 3e-2
"""Steps that move no parameter by more than this share of its prior's standard deviation are the last; of a result, and
of what only tells outliers."""


@dataclass(frozen=True)
class Observation:
    """Line points of one field, and the tool pose that the robot measured at the exposure.

    Attributes:
        pose: TCP pose in the base frame at the time stamp, from the motor angles.
        pixels: detected points ``(m, 2)`` [px].
        sigma: their lateral standard deviations ``(m,)`` [m].
        velocity, angular_velocity: of the TCP in the base frame ``(3,)`` [m/s, rad/s]; zero at rest.
        carried: how errors of the joints' places shift the seen points against the places that the tool will reach
            ``(6, 6 n)``: the TCP and its turn in the base frame by each joint's place [m] and turn [rad] on the link
            before it; without columns where the arm is not known.
    """

    pose: pin.SE3
    pixels: Array
    sigma: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    angular_velocity: Array = field(default_factory=lambda: np.zeros(3))
    carried: Array = field(default_factory=lambda: np.zeros((6, 0)))


@dataclass(frozen=True)
class HandEye:
    """Result of a calibration.

    Attributes:
        camera: the calibrated camera.
        time_offset: what has to be added to a time stamp [s].
        parameters, sigma: corrections found and their standard deviations, by name, as in ``PRIOR``.
        covariance: of the parameters, in the order of ``parameters``.
        surface: motion in the base frame that takes the surface from where it was assumed to where it was seen.
        residual_before, residual_after: root mean square distance of the points from one common curve [m].
        used: points used, after outliers were dropped.
    """

    camera: CameraModel
    time_offset: float
    parameters: dict[str, float]
    sigma: dict[str, float]
    covariance: Array
    residual_before: float
    residual_after: float
    used: int
    surface: pin.SE3 = field(default_factory=pin.SE3.Identity)

    def across(self) -> float:
        """Standard deviation, at the tool tip across the travel, of the point in the middle of the view [m]."""
        pixel, names = self.camera.K[:2, 2], list(self.parameters)
        slope = [(_aside(self.camera.perturbed(**{name: _SMALL}), pixel) - _aside(self.camera, pixel)) / _SMALL
                 if name not in NO_CAMERA else 0.0 for name in names]
        return float(np.sqrt(np.array(slope) @ self.covariance @ slope))


def _aside(camera: CameraModel, pixel: Array) -> float:
    """How far aside in the tool frame the ray of a pixel ``(2,)`` meets the plane through the tip [m]."""
    place, ray = camera.T_tool_camera.translation, camera.T_tool_camera.rotation @ camera.rays(pixel[None])[0]
    return float(place[1] - place[2] / ray[2] * ray[1])


def calibration_poses(
    centre: Array, tangent: Array, normal: Array, ahead: float
) -> list[pin.SE3]:
    """Tool poses from which one piece of the line determines all mounting parameters of the camera.

    The tool turns about its approach axis by nearly ±90°, which turns every constant error of the camera against the
    line; it moves along, which separates a turned camera from a turned line; sideways and up, which shows scale and
    focal length. No turn is a multiple of 45°: a line along pixel rows or diagonals has the same sub-pixel error in
    all its points.

    Args:
        centre: a point on the line as far as known ``(3,)`` [m].
        tangent: direction of the line there ``(3,)``.
        normal: of the surface there, towards the camera ``(3,)``.
        ahead: how far ahead of the TCP the camera looks [m].
    """
    poses, move, lift = [], 0.04, 0.045
    z = -np.asarray(normal, dtype=float)
    x = np.asarray(tangent, dtype=float)
    turn_0 = np.column_stack([x, np.cross(z, x), z])
    # Lifted poses come first, then low ones, as that way is the shortest. Turns that only rise would be shorter still
    # but less accurate, as the gears' friction then always acts in one direction.
    for turn in np.radians([3.0, -39.0, -84.0, 84.0, 39.0]):
        for along, aside, up in ((0.0, -move, lift), (move, 0.0, lift), (-move, 0.0, 0.0), (0.0, move, 0.0)):
            R = turn_0 @ pin.rpy.rpyToMatrix(0.0, 0.0, float(turn))
            look = centre + along * turn_0[:, 0] + aside * turn_0[:, 1] - up * z
            poses.append(pin.SE3(R, look - ahead * R[:, 0]))
    return poses


def calibrate(
    camera: CameraModel,
    observations: Sequence[Observation],
    reference: Array,
    normal: Array,
    prior: Mapping[str, float] = PRIOR,
    knot: float = 0.015,
) -> HandEye:
    """Estimates the camera's calibration errors from observations of one segment of the line.

    Raises ``SensingError`` for too few points.

    Args:
        camera: the camera as it is believed.
        observations: fields from different poses; at least three with three points.
        reference: polyline near the line ``(N, 3)`` [m] in the base frame, in the surface.
        normal: unit normal of the surface ``(3,)``.
        prior: standard deviations of the parameters; those missing are not estimated.
        knot: spacing of the spline of the line's deviation from the reference [m].
    """
    names = [name for name in prior if name != RISE]
    rise = prior.get(RISE, 0.0)
    scale = np.array([np.hypot(prior[name], rise) if name == "height" else prior[name] for name in names])
    problem = _Problem(camera, observations, Polyline(reference), np.asarray(normal, dtype=float), names, knot)
    if len(observations) < 3 or problem.count < len(names) + 10:
        raise SensingError(f"{problem.count} line points from {len(observations)} poses are too few for a calibration")
    before = problem.solve(np.zeros(len(names)), scale, steps=0)
    # Solved twice: the second time without the points that contradict the first result.
    first = problem.solve(np.zeros(len(names)), scale, still=_NEAR)
    problem.drop_outliers(first.residual)
    fit = problem.solve(first.values, scale)
    estimate, covariance = fit.values, fit.covariance
    if rise:
        estimate, covariance = _shared(estimate, covariance, names.index("height"), prior["height"] ** 2, rise**2)
        names.append(RISE)
    sigma = np.sqrt(np.diag(covariance))
    values = dict(zip(names, (float(v) for v in estimate), strict=True))
    corrected = camera.perturbed(**{name: value for name, value in values.items()
                                    if name not in NO_CAMERA})
    return HandEye(
        corrected, values.get("time_offset", 0.0), values, dict(zip(names, (float(v) for v in sigma), strict=True)),
        covariance, before.rms, fit.rms, problem.count, problem.surface(values),
    )  # fmt: skip


def _shared(values: Array, covariance: Array, height: int, of_camera: float, of_surface: float
            ) -> tuple[Array, Array]:
    """Parameters and covariance with an estimated height divided between camera and surface by prior variances.

    The surface's is the last of the parameters returned ``(k + 1,)``; ``height`` is the place of the camera's.
    """
    k, share = len(values), of_surface / (of_camera + of_surface)
    parts, together = np.eye(k + 1, k), np.zeros(k + 1)
    parts[[height, k], height], together[[height, k]] = (1.0 - share, -share), 1.0
    # A common rise of camera and surface changes no picture, so its variance stays that of the prior.
    return parts @ values, parts @ covariance @ parts.T + share * of_camera * np.outer(together, together)


@dataclass(frozen=True)
class _Fit:
    """Parameters, their covariance, residuals in units of sigma ``(count,)`` and their root mean square [m]."""

    values: Array
    covariance: Array
    residual: Array
    rms: float


class _Met(NamedTuple):
    """Where rays meet the surface.

    Attributes:
        points: ``(M, 3)`` [m].
        ray: along each, as long as rises by one along the surface's normal ``(M, 3)``.
        normal: of the surface ``(3,)``.
    """

    points: Array
    ray: Array
    normal: Array


class _Problem:
    """Residuals of the points against one common curve, as a function of the camera's parameters."""

    def __init__(
        self, camera: CameraModel, observations: Sequence[Observation], reference: Polyline, normal: Array,
        names: list[str], knot: float,
    ) -> None:  # fmt: skip
        self.camera, self.reference, self.normal, self.names = camera, reference, normal, names
        usable = [np.isfinite(o.pixels).all(axis=1) & np.isfinite(o.sigma) for o in observations]
        masked = list(zip(observations, usable, strict=True))
        self.pixels = np.concatenate([np.empty((0, 2)), *(o.pixels[f] for o, f in masked)])
        self.sigma = np.concatenate([np.empty(0), *(o.sigma[f] for o, f in masked)])
        self.rotation = np.array([o.pose.rotation for o in observations]).reshape(-1, 3, 3)
        self.position = np.array([o.pose.translation for o in observations]).reshape(-1, 3)
        self.velocity = np.array([o.velocity for o in observations]).reshape(-1, 3)
        turning = np.array([pin.skew(o.angular_velocity) for o in observations]).reshape(-1, 3, 3)
        self.rotation_rate = turning @ self.rotation
        self.carried = np.array([o.carried for o in observations]) if observations else np.zeros((0, 6, 0))
        self.owner = np.repeat(np.arange(len(usable)), [int(f.sum()) for f in usable])
        self._lens, self._rays = b"", np.empty((0, 3))
        self.centre = reference.points.mean(axis=0)
        along = reference.points[-1] - reference.points[0]
        along = along - along @ normal * normal
        self.along = along / np.linalg.norm(along)
        self.axis = np.cross(normal, self.along)
        self.good = np.ones(len(self.pixels), dtype=bool)
        if self.count:
            s = self.reference.nearest(self._on_surface(np.zeros(len(names))).points, self.normal).s
            low, high = s.min() - 0.5 * knot, s.max() + 0.5 * knot
            inner = np.linspace(low, high, max(int((high - low) / knot), 2) + 1)
            self.knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])

    @property
    def count(self) -> int:
        return int(self.good.sum())

    def surface(self, values: Mapping[str, float]) -> pin.SE3:
        """How the surface is moved in the base frame: a turn about the line's middle, and along its normal."""
        # With a positive tilt the surface rises along the line.
        R = pin.exp3(-values.get(TILT, 0.0) * self.axis)
        return pin.SE3(R, self.centre - R @ self.centre + values.get(RISE, 0.0) * self.normal)

    def _rays_of(self, camera: CameraModel) -> Array:
        """Rays of all points in the camera's frame ``(M, 3)``: most corrections leave lens and picture as they are."""
        lens = camera.K.tobytes() + camera.distortion.tobytes()
        if lens != self._lens:
            self._lens, self._rays = lens, camera.rays(self.pixels)
        return self._rays

    def _on_surface(self, values: Array) -> _Met:
        """Where the rays of all points meet the surface, with the parameters' corrections."""
        corrections = dict(zip(self.names, values, strict=True))
        delay, bend = corrections.pop("time_offset", 0.0), corrections.pop(BEND, 0.0)
        moved = self.surface(corrections)
        normal, centre = moved.rotation @ self.normal, moved.act(self.centre)
        camera = self.camera.perturbed(**{name: value for name, value in corrections.items() if name != TILT})
        T = camera.T_tool_camera
        directions = self._rays_of(camera) @ T.rotation.T
        # To first order in the delay: milliseconds at a few rad/s.
        late, own = delay + camera.row_delay(self.pixels), self.owner
        rotation = self.rotation[own] + late[:, None, None] * self.rotation_rate[own]
        ray = np.einsum("ijk,ik->ij", rotation, directions)
        origin = self.position[own] + late[:, None] * self.velocity[own] + rotation @ T.translation
        meets, along = ray @ normal, moved.rotation @ self.along
        plane = depth = (centre - origin) @ normal / meets
        for _ in range(3 if bend else 0):
            distance = (origin + depth[:, None] * ray - centre) @ along
            depth = plane + 0.5 * bend * distance**2 / meets
        return _Met(origin + depth[:, None] * ray, ray / meets[:, None], normal)

    def _carried(self, met: _Met) -> Array:
        """How joints that are not as drawn move the points on the surface ``(M, 3, k)`` [m], to first order."""
        places, turns = self.carried[self.owner, :3], self.carried[self.owner, 3:]
        moved = places + np.cross(turns, (met.points - self.position[self.owner])[:, :, None], axis=1)
        return np.asarray(moved - met.ray[:, :, None] * np.einsum("j,ijk->ik", met.normal, moved)[:, None])

    def solve(self, values: Array, scale: Array, steps: int = 6, still: float = _STILL) -> _Fit:
        """Gauss-Newton steps from ``values (k,)`` until none moves a parameter by more than ``still`` of its ``scale``.

        With no steps only the common curve is fitted and nothing is said of the covariance.
        """
        n, moves = len(values), np.inf
        for step in range(steps + 1):
            met = self._on_surface(values)
            x = met.points
            nearest = self.reference.nearest(x, self.normal)
            tangent = self.reference.at(nearest.s)[1]
            left = np.cross(self.normal, tangent)
            weight = self.good / self.sigma
            inside = np.clip(nearest.s, self.knots[0] + 1e-9, self.knots[-1] - 1e-9)
            B = weight[:, None] * BSpline.design_matrix(inside, self.knots, 3).toarray()
            d = nearest.lateral * weight
            # A weak prior of 30 mm keeps spline pieces that no point touches harmless.
            c = np.linalg.solve(B.T @ B + np.eye(B.shape[1]) / 0.03**2, B.T @ d)
            residual = d - B @ c
            used = residual[self.good]
            rms = float(np.sqrt(np.mean((used * self.sigma[self.good]) ** 2)))
            if not steps:
                return _Fit(values, np.full((n, n), np.inf), used, rms)
            slope = BSpline(self.knots, c, 3)(inside, 1)
            J = np.empty((len(x), n + B.shape[1]))
            J[:, n:] = -B
            across = weight[:, None] * (left - slope[:, None] * tangent)
            for k in range(n):
                moved = values.copy()
                moved[k] += 1e-3 * scale[k]
                J[:, k] = np.einsum("ij,ij->i", across, self._on_surface(moved).points - x) / 1e-3
            A = J.T @ J + np.diag(np.concatenate([np.ones(n), np.full(B.shape[1], 1.0 / 0.03**2)]))
            if step == steps or moves < still:
                break
            gradient = J.T @ residual
            gradient[:n] += values / scale
            gradient[n:] += c / 0.03**2
            change = np.linalg.solve(A, gradient)[:n]
            values, moves = values - scale * change, float(np.max(np.abs(change)))
        spread = max(1.0, float(np.sqrt(np.mean(used**2))))
        drawn = np.tile(np.repeat(UNCALIBRATED, 3), self.carried.shape[2] // 6)
        considered = np.linalg.solve(A, J.T @ (np.einsum("ij,ijk->ik", across, self._carried(met)) * drawn))[:n]
        covariance = np.linalg.inv(A)[:n, :n] * spread**2 + considered @ considered.T
        covariance *= np.outer(scale, scale)
        return _Fit(values, covariance, used, rms)

    def drop_outliers(self, residual: Array) -> None:
        r = np.abs(residual)
        limit = 5.0 * max(1.0, 1.4826 * float(np.median(r)))
        self.good[np.flatnonzero(self.good)[r > limit]] = False
