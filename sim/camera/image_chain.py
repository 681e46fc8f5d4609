"""What lens, sensor and file make of the light of a picture: defocus, vignetting, noise, mosaic, compression."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from sensing.camera.camera_device import Gray, Window
from sim.camera.settings import CameraSettings

Light = NDArray[Any]
"""Of pixels, in gray values; single or double precision."""
WHITE = 255.0
BALANCE = {"red": 1.9, "green": 1.0, "blue": 1.6}
"""By how much less light a silicon sensor gets behind its red and blue filters than behind the green ones: the factors
of daylight that raw files of cameras note. *Assumed*."""
DEEP = 256
"""Levels of the raw picture in a gray value."""
BLOCK = 8
"""Pixels of a JPEG block."""
FINER = 16
"""Places in a pixel, each way, of which is asked whether a disc covers them."""
NEIGHBOURS = 2
"""Pixels on each side from which a mosaic's gray value is made."""


class ImageChain:
    """From light to gray values, for a whole picture or for windows of it: the pixels of a window are the same in both.

    Args:
        width, height: of the picture [px].
        settings: of the camera.
    """

    def __init__(self, width: int, height: int, settings: CameraSettings) -> None:
        self._size, self._settings = (width, height), settings
        self._disc = disc(settings.defocus_px) if settings.defocus_px > 0.0 else None
        self._reach = (0 if self._disc is None else len(self._disc) // 2) + NEIGHBOURS * settings.mosaic
        self._step = BLOCK if settings.jpeg_quality else 2 if settings.mosaic else 1

    def around(self, window: Window) -> Window:
        """The pixels whose light the gray values of a window depend on: whole blocks; an empty window needs none."""
        if not window.width * window.height:
            return window
        sides = []
        for first, count, size in zip(window[:2], window[2:], self._size, strict=True):
            begin, end = first // self._step, -((first + count) // -self._step)
            more = -(self._reach // -self._step)
            sides.append((max(0, (begin - more) * self._step), min(size, (end + more) * self._step)))
        (u0, u1), (v0, v1) = sides
        return Window(u0, v0, u1 - u0, v1 - v0)

    def developed(self, light: Light, window: Window, rng: np.random.Generator | None) -> Gray:
        """Gray values ``(height, width)``.

        Args:
            light: that reaches the pixels of a window ``(height, width)`` [gray], is overwritten.
            window: where in the picture; as from ``around``.
            rng: draws the noise; None for none.
        """
        s = self._settings
        if not light.size:
            return light.astype(np.uint8)
        if self._disc is not None:
            light = np.asarray(cv2.filter2D(light, -1, self._disc, borderType=cv2.BORDER_REPLICATE))
        if s.vignetting > 0.0:
            light *= self._brightness(window)
        light = self._read(light, window, rng)
        gray = np.clip(np.rint(light, out=light), 0, WHITE, out=light).astype(np.uint8)
        if s.jpeg_quality:
            file = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, s.jpeg_quality])[1]
            gray = np.asarray(cv2.imdecode(file, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        return gray

    def _brightness(self, window: Window) -> Array:
        """Share of the light that the lens lets through ``(height, width)``: 1 - v r²/R², R to the corner."""
        middle = 0.5 * (np.array(self._size) - 1.0)
        x, y = (first + np.arange(count) - at for first, count, at in zip(window[:2], window[2:], middle, strict=True))
        return np.asarray(1.0 - self._settings.vignetting * (x[None, :] ** 2 + y[:, None] ** 2) / (middle @ middle))

    def _read(self, light: Light, window: Window, rng: np.random.Generator | None) -> Light:
        """What the sensor says: variance of the read-out and, as Poisson's law has it, in proportion to the light.

        σ² = noise² + 255 gray / full_well, of each pixel behind its own filter (EMVA 1288, section 2).
        """
        s = self._settings
        if not s.mosaic:
            return self._noisy(light, rng)
        gain = _gains(window)
        raw = np.clip(self._noisy(light / gain, rng) * gain, 0.0, WHITE)
        deep = np.rint(DEEP * raw).astype(np.uint16)
        # OpenCV names the pattern after the second row's second and third pixel.
        return np.asarray(cv2.cvtColor(cv2.cvtColor(deep, cv2.COLOR_BayerBG2BGR), cv2.COLOR_BGR2GRAY) / DEEP)

    def _noisy(self, light: Light, rng: np.random.Generator | None) -> Light:
        s = self._settings
        if rng is None or s.noise == s.full_well == 0.0:
            return light
        sigma: float | Light = s.noise
        if s.full_well > 0.0:
            sigma = np.sqrt(s.noise**2 + np.maximum(light, 0.0) * (WHITE / s.full_well))
        return np.asarray(light + sigma * rng.standard_normal(light.shape, dtype=light.dtype.type))


def disc(radius: float) -> NDArray[np.float64]:
    """What becomes of a point out of focus: the share of an even disc's light in each pixel; sum 1.

    Args:
        radius: of the disc [px].
    """
    reach = int(np.ceil(radius + 0.5))
    count = 2 * reach + 1
    x = (np.arange(FINER * count) + 0.5) / FINER - 0.5 * count
    inside = np.hypot(x[None, :], x[:, None]) <= radius
    share = inside.reshape(count, FINER, count, FINER).sum(axis=(1, 3))
    return np.asarray(share / share.sum())


def _gains(window: Window) -> Array:
    """White balance of the pixels of a window ``(height, width)``, its first pixel red: one that ``around`` gave."""
    cell = np.array([[BALANCE["red"], BALANCE["green"]], [BALANCE["green"], BALANCE["blue"]]])
    return np.tile(cell, (-(window.height // -2), -(window.width // -2)))[: window.height, : window.width]


def cut(gray: Gray, of: Window, window: Window) -> Gray:
    """A window's part ``(height, width)`` of a larger one's gray values; a view.

    Args:
        gray: of the larger one.
        of: the larger one.
        window: inside it.
    """
    v, u = window.v - of.v, window.u - of.u
    return gray[v : v + window.height, u : u + window.width]
