"""The camera on the arm, looking at a drawn plane from the arm's true poses.

Each pixel is the mean of a few samples of the surface, taken where their rays, bent by the lens, meet it; and only
pixels of the search windows are computed. Exposure, gray noise, time stamp, latency and lost fields follow the
settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache
from types import TracebackType

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.row_log import RowLog
from sensing.camera.camera_device import Field, Gray, Window
from sensing.camera.camera_model import CameraModel
from sim.camera.image_chain import CameraSettings, ImageChain, cut
from sim.camera.lamp import Lamp, covered, light, mirrored
from sim.camera.sampling import on_plane, sample_plane, sample_rays, texel_map
from sim.camera.surface import DrawnLine, Texture, paint

__all__ = ["CameraSettings", "PoseAt", "RenderedCamera"]

PoseAt = Callable[[float], pin.SE3]
"""True TCP pose in the base frame at a time [s]."""

FINE = 160_000
"""Pixels from which on a whole image gets one sample a pixel."""
TOGETHER = 3
"""Rows that count as exposed together where the readout is rolling: a search window across an upright line."""


class RenderedCamera:
    """Renders fields of the drawn surface; of the arm it uses only the true TCP pose.

    Args:
        model: the true camera.
        surface: the drawn surface.
        settings: exposure, noise, timing.
        rng: seeds the camera's noise. Every field has a random stream of its own, so it does not depend on earlier
            fields.
        texture: painted surface; made from ``surface`` if not given, and kept as ``texture`` for another camera on it.
        lamp: lights the surface; None for light from everywhere.

    Raises:
        InputError: the surface is too large for its resolution, or the lens cannot be inverted within the image.
    """

    shows_arm = False
    """Whether the arm's links are in the picture."""

    def __init__(
        self,
        model: CameraModel,
        surface: DrawnLine,
        settings: CameraSettings,
        rng: np.random.Generator,
        texture: Texture | None = None,
        lamp: Lamp | None = None,
    ) -> None:
        self.model, self.surface, self.settings = model, surface, settings
        edge_u, edge_v = np.linspace(0, model.width - 1, 9), np.linspace(0, model.height - 1, 9)
        border = np.stack(np.meshgrid(edge_u, edge_v), axis=-1).reshape(-1, 2)
        if not np.isfinite(model.rays(border)).all():
            raise InputError("the lens distortion is not invertible within the image; use a weaker distortion",
                             field="camera.distortion", value=tuple(model.distortion))
        self.lamp = lamp
        self._chain = ImageChain(model.width, model.height, settings)
        self._key = int(rng.integers(2**63))
        self.restart()
        self.texture = paint(surface, settings.resolution) if texture is None else texture
        self._numbers = lru_cache(maxsize=256)(self._drawn)
        self._whole_rays: dict[int, Array] = {}
        self._whole_samples: dict[int, tuple[Array, Array]] = {}

    def __enter__(self) -> RenderedCamera:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def restart(self) -> None:
        """Resets the automatic exposure."""
        self._gain, self._exposed, self._gains = 1.0, -math.inf, RowLog(2)

    def close(self) -> None:
        """Frees the resources of the renderer."""
        self._whole_rays.clear()
        self._whole_samples.clear()

    def due(self, t0: float, t1: float) -> list[float]:
        """Mid-exposure times [s] of the fields whose exposure *ends* in ``[t0, t1)``, without the lost ones.

        Once the arm has moved to ``t1``, all poses of these exposures are known. Of a rolling readout the middle row's
        exposure is the field's; none begins before time 0.
        """
        half = 0.5 * (self.settings.exposure + self.settings.rolling)
        first = max(0, *(math.ceil(round((since - self.settings.phase) * self.settings.rate, 6))
                         for since in (half, t0 - half)))
        times = []
        for k in range(first, first + 2 + int((t1 - t0) * self.settings.rate)):
            t = self.settings.phase + k / self.settings.rate
            if round((t + half - t1) * self.settings.rate, 6) >= 0.0:
                break
            if self.settings.loss == 0.0 or self._numbers(k)[0] >= self.settings.loss:
                times.append(t)
        return times

    def stamp(self, t_exposure: float) -> float:
        """Controller time that the camera states for the field exposed at ``t_exposure`` [s], one of ``due``."""
        k = round((t_exposure - self.settings.phase) * self.settings.rate)
        wrong = self.settings.stamp_offset + self.settings.stamp_drift * t_exposure
        return float(t_exposure + wrong + self.settings.stamp_noise * self._numbers(k)[2])

    def exposed(self, t_stamp: float) -> float:
        """True time of mid-exposure [s] of the field that the camera stamped ``t_stamp`` [s]."""
        s = self.settings
        k = round(((t_stamp - s.stamp_offset) / (1.0 + s.stamp_drift) - s.phase) * s.rate)
        return s.phase + k / s.rate

    def comes_twice(self, t_exposure: float) -> bool:
        """Whether the field exposed at ``t_exposure`` [s] is sent a second time."""
        if self.settings.doubled == 0.0:
            return False
        k = round((t_exposure - self.settings.phase) * self.settings.rate)
        return bool(self._stream(-1 - k).random() < self.settings.doubled)

    def windows(self, t_exposure: float, pose_at: PoseAt, windows: Sequence[Window],
                shape: Sequence[Array] = (), q: Array | None = None, *, measured: bool = True) -> Field:
        """Renders one field, cut to windows; raises ``InputError`` where one reaches outside the image.

        Args:
            t_exposure: true time of mid-exposure, one of ``due`` [s].
            pose_at: true TCP pose at a time; called within half the exposure (and readout) time around ``t_exposure``.
            windows: rectangles inside the image; empty ones give empty patches.
            shape: parts of the arm that may cast a shadow: ends of capsules ``(M, 2, 3)`` [m] and their radii ``(M,)``
                [m].
            q: arm angles ``(n,)`` [rad] at ``t_exposure``, for an arm that is in the picture (``shows_arm``).
            measured: whether positions are measured in it; otherwise it is rendered at mid-exposure with one sample per
                pixel.
        """
        for window in windows:
            inside = min(window) >= 0 and window.u + window.width <= self.model.width
            if not (inside and window.v + window.height <= self.model.height):
                raise InputError(f"outside the image of {self.model.width}×{self.model.height} px", field="window",
                                 value=tuple(window))
        s, pose_at, read = self.settings, cache(pose_at), [self._chain.around(window) for window in windows]
        rng = self._stream(round((t_exposure - s.phase) * s.rate))
        rng.random()
        latency = max(s.latency + s.jitter * rng.standard_normal(), 0.5 * (s.exposure + s.rolling))
        rng.standard_normal()
        t_stamp = self.stamp(t_exposure)
        n, samples = (s.sub_exposures, s.supersampling) if measured else (1, 1)
        gray = np.empty(0)
        if q is not None:
            self._stand(q, pose_at(t_exposure))
        for part, delay in self._in_time(read):
            poses = [pose_at(t_exposure + delay + ((i + 0.5) / n - 0.5) * s.exposure) for i in range(n)]
            sampled, bare = self._sampled(part, poses, samples)
            gray = np.concatenate([gray, self._lit(sampled, bare, part, poses[n // 2], shape)])
        if self.lamp is not None:
            middle = pose_at(t_exposure + ((n // 2 + 0.5) / n - 0.5) * s.exposure)
            gray = gray * self._exposure(t_exposure, middle, shape)
        ends = np.cumsum([wide.width * wide.height for wide in read])
        patches = tuple(cut(self._chain.developed(
            gray[end - wide.width * wide.height : end].reshape(wide.height, wide.width), wide, rng), wide, window)
            for window, wide, end in zip(windows, read, ends, strict=True))
        return Field(t_stamp, t_exposure + latency, tuple(windows), patches)

    def frame(self, pose: pin.SE3, noise_rng: np.random.Generator | None = None, shape: Sequence[Array] = (),
              q: Array | None = None) -> Gray:
        """The whole image ``(height, width)`` from one TCP pose, well exposed, for reports.

        Args:
            pose: of the TCP in the base frame.
            noise_rng: of the gray noise; None for none.
            shape: as for ``windows``.
            q: as for ``windows``.
        """
        whole = Window(0, 0, self.model.width, self.model.height)
        # A fine image shows its line smooth enough with one sample per pixel, and is slow in any case.
        samples = 2 if whole.width * whole.height <= FINE else 1
        if q is not None:
            self._stand(q, pose)
        gray, bare = self._sampled([whole], [pose], samples)
        if self.lamp is not None:
            gray = self._lit(gray, bare, [whole], pose, shape) / self._brightness(self.lamp, pose, shape)
        return self._chain.developed(gray.reshape(whole.height, whole.width), whole, noise_rng)

    def whole(self, seen: Field, pose_at: PoseAt, shape: Sequence[Array] = (), q: Array | None = None) -> Gray:
        """The whole picture ``(height, width)`` of a field, with its windows pasted in as they were read out.

        The rest is rendered for display only.

        Args:
            seen: from ``windows``, since the camera was restarted.
            pose_at: as for ``windows``.
            shape: as for ``windows``.
            q: as for ``windows``.
        """
        all_of_it = Window(0, 0, self.model.width, self.model.height)
        picture = self.windows(self.exposed(seen.t_stamp), pose_at, [all_of_it], shape, q,
                               measured=False).patches[0]
        for window, patch in zip(seen.windows, seen.patches, strict=True):
            cut(picture, all_of_it, window)[...] = patch
        return picture

    def _stand(self, q: Array, pose: pin.SE3) -> None:
        """Puts the arm where it stands, at angles ``q (n,)`` [rad] with the TCP at ``pose``; here it is never seen."""

    def _in_time(self, windows: Sequence[Window]) -> list[tuple[Sequence[Window], float]]:
        """The windows in pieces that are exposed together, and by how much later than the field's middle [s]."""
        if self.settings.rolling == 0.0:
            return [(windows, 0.0)]
        pieces: list[tuple[Sequence[Window], float]] = []
        for window in windows:
            for first in range(0, window.height, TOGETHER):
                piece = Window(window.u, window.v + first, window.width, min(TOGETHER, window.height - first))
                share = (piece.v + 0.5 * (piece.height - 1)) / (self.model.height - 1) - 0.5
                pieces.append(([piece], self.settings.rolling * share))
        return pieces

    def _stream(self, k: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=[self._key, k + 2**32]))

    def _drawn(self, k: int) -> tuple[float, float, float]:
        """The first numbers of a field's stream: whether it is lost, its delay, its stamp's error."""
        rng = self._stream(k)
        return float(rng.random()), float(rng.standard_normal()), float(rng.standard_normal())

    def _lit(self, gray: Array, bare: Array | float, windows: Sequence[Window], pose: pin.SE3, shape: Sequence[Array]
             ) -> Array:
        """Gray values ``(N,)`` where the lamp lights each pixel's place on the surface, with the lamp's mirror image.

        ``bare`` is the share of each pixel that is surface; neither shadow nor mirror image falls on the rest.
        """
        lamp = self.lamp
        if lamp is None or not len(gray):
            return gray
        x, y = zip(*(self._samples(window, 1) for window in windows), strict=True)
        points = self._on_plane(_in_one(x), _in_one(y), pose)
        up, eye = self.surface.plane.rotation[:, 2], (pose * self.model.T_tool_camera).translation
        hidden = covered(points, lamp.place, lamp.radius, *_capsules(shape)) * bare
        lit = light(lamp, points, up, self._lit_at, hidden)
        return np.asarray(gray * lit + mirrored(lamp, points, up, eye, hidden) * bare)

    def _exposure(self, t: float, pose: pin.SE3, shape: Sequence[Array]) -> float:
        """Factor of the automatic exposure, which follows what it sees with a lag."""
        lamp, lag = self.lamp, self.settings.auto_exposure
        if lamp is None or lag == 0.0:
            return 1.0
        if t <= self._exposed:
            times, gains = np.array(self._gains).T
            return float(gains[np.argmin(np.abs(times - t))])
        wanted = 1.0 / self._brightness(lamp, pose, shape)
        self._gain += (1.0 - math.exp((self._exposed - t) / lag)) * (wanted - self._gain)
        self._exposed = t
        self._gains.append((t, self._gain))
        return self._gain

    def _brightness(self, lamp: Lamp, pose: pin.SE3, shape: Sequence[Array]) -> float:
        """Most light at a few places of the picture, by which it is exposed."""
        points = self._on_plane(*self._metered, pose)
        hidden = covered(points, lamp.place, lamp.radius, *_capsules(shape))
        return float(light(lamp, points, self.surface.plane.rotation[:, 2], self._lit_at, hidden).max())

    @cached_property
    def _lit_at(self) -> Array:
        """Where the light is 1: the middle of the line."""
        return np.asarray(self.surface.at(np.array([0.5 * self.surface.length]))[0][0])

    @cached_property
    def _metered(self) -> tuple[Array, Array]:
        """Rays x, y ``(N,)`` of the places in the picture on which the automatic exposure looks."""
        u, v = np.meshgrid(self.model.width * np.array([0.2, 0.5, 0.8]), self.model.height * np.array([0.2, 0.5, 0.8]))
        x, y, _ = self.model.rays(np.column_stack([u.ravel(), v.ravel()])).T.copy()
        return x, y

    def _on_plane(self, x: Array, y: Array, pose: pin.SE3) -> Array:
        """Where rays (x, y, 1), ``(N,)`` each in the camera's frame, meet the surface's plane ``(N, 3)`` [m]."""
        T, plane = pose * self.model.T_tool_camera, self.surface.plane
        return np.asarray(on_plane(x, y, T.rotation, T.translation, plane.rotation[:, 2], plane.translation))

    def _sampled(self, windows: Sequence[Window], poses: Sequence[pin.SE3], n: int) -> tuple[Array, Array | float]:
        """Mean gray values ``(N,)`` over ``n`` × ``n`` samples a pixel and TCP pose; share of each that is surface."""
        base = self.surface.plane.inverse()
        maps = np.array([texel_map(base * pose * self.model.T_tool_camera, self.texture) for pose in poses])
        table = np.array(windows, dtype=np.int64).reshape(-1, 4)
        if self.model.width * self.model.height <= FINE:
            return sample_plane(self.texture.image, maps, self._rays_of_image(n), 0, 0, table), 1.0
        # The rays of a fine image would fill the memory, so they are computed window by window.
        return np.concatenate([np.empty(0), *(
            sample_plane(self.texture.image, maps, self._rays(window, n), window.u, window.v, row[None])
            for window, row in zip(windows, table, strict=True))]), 1.0

    def _rays_of_image(self, n: int) -> Array:
        if n not in self._whole_rays:
            self._whole_rays[n] = self._rays(Window(0, 0, self.model.width, self.model.height), n)
        return self._whole_rays[n]

    def _rays(self, window: Window, n: int) -> Array:
        """Rays (x, y, 1) of ``n`` × ``n`` samples in each pixel, their x and y ``(height, width, n², 2)``."""
        return np.stack(self._samples(window, n), axis=-1)

    def _samples(self, window: Window, n: int) -> tuple[Array, Array]:
        """X and y of ``_rays``, ``(height, width, n²)`` each; the lens is inverted once for all of a small image."""
        lens = self.model.K, self.model.distortion
        if self.model.width * self.model.height > FINE:
            return sample_rays(window.u, window.v, window.height, window.width, n, *lens)
        if n not in self._whole_samples:
            self._whole_samples[n] = sample_rays(0, 0, self.model.height, self.model.width, n, *lens)
        part = slice(window.v, window.v + window.height), slice(window.u, window.u + window.width)
        x, y = self._whole_samples[n]
        return np.ascontiguousarray(x[part]), np.ascontiguousarray(y[part])


def _in_one(parts: Sequence[Array]) -> Array:
    return np.concatenate([part.ravel() for part in parts])


def _capsules(shape: Sequence[Array]) -> tuple[Array, Array]:
    if len(shape):
        return np.ascontiguousarray(shape[0]), np.ascontiguousarray(shape[1])
    return np.empty((0, 2, 3)), np.empty(0)
