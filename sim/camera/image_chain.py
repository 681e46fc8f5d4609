"""Picture and time stamp of a simulated camera: its settings, and the effects of lens, sensor and compression."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.camera.camera_device import Gray, Window


@dataclass(frozen=True)
class CameraSettings:
    """Settings of the camera's picture and time stamps.

    Attributes:
        rate: fields per second [Hz].
        phase: time of the first mid-exposure [s].
        exposure: exposure time [s]; motion blur comes from ``sub_exposures`` pictures along the true pose.
        sub_exposures: pictures averaged over one exposure, each displaced by a fraction of a sample.
        supersampling: samples per pixel and axis in each of them.
        noise: standard deviation of gray noise, the same at all levels; of a sensor that has one, before its mosaic.
        full_well: electrons of a pixel that is just white; their number is Poisson's. 0 for no noise of the light.
        mosaic: whether pixels lie behind red, green and blue filters (RGGB) and the gray value is made of neighbours.
        defocus_px: radius of the disc that a point becomes in the picture [px].
        vignetting: share of the light that the lens loses in the picture's corners.
        jpeg_quality: 1 to 100 of the file's compression; 0 for none.
        latency, jitter: from mid-exposure to the data's arrival, and its standard deviation [s].
        stamp_offset: constant error of the time stamp [s].
        stamp_drift: by how much the clock of the time stamps runs fast [s/s].
        stamp_noise: standard deviation of the time stamp [s].
        loss, doubled: probabilities that a field is lost, and that it arrives twice.
        rolling: time from the first row's exposure to the last row's [s]; 0 where all rows are exposed together. Fields
            are timed by their middle row.
        auto_exposure: time constant with which the exposure follows the light [s]; 0 for a fixed one.
        resolution: texel of the drawn surface [m].
    """

    rate: float = 50.0
    phase: float = 0.005
    exposure: float = 0.002
    sub_exposures: int = 3
    supersampling: int = 2
    noise: float = 3.0
    full_well: float = 0.0
    mosaic: bool = False
    defocus_px: float = 0.0
    vignetting: float = 0.0
    jpeg_quality: int = 0
    latency: float = 0.040
    jitter: float = 0.001
    stamp_offset: float = 0.0
    stamp_drift: float = 0.0
    stamp_noise: float = 0.00005
    loss: float = 0.0
    doubled: float = 0.0
    rolling: float = 0.0
    auto_exposure: float = 0.0
    resolution: float = 0.00025

    @classmethod
    def of(cls, table: Any) -> CameraSettings:
        """Settings from the camera's table of a scene file, which has keys of the same names."""
        same = {f.name: getattr(table, f.name) for f in fields(cls) if f.name not in ("phase", "rolling")}
        return cls(**same, rolling=1e-3 * table.rolling_ms)

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not math.isfinite(value):
                raise InputError("must be finite", field=f"camera.{f.name}", value=value)
            if f.name not in ("phase", "stamp_offset", "stamp_drift") and value < 0:
                raise InputError("must not be negative", field=f"camera.{f.name}", value=value)
        for name in ("rate", "sub_exposures", "supersampling", "resolution"):
            if getattr(self, name) <= 0:
                raise InputError("must be positive", field=f"camera.{name}", value=getattr(self, name))
        if self.exposure * self.rate > 1.0:
            raise InputError("the exposure cannot be longer than the time between two fields", field="camera.exposure",
                             value=self.exposure)
        if self.rolling * self.rate > 1.0:
            raise InputError("the rows cannot be read out more slowly than fields come", field="camera.rolling_ms",
                             value=1e3 * self.rolling)
        if self.jpeg_quality > 100:
            raise InputError("expected a quality of up to 100", field="camera.jpeg_quality", value=self.jpeg_quality)
        for name in ("loss", "doubled", "vignetting"):
            if getattr(self, name) >= 1.0:
                raise InputError("expected a share below 1", field=f"camera.{name}", value=getattr(self, name))


# From light to gray values: defocus, vignetting, noise, mosaic, compression.

Light = NDArray[Any]
"""Of pixels, in gray values; single or double precision."""
WHITE = 255.0  # eight bits
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
    """Turns light into gray values, of a whole picture or of windows; a window has the same pixels either way.

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
        """The window whose light the gray values of ``window`` depend on: whole blocks; empty for an empty window."""
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
        """Gray values ``(height, width)`` of a window, from the light that falls on it.

        Args:
            light: light that reaches the pixels of a window ``(height, width)`` [gray]; it is overwritten.
            window: the window's place in the picture, as ``around`` returns it.
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
    """Image of a point that is out of focus by ``radius`` [px]: the share of its light in each pixel; sum 1."""
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
    """The part ``(height, width)`` of a larger window's gray values that belongs to a window; a view.

    Args:
        gray: of the larger one.
        of: the larger one.
        window: inside it.
    """
    v, u = window.v - of.v, window.u - of.u
    return gray[v : v + window.height, u : u + window.width]
