"""Which gains direct sensor feedback can take with a late camera ([L] 4.4)."""

from __future__ import annotations

import numpy as np

from scenes.gains import GainSearch, GainTrial
from scenes.line.cell import Prepared, prepared
from scenes.line.play import play
from scenes.line.scene import LineScene
from scenes.methods import DIRECT
from scenes.result import Progress, silent

K_P = (0.01, 0.02, 0.03, 0.045, 0.065, 0.09, 0.13, 0.18, 0.25)
"""Gains tried on the deviation, per cycle."""
K_D = (0.3, 1.0)
"""Gains tried on its change, at the best K_p, relative to four times that."""
OVERSHOOT = 0.05
"""Overshoot over a sideways step that counts as overshooting, relative to the step."""


def best_gains(scene: LineScene, shared: Prepared, *, progress: Progress = silent
               ) -> tuple[tuple[float, float], tuple[GainTrial, ...]]:
    """K_p and K_d of direct sensor feedback with the least mean error on this scene, and all that was tried.

    Args:
        scene: in which they are searched.
        shared: from ``prepared`` of the scene.
        progress: called with the fraction done.

    Returns:
        K_p, K_d [1 per cycle] and the trials with their mean errors [m].
    """
    def mean(k_p: float, k_d: float) -> float:
        result = play(scene, DIRECT, gains=(k_p, k_d), shared=shared)
        return result.control_error.mean if result.failure is None else float("inf")

    search = GainSearch(mean, len(K_P) + 2 + len(K_D), progress)
    search.scan(K_P)
    search.between(K_P)
    k_p = search.best().k_p
    search.scan([k_p], [k_d * k_p * 4 for k_d in K_D])
    best = search.best()
    return (best.k_p, best.k_d), tuple(search.trials)


def overshoot_gain(scene: LineScene, *, progress: Progress = silent) -> tuple[float, tuple[tuple[float, float], ...]]:
    """Largest K_p that does not overshoot a sideways step with this camera and this speed.

    The step is a straight line beside its reference by 10 mm; what the TCP does beyond the line is overshoot.
    """
    origin = scene.surface.origin
    step = scene.changed(
        line={"formula": None, "length": None, "svg": None, "corner_radius": 0.0, "points": [(0.0, 0.0), (1.2, 0.0)]},
        surface={"origin": (0.98, -0.6, origin[2]), "heading_deg": 90.0, "tilt_deg": (0.0, 0.0)},
        displacement={"lateral_mm": 10.0, "along_mm": 0.0, "turn_deg": 0.0}, feature=(), reference={"shape": None})
    found = []
    with prepared(step) as shared:
        for i, k_p in enumerate(K_P):
            result = play(step, DIRECT, gains=(k_p, 0.0), shared=shared)
            lateral = result.control_error_from_start.lateral
            found.append((k_p, float(max(0.0, -np.min(lateral * np.sign(lateral[0]))) / abs(lateral[0]))))
            progress((i + 1) / len(K_P), "searching the gain at which direct feedback overshoots")
            if found[-1][1] > 4 * OVERSHOOT:
                break
    below = [k_p for k_p, overshoot in found if overshoot <= OVERSHOOT]
    return (max(below) if below else 0.0), tuple(found)
