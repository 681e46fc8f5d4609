"""Drawn pictures beside photographs: gray values, noise and spectra; and what a line run makes of each difference."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from scenes.commands.common import whole_numbers
from scenes.line.cell import camera_of, set_up
from scenes.line.play import play
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_device import Window
from studies.report import head, row, scene_of

PLACES = (0.15, 0.35, 0.55, 0.75)
"""Shares of the reference over which drawn pictures are taken."""
BLOCK = 16
"""Side of the blocks in which noise is measured [px] …"""
CALM = 0.02
"""… and the share of them, of similar brightness, with the least noise: in these the scene itself is even."""
SIZES = (200, 1024)
"""Shorter and longer sides of a picture between which it is looked at; of a larger one the middle [px]."""
ENDINGS = (".png", ".jpg", ".jpeg")


def photographs(folder: Path) -> None:
    """Pictures of the scenes `line` and `real_camera` beside the photographs of a FOLDER: histogram, noise, spectrum.

    σ is the noise of the calmest blocks of 16 × 16 pixels among the dark, middle and bright third, their mean plane
    taken away; r the correlation of neighbouring pixels in them; the slope is that of the power over the frequency,
    both logarithmic, between 0.02 and 0.4 per pixel. Pictures that are drawings or smaller than 200 pixels are left
    out by whoever fills the folder; those that cannot be read are.
    """
    head("picture", "gray values used", "5 to 95 %", "σ dark", "σ middle", "σ bright", "r across", "r down", "slope",
         "power above 0.25, %")
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in ENDINGS)
    if not files:
        raise InputError(f"expected photographs ({', '.join(ENDINGS)}), as skimage/data has them", field="FOLDER",
                         value=str(folder))
    every = []
    for file in files:
        gray = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if gray is not None and min(gray.shape) >= SIZES[0]:
            every.append(looks(_middle(np.asarray(gray, dtype=np.uint8))))
            _told(file.stem, every[-1])
    _told("**median photograph**", np.nanmedian(every, axis=0))
    for name in ("line", "real_camera"):
        _told(f"`{name}`", np.nanmedian([looks(picture) for picture in _drawn(scene_of(LineScene, name))], axis=0))


def real_camera(seeds: str = "1,2") -> None:
    """The scene `line` with each difference of `real_camera` alone, with all of the camera's, and with all."""
    plain, real = (scene_of(LineScene, name) for name in ("line", "real_camera"))
    camera = real.camera.model_dump()
    differs = {key: value for key, value in camera.items() if value != plain.camera.model_dump()[key]}
    light = {key: differs.pop(key) for key in ("noise", "full_well")}
    cases = {"`line`": plain, "noise of the light": plain.changed(camera=light),
             **{f"{key} = {value}": plain.changed(camera={key: value}) for key, value in differs.items()},
             "all of the camera's": plain.changed(camera=light | differs),
             "paper, ink and width alone": real.changed(camera={key: plain.camera.model_dump()[key]
                                                               for key in light | differs}),
             "`real_camera`": real}
    head("pictures", "mean [mm]", "95 % [mm]", "fields used, of those taken")
    for name, scene in cases.items():
        runs = [play(scene.changed(seed=seed), "adapted") for seed in whole_numbers(seeds, "--seeds")]
        mean, p95 = np.mean([(1e3 * trial.control_error.mean, 1e3 * trial.control_error.p95) for trial in runs], axis=0)
        used = sum(trial.fields_used for trial in runs) / sum(trial.fields_seen for trial in runs)
        row(name, f"{mean:.3f}", f"{p95:.3f}", f"{used:.2f}")


def looks(gray: NDArray[np.uint8]) -> Array:
    """What a table's row says of a picture ``(height, width)``; NaN where nothing in it is calm ``(9,)``."""
    values = gray.astype(float)
    low, high = np.percentile(values, (5.0, 95.0))
    sigma, across, down = _noise(values)
    frequency, power = _spectrum(values)
    inside = (frequency >= 0.02) & (frequency <= 0.4) & (power > 0.0)
    slope = np.polyfit(np.log(frequency[inside]), np.log(power[inside]), 1)[0]
    share = power[frequency > 0.25] @ frequency[frequency > 0.25] / (power @ frequency)
    return np.array([len(np.unique(gray)), high - low, *sigma, across, down, slope, 100.0 * share])


def _told(name: str, values: Array) -> None:
    row(name, *(f"{value:.{digits}f}" for value, digits in zip(values, (0, 0, 2, 2, 2, 2, 2, 1, 2), strict=True)))


def _middle(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    v, u = (max(0, (size - SIZES[1]) // 2) for size in gray.shape)
    return gray[v : v + SIZES[1], u : u + SIZES[1]]


def _noise(gray: Array) -> tuple[Array, float, float]:
    """Standard deviation in the dark, middle and bright third ``(3,)``, correlation of neighbours across and down."""
    v, u = np.mgrid[:BLOCK, :BLOCK]
    plane = np.column_stack([np.ones(BLOCK**2), u.ravel(), v.ravel()])
    rows, columns = (size // BLOCK * BLOCK for size in gray.shape)
    blocks = gray[:rows, :columns].reshape(rows // BLOCK, BLOCK, -1, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
    blocks = blocks[(blocks.min(axis=1) > 1.0) & (blocks.max(axis=1) < 254.0)]
    if len(blocks) < 3:
        return np.full(3, np.nan), np.nan, np.nan
    bright = blocks.mean(axis=1)
    rest = blocks - (plane @ np.linalg.lstsq(plane, blocks.T, rcond=None)[0]).T
    sigma, calm = rest.std(axis=1), []
    for third in np.array_split(np.argsort(bright), 3):
        calm.append(third[np.argsort(sigma[third])][: max(2, round(CALM * len(third)))])
    square = rest[np.concatenate(calm)].reshape(-1, BLOCK, BLOCK)
    power = max(float(np.mean(square**2)), 1e-9)
    across, down = np.mean(square[:, :, 1:] * square[:, :, :-1]), np.mean(square[:, 1:] * square[:, :-1])
    return np.array([np.median(sigma[indices]) for indices in calm]), float(across / power), float(down / power)


def _spectrum(gray: Array) -> tuple[Array, Array]:
    """Frequencies [1/px] and mean power at them, over all directions; Hann's window."""
    window = np.outer(*(np.hanning(size) for size in gray.shape))
    power: Array = np.abs(np.fft.fft2((gray - gray.mean()) * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(gray.shape[0])[:, None], np.fft.fftfreq(gray.shape[1])[None, :]).ravel()
    ring = np.digitize(frequency, np.linspace(0.0, 0.5, 65))
    count = np.bincount(ring, minlength=66)[1:65]
    sums = np.bincount(ring, power.ravel(), minlength=66)[1:65]
    return np.linspace(0.5, 63.5, 64) / 128.0, np.asarray(sums / np.maximum(count, 1))


def _drawn(scene: LineScene) -> Iterator[NDArray[np.uint8]]:
    """Whole pictures while the tool moves along the reference as fast as the scene asks."""
    cell = set_up(scene)
    reference, settings = cell.known.reference, scene.camera
    with camera_of(cell) as camera:
        for k, share in enumerate(PLACES):
            t, s = camera.settings.phase + (10 + 5 * k) / settings.rate, share * reference.length
            yield camera.windows(t, lambda at, t=t, s=s: reference.pose(s + scene.speed * (at - t)),  # type: ignore[misc]
                                 [Window(0, 0, settings.width, settings.height)]).patches[0]
