"""The gains that direct force feedback does best with."""

from __future__ import annotations

from scenes.force.play import play
from scenes.force.scene import ForceScene
from scenes.gains import GainSearch, GainTrial
from scenes.methods import DIRECT
from scenes.result import Progress, silent

PROPORTIONAL = (0.04, 0.08, 0.13, 0.17, 0.21, 0.26)
"""K_p tried, as shares of 1/E per cycle: 1 would take the whole error away in one cycle, did nothing delay it."""
DIFFERENTIAL = (0.25, 0.5, 1.0)
"""K_d tried with the best K_p and its neighbours, as shares of 1/E."""


def best_gains(scene: ForceScene, *, progress: Progress = silent) -> tuple[tuple[float, float], tuple[GainTrial, ...]]:
    """K_p [m/N per cycle] and K_d [m/N] with the smallest RMS force error [N] in this scene, and all that was tried."""
    def rms(k_p: float, k_d: float) -> float:
        result = play(scene, DIRECT, (k_p, k_d))
        return result.figures.rms if result.failure is None else float("inf")

    search = GainSearch(rms, len(PROPORTIONAL) + 2 * len(DIFFERENTIAL), progress)
    unit = 1.0 / scene.tip.stiffness
    search.scan([share * unit for share in PROPORTIONAL])
    for one in search.ranked()[:2]:
        search.scan([one.k_p], [share * unit for share in DIFFERENTIAL])
    best = search.best()
    return (best.k_p, best.k_d), tuple(search.trials)
