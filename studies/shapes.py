"""Surfaces that no file of the simulator has: bumps, filtered steps and random waves, of seeds kept apart."""

from __future__ import annotations

from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from scenes.commands.common import whole_numbers
from scenes.force.kind import run
from scenes.methods import IDEAL
from scenes.scene_files.force_scene import ForceScene
from studies.report import head, row, scene_of

PERIOD = 2.0
"""Length over which a drawn surface repeats itself, longer than the path [m]."""
FINEST = 0.02
"""Shortest wave of the sum that a drawn surface is given as [m]."""


def drawn(kind: str, rng: np.random.Generator) -> Array:
    """Heights of a surface over ``PERIOD`` ``(N,)`` [m].

    Args:
        kind: ``bumps``, ``steps`` or ``waves``.
        rng: draws places, sizes and widths.
    """
    x = np.linspace(0.0, PERIOD, 2000, endpoint=False)
    height = np.zeros_like(x)
    if kind == "bumps":
        for place in rng.uniform(0.15, 0.75, 2):
            height += rng.choice([-1, 1]) * rng.uniform(1e-3, 3e-3) * np.exp(
                -0.5 * ((x - place) / rng.uniform(0.025, 0.05)) ** 2)
    elif kind == "steps":
        for place in rng.uniform(0.15, 0.75, 2):
            step, width = rng.choice([-1, 1]) * rng.uniform(0.5e-3, 2e-3), rng.uniform(0.02, 0.04)
            # Up there, and down again beyond the path.
            height += 0.5 * step * (np.tanh((x - place) / width) - np.tanh((x - 1.5) / 0.1))
    else:
        k = np.arange(1, round(PERIOD / 0.08))
        sizes = rng.standard_normal((2, len(k))) / k**2
        height = sizes[0] @ np.cos(np.outer(k, 2 * np.pi * x / PERIOD)) + sizes[1] @ np.sin(
            np.outer(k, 2 * np.pi * x / PERIOD))
        height *= 0.06 / np.gradient(height, x).std()
    return np.asarray(height)


def as_waves(height: Array) -> list[dict[str, float]]:
    """Waves of a surface's table whose sum has these heights over ``PERIOD``."""
    found = np.fft.rfft(height) / len(height) * 2
    return [{"amplitude_mm": 1e3 * abs(found[k]), "wavelength_mm": 1e3 * PERIOD / k,
             "phase_deg": float(np.degrees(np.angle(found[k]) + np.pi / 2))}
            for k in range(1, round(PERIOD / FINEST)) if abs(found[k]) > 1e-8]


def surface_shapes(seeds: str = "1,2,3", kinds: str = "bumps,steps,waves") -> None:
    """`force_wave` on drawn surfaces: RMS and largest error of the force, and the least force, by seed.

    The surface is displaced and tilted as in the scene. Bumps are 1 to 3 mm high and 25 to 50 mm wide (σ), steps 0.5 to
    2 mm high over 20 to 40 mm, waves random with a slope of 0.06 RMS down to 80 mm.
    """
    scene, wanted = scene_of(ForceScene, "force_wave"), whole_numbers(seeds, "--seeds")
    head("surface", *(f"RMS N, seed {seed}" for seed in wanted), *(f"least, largest N, seed {seed}" for seed in wanted))
    for kind in kinds.split(","):
        runs: list[Any] = []
        for seed in wanted:
            waves = as_waves(drawn(kind, np.random.default_rng(1000 + seed)))
            runs.append(run(scene.changed(seed=seed, gains=None, surface={"wave": waves}), method=IDEAL))
        row(kind, *(f"{one.figures.rms:.2f}{', ' + one.failure if one.failure else ''}" for one in runs),
            *(f"{one.figures.least:.1f}, {one.figures.largest:.1f}" for one in runs))
