"""Camera fields made from the distance to a curve, pixel by pixel: shares nothing with the simulated renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from sensing.camera.camera_device import Field, Window
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import PredictedLine

GrayAt = Callable[[Array], Array]
"""Gray values ``(m,)`` of points ``(m, 2)`` [m] in the tool's x and y, on the plane z = 0 through the TCP."""

NORMAL = np.array([0.0, 0.0, -1.0])


def stroke(y: Callable[[Array], Array], slope: Callable[[Array], Array], width: float = 0.003, gray: float = 40.0,
           background: float = 200.0) -> GrayAt:
    """A gentle curve ``y(x)`` with a soft edge of 1 mm; the distance is taken to first order."""

    def at(xy: Array) -> Array:
        d = np.abs(xy[:, 1] - y(xy[:, 0])) / np.hypot(1.0, slope(xy[:, 0]))
        return background + np.clip(0.5 + (width / 2 - d) / 0.001, 0.0, 1.0) * (gray - background)

    return at


# A gentle line, and where it is predicted.

X = np.linspace(0.02, 0.11, 5)


def y(x: Array) -> Array:
    return np.asarray(0.02 * np.sin(12.0 * x + 0.3) - 0.006)


def slope(x: Array) -> Array:
    return np.asarray(0.24 * np.cos(12.0 * x + 0.3))


CLEAN = stroke(y, slope)


def predicted(offset: float = 0.0, turn: float = 0.0, sigma: float = 0.001, x: Array = X) -> PredictedLine:
    """The true line, displaced along y and turned."""
    points = np.column_stack([x, y(x) + offset + turn * (x - 0.065), 0.0 * x])
    tangents = np.column_stack([np.ones_like(x), slope(x) + turn, 0.0 * x])
    return PredictedLine(points, tangents / np.linalg.norm(tangents, axis=1, keepdims=True), NORMAL, sigma)


def make_field(camera: CameraModel, windows: Sequence[Window], gray: GrayAt, rng: np.random.Generator | None = None,
               noise: float = 0.0, samples: int = 6, t: float = 0.0) -> Field:
    """Averages ``samples``² rays over each pixel."""
    patches = []
    inside = (np.arange(samples) + 0.5) / samples - 0.5
    for w in windows:
        u = (w.u + np.arange(w.width))[:, None] + inside
        v = (w.v + np.arange(w.height))[:, None] + inside
        grid = np.stack(np.meshgrid(u.ravel(), v.ravel()), axis=-1).reshape(-1, 2)
        points = camera.on_plane(grid, NORMAL, 0.0) if len(grid) else np.empty((0, 3))
        image = gray(points[:, :2]).reshape(w.height, samples, w.width, samples).mean(axis=(1, 3))
        if rng is not None:
            image = image + noise * rng.standard_normal(image.shape)
        patches.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return Field(t, t, tuple(windows), tuple(patches))


def tool_over(x: float, y: float = 0.0, yaw: float = 0.0, plane: pin.SE3 | None = None) -> pin.SE3:
    """A TCP pose on a plane at its (x, y), looking into it, turned about its normal."""
    down = np.diag([1.0, -1.0, -1.0])
    plane = pin.SE3.Identity() if plane is None else plane
    return plane * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ down, np.array([x, y, 0.0]))


# Whole pictures of a drawn line, with uneven light, a scratch and noise.

def film(path: Path, pictures: Iterable[np.ndarray], rate: float = 30.0) -> Path:
    """Writes gray pictures as an AVI file of JPEGs."""
    pictures = list(pictures)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, pictures[0].shape[::-1])
    for picture in pictures:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def drawn_line(*, dark: bool = True, width: float = 8.0, upright: bool = False, seed: int = 0, noise: float = 4.0,
               size: tuple[int, int] = (640, 480)) -> tuple[NDArray[np.uint8], Callable[[Array], Array]]:
    """A picture and the line's place across as a function of the place along."""
    columns, rows = size
    v, u = np.mgrid[0:rows, 0:columns].astype(float)
    s, across, length, middle = (v, u, rows, columns / 2) if upright else (u, v, columns, rows / 2)
    k = 2.0 * np.pi * 0.8 / length

    def truth(x: Array) -> Array:
        return np.asarray(middle + 55.0 * np.sin(k * x + 0.4))

    distance = np.abs(across - truth(s)) / np.hypot(1.0, 55.0 * k * np.cos(k * s + 0.4))
    background, ink = (180.0, 60.0) if dark else (70.0, 210.0)
    gray = background + (ink - background) * np.clip(0.5 + (width / 2 - distance) / 1.5, 0.0, 1.0)
    gray *= 0.7 + 0.5 * u / columns
    gray += 40.0 * np.clip(1.0 - np.abs(0.6 * (u - 300.0) - (v - 100.0)) / 2.0, 0.0, 1.0)
    gray += noise * np.random.default_rng(seed).standard_normal(gray.shape)
    return np.clip(np.rint(gray), 0, 255).astype(np.uint8), truth
