"""A calibrated camera: intrinsics, lens distortion and its pose on the tool.

The model is OpenCV's: a point (X, Y, Z) in the camera frame (x right, y down, z along the optical axis) becomes

    x = X/Z, y = Y/Z, r² = x² + y²
    x_d = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y_d = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y
    u = f_x x_d + c_x, v = f_y y_d + c_y

with pixel centres at integer coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit


@jit()
def distort(x: float, y: float, k: Array) -> tuple[float, float]:
    """Distorts one normalised image point; ``k`` is (k1, k2, p1, p2, k3).

    Args:
        x: normalised image coordinate to the right, 1.
        y: the same downwards, 1.
        k: distortion k1, k2, p1, p2, k3 ``(5,)``.
    """
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@jit()
def undistort(x_d: float, y_d: float, k: Array) -> tuple[float, float]:
    """Inverts ``distort`` by Newton's method; NaN where the lens model has no inverse.

    Args:
        x_d: distorted normalised coordinate to the right, 1.
        y_d: the same downwards, 1.
        k: distortion k1, k2, p1, p2, k3 ``(5,)``.

    >>> k = np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0])
    >>> [round(value, 9) for value in undistort(*distort(0.3, -0.2, k), k)]
    [0.3, -0.2]
    """
    x, y = x_d, y_d
    for _ in range(20):
        fx, fy = distort(x, y, k)
        ex, ey = fx - x_d, fy - y_d
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4]))
        a = radial + slope * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x
        b = slope * x * y + 2.0 * k[2] * x + 2.0 * k[3] * y
        d = radial + slope * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x
        det = a * d - b * b
        if det <= 1e-6 or a <= 0.0:
            return np.nan, np.nan
        x -= (d * ex - b * ey) / det
        y -= (a * ey - b * ex) / det
        if ex * ex + ey * ey < 1e-26:
            return x, y
    return np.nan, np.nan


@jit()
def _project_points(points: Array, K: Array, k: Array) -> Array:
    """Pixels ``(m, 2)`` of points ``(m, 3)`` [m] in the camera frame; NaN behind the camera.

    >>> K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    >>> _project_points(np.array([[0.0, 0.0, 0.5], [0.01, 0.0, 0.5], [0.0, 0.0, -0.5]]), K, np.zeros(5))
    array([[320., 240.],
           [330., 240.],
           [ nan,  nan]])
    """
    pixels = np.full((points.shape[0], 2), np.nan)
    for i in range(points.shape[0]):
        if points[i, 2] > 0.0:
            x, y = distort(points[i, 0] / points[i, 2], points[i, 1] / points[i, 2], k)
            pixels[i, 0] = K[0, 0] * x + K[0, 1] * y + K[0, 2]
            pixels[i, 1] = K[1, 1] * y + K[1, 2]
    return pixels


@jit()
def pixel_rays(pixels: Array, K: Array, k: Array) -> Array:
    """Rays ``(m, 3)`` in the camera frame, scaled to z = 1, of pixels ``(m, 2)``.

    Args:
        pixels: ``(m, 2)`` [px].
        K: camera matrix ``(3, 3)`` [px].
        k: distortion k1, k2, p1, p2, k3 ``(5,)``.
    """
    rays = np.empty((pixels.shape[0], 3))
    for i in range(pixels.shape[0]):
        y_d = (pixels[i, 1] - K[1, 2]) / K[1, 1]
        x_d = (pixels[i, 0] - K[0, 2] - K[0, 1] * y_d) / K[0, 0]
        rays[i, 0], rays[i, 1] = undistort(x_d, y_d, k)
        rays[i, 2] = 1.0
    return rays


def default_mount(height: float = 0.25, ahead: float = 0.065) -> pin.SE3:
    """Camera pose in the tool frame: ``height`` above the TCP and ``ahead`` of it [m], looking down along the tool's z.

    The tool's x points along the path and its z into the surface. In the image, forward is up and the tool's y
    is right, so a line along the path stands upright and five rows across the field cut it five times.
    """
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return pin.SE3(rotation, np.array([ahead, 0.0, -height]))


@dataclass(frozen=True)
class CalibrationError:
    """Sizes of the errors between a camera and its calibration; angles about the tool's axes.

    Attributes:
        roll, pitch, yaw: rotation of the camera about the tool's x (along the path), y and z [rad].
        height: camera too far from the surface [m].
        lateral: camera displaced along the tool's y [m].
        focal: relative error of the focal length.
        principal_point: error of both coordinates of the principal point [px].
        distortion: error of the radial coefficient k1.
    """

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    height: float = 0.0
    lateral: float = 0.0
    focal: float = 0.0
    principal_point: float = 0.0
    distortion: float = 0.0

    def signed(self, rng: np.random.Generator) -> dict[str, float]:
        """The same sizes with random signs, as arguments of ``CameraModel.perturbed``."""
        names = ("roll", "pitch", "yaw", "height", "lateral", "focal", "principal_u", "principal_v", "k1")
        sizes = np.array([self.roll, self.pitch, self.yaw, self.height, self.lateral, self.focal, self.principal_point,
                          self.principal_point, self.distortion])
        return dict(zip(names, rng.choice([-1.0, 1.0], size=9) * sizes, strict=True))


@dataclass(frozen=True)
class CameraModel:
    """Pinhole camera with OpenCV's lens distortion, mounted on the tool.

    Attributes:
        width, height: image size [px].
        K: camera matrix ``(3, 3)`` [px].
        distortion: (k1, k2, p1, p2, k3), shape ``(5,)``.
        T_tool_camera: pose of the camera frame in the tool frame.
        readout: time from the first row's exposure to the last row's [s]; 0 where all rows are exposed together. The
            time of a picture is its middle row's.
    """

    width: int
    height: int
    K: Array
    distortion: Array
    T_tool_camera: pin.SE3 = field(compare=False)
    readout: float = 0.0

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=float)
        distortion = np.array(self.distortion, dtype=float)
        if self.width < 1 or self.height < 1:
            raise InputError("the image needs at least one pixel", field="camera.width, camera.height",
                             value=(self.width, self.height))
        if K.shape != (3, 3) or not np.all(np.isfinite(K)) or K[0, 0] <= 0.0 or K[1, 1] <= 0.0:
            raise InputError("expected a 3×3 camera matrix with positive focal lengths", field="camera.K")
        if distortion.shape != (5,) or not np.all(np.isfinite(distortion)):
            raise InputError("expected five coefficients k1, k2, p1, p2, k3", field="camera.distortion")
        if not 0.0 <= self.readout < 1.0:
            raise InputError("expected a time from 0 up to a second", field="camera.readout", value=self.readout)
        K.setflags(write=False)
        distortion.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "distortion", distortion)

    def __reduce__(self) -> tuple[type[CameraModel], tuple[Any, ...]]:
        """Restores it with read-only arrays in another process: numba would compile anew for writable ones."""
        return type(self), tuple(getattr(self, entry.name) for entry in fields(self))

    @property
    def axis_on_surface(self) -> Array:
        """Point ``(3,)`` [m] where the optical axis meets the tool frame's x-y plane, the assumed surface."""
        mount = self.T_tool_camera
        distance = -mount.translation[2] / mount.rotation[2, 2]
        return np.asarray(mount.translation + distance * mount.rotation[:, 2])

    @classmethod
    def default(
        cls,
        width: int = 320,
        height: int = 240,
        focal: float | None = None,
        distortion: tuple[float, ...] = (-0.2, 0.05, 0.0, 0.0, 0.0),
        mount: pin.SE3 | None = None,
    ) -> CameraModel:
        """A camera with 0.83 mm a pixel at 320×240 from 0.25 m; ``focal`` [px] defaults to 300 per 320 columns.

        Args:
            width: columns of the image [px].
            height: rows of the image [px].
            focal: focal length [px]; 300 per 320 columns if None.
            distortion: k1, k2, p1, p2, k3.
            mount: pose of the camera in the tool frame; ``default_mount()`` if None.
        """
        f = 300.0 * width / 320.0 if focal is None else focal
        K = np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])
        return cls(width, height, K, np.array(distortion), default_mount() if mount is None else mount)

    def row_delay(self, pixels: Array) -> Array:
        """How much later than the picture's middle row the rows of pixels ``(m, 2)`` are exposed ``(m,)`` [s].

        Pixels beyond the image have the delay of its edge, pixels that are NaN have none.
        """
        rows = np.nan_to_num(np.asarray(pixels, dtype=float)[:, 1], nan=0.5 * (self.height - 1))
        return self.readout * (np.clip(rows / max(self.height - 1, 1), 0.0, 1.0) - 0.5)

    def project(self, points: Array) -> Array:
        """Pixels ``(m, 2)`` of points ``(m, 3)`` [m] given in the camera frame; NaN behind the camera."""
        return _project_points(np.ascontiguousarray(points, dtype=float), self.K, self.distortion)

    def rays(self, pixels: Array) -> Array:
        """Undistorted rays ``(m, 3)`` with z = 1 in the camera frame of pixels ``(m, 2)``.

        NaN where the lens model cannot be inverted, which is far outside the image of a sensible lens.
        """
        return pixel_rays(np.ascontiguousarray(pixels, dtype=float), self.K, self.distortion)

    def project_tool(self, points: Array) -> Array:
        """Pixels ``(m, 2)`` of points ``(m, 3)`` [m] given in the tool frame."""
        T = self.T_tool_camera
        return self.project((np.asarray(points, dtype=float) - T.translation) @ T.rotation)

    def on_plane(self, pixels: Array, normal: Array, offset: float) -> Array:
        """Points ``(m, 3)`` [m] in the tool frame where the pixels' rays meet the plane ``normal · x = offset``.

        Args:
            pixels: ``(m, 2)`` [px].
            normal: unit normal of the plane in the tool frame ``(3,)``.
            offset: distance of the plane from the tool frame's origin along the normal [m].
        """
        T = self.T_tool_camera
        directions = self.rays(pixels) @ T.rotation.T
        depth = (offset - normal @ T.translation) / (directions @ normal)
        return T.translation + depth[:, None] * directions

    def perturbed(
        self,
        roll: float = 0.0,
        pitch: float = 0.0,
        yaw: float = 0.0,
        height: float = 0.0,
        lateral: float = 0.0,
        forward: float = 0.0,
        focal: float = 0.0,
        principal_u: float = 0.0,
        principal_v: float = 0.0,
        k1: float = 0.0,
    ) -> CameraModel:
        """This camera with errors of calibration.

        Args:
            roll: component along the tool's x of the rotation vector about the camera's centre [rad].
            pitch: along the tool's y [rad].
            yaw: along the tool's z [rad].
            height: displacement of the camera against the tool's z [m].
            lateral: along the tool's y [m].
            forward: along the tool's x [m].
            focal: relative change of both focal lengths.
            principal_u: shift of the principal point to the right [px].
            principal_v: downwards [px].
            k1: change of the radial coefficient.
        """
        T = self.T_tool_camera
        mount = pin.SE3(
            pin.exp3(np.array([roll, pitch, yaw])) @ T.rotation, T.translation + np.array([forward, lateral, -height])
        )
        K = self.K.copy()
        K[0, 0] *= 1.0 + focal
        K[1, 1] *= 1.0 + focal
        K[0, 2] += principal_u
        K[1, 2] += principal_v
        distortion = self.distortion.copy()
        distortion[0] += k1
        return replace(self, K=K, distortion=distortion, T_tool_camera=mount)
