"""The search for the gains of direct sensor feedback, [L] (1): a scan of K_p, then refinements around the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scenes.result import Progress


@dataclass(frozen=True)
class GainTrial:
    """One pair of gains and the error that it leaves; infinite where the run failed."""

    k_p: float
    k_d: float
    error: float


class GainSearch:
    """Tries gains one after another and keeps what came of them.

    Args:
        error: the error that a pair K_p, K_d leaves in the scene; infinite or NaN where it fails.
        total: trials to expect, for the progress.
        progress: called after each trial.
    """

    def __init__(self, error: Callable[[float, float], float], total: int, progress: Progress) -> None:
        self._error, self._total, self._progress = error, total, progress
        self.trials: list[GainTrial] = []

    def scan(self, k_p: Sequence[float], k_d: Sequence[float] = (0.0,)) -> None:
        """Tries every K_p with every K_d."""
        for p in k_p:
            for d in k_d:
                error = self._error(p, d)
                self.trials.append(GainTrial(p, d, error if np.isfinite(error) else float("inf")))
                self._progress(min(len(self.trials) / self._total, 1.0), "searching the gains of direct feedback")

    def between(self, k_p: Sequence[float]) -> None:
        """Tries the geometric means of the best K_p and its neighbours in ``k_p``, which was scanned."""
        best = list(k_p).index(self.best().k_p)
        self.scan([float(np.sqrt(k_p[best] * k_p[other])) for other in (best - 1, best + 1) if 0 <= other < len(k_p)])

    def ranked(self) -> list[GainTrial]:
        """All trials, the best first."""
        return sorted(self.trials, key=lambda trial: trial.error)

    def best(self) -> GainTrial:
        """The trial with the smallest error; the first one of equals."""
        return self.ranked()[0]
