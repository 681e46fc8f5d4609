"""The drawn line of a line scene as the world has it: where it really is, worn by use."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from scenes.drawn_line import Geometry
from scenes.line.scene import LineScene, Wear
from sim.camera.surface import DrawnLine
from sim.camera.surface import Feature as DrawnFeature

WAVES = (0.37, 0.23, 0.11)
"""Wavelengths over which width and ink of a line drawn by hand change [m]."""


def drawn_line(scene: LineScene, where: Geometry, rng: np.random.Generator) -> DrawnLine:
    """The line with the scene's features and what the seed draws of its wear.

    Args:
        scene: its tables ``line``, ``feature`` and ``wear``.
        where: the line's place.
        rng: draws the wear.
    """
    look, wear = scene.line, scene.wear
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(where.drawn, axis=0), axis=1))])
    wide, pale = _smooth(s, rng), 0.5 * (1.0 + _smooth(s, rng))
    widths = 1e-3 * look.width_mm * (1.0 + 0.01 * wear.width_percent * wide)
    grays = look.gray + 0.01 * wear.fade_percent * pale * (look.background - look.gray)
    worn = wear.width_percent > 0 or wear.fade_percent > 0
    return DrawnLine(where.drawn, where.plane, width=1e-3 * look.width_mm, gray=look.gray, background=look.background,
                     edge=1e-3 * look.edge_mm, features=(*_features(scene), *_worn(wear, float(s[-1]), rng)),
                     widths=widths if worn else None, grays=grays if worn else None,
                     grain=None if wear.grain == "none" else wear.grain, grain_seed=scene.seed)


def _features(scene: LineScene) -> tuple[DrawnFeature, ...]:
    return tuple(
        DrawnFeature(kind=f.kind, at=1e-3 * f.at_mm, length=1e-3 * f.length_mm, offset=1e-3 * f.offset_mm,
                     angle=float(np.radians(f.angle_deg)), width=1e-3 * f.width_mm, gray=f.gray)
        for f in scene.feature)


def _worn(wear: Wear, length: float, rng: np.random.Generator) -> list[DrawnFeature]:
    """Gaps, strokes and light, anywhere on the line; each kind has draws of its own."""
    gaps, scratches, crossings, glares, shades = rng.spawn(5)

    def place(one: np.random.Generator) -> float:
        return float(length * one.uniform(0.1, 0.95))

    found = [DrawnFeature("gap", place(gaps), length=1e-3 * wear.gap_mm * gaps.uniform(0.5, 1.0))
             for _ in range(wear.gaps)]
    found += [DrawnFeature("scratch", place(scratches), length=scratches.uniform(0.05, 0.15), width=0.0015,
                           angle=scratches.uniform(0.2, 1.2), offset=scratches.uniform(-0.005, 0.005))
              for _ in range(wear.scratches)]
    found += [DrawnFeature("crossing", place(crossings), length=0.2, angle=crossings.uniform(0.8, 2.3))
              for _ in range(wear.crossings)]
    found += [DrawnFeature("glare", place(glares), length=glares.uniform(0.08, 0.16),
                           offset=glares.uniform(-0.02, 0.02)) for _ in range(wear.glares)]
    return found + [DrawnFeature("shade", place(shades), length=shades.uniform(0.15, 0.25),
                                 offset=shades.uniform(-0.03, 0.03)) for _ in range(wear.shades)]


def _smooth(s: Array, rng: np.random.Generator) -> Array:
    """A smooth random course between -1 and 1 over arc lengths ``(N,)`` [m]."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(WAVES))
    return np.mean([np.sin(2.0 * np.pi * s / wave + phase) for wave, phase in zip(WAVES, phases, strict=True)], axis=0)
