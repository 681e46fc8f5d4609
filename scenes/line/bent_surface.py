"""A surface that is slightly bent along the line that is drawn on it."""

from __future__ import annotations

import numpy as np

from ideal_robot.errors import InputError
from scenes.drawn_line import Geometry
from scenes.line.scene import LineScene
from sim.contact.contact import HeightSurface, Wave


def bent_surface(scene: LineScene, where: Geometry, rng: np.random.Generator) -> HeightSurface | None:
    """Half a sine wave over the line's longest extent, nothing at its ends; None where the surface is flat.

    Args:
        scene: its table ``displacement``.
        where: the line's place.
        rng: draws whether the middle is up or down.

    Raises:
        InputError: a bent surface with a camera that sees the plane alone.
    """
    bow = 1e-3 * scene.displacement.bow_mm
    up = rng.choice([-1.0, 1.0])
    if bow == 0.0:
        return None
    if scene.camera.renderer == "sampled":
        raise InputError("only camera.renderer = 'bullet' shows a bent surface", field="displacement.bow_mm",
                         value=scene.displacement.bow_mm)
    middle = where.drawn_xy.mean(axis=0)
    along = np.linalg.svd(where.drawn_xy - middle, full_matrices=False)[2][0]
    places = where.drawn_xy @ along
    start, span = float(places.min()), float(np.ptp(places))
    wave = Wave(float(up) * bow, 2.0 * span, float(np.arctan2(along[1], along[0])), -np.pi * start / span)
    return HeightSurface(where.plane, (wave,))
