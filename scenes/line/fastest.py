"""The fastest speed at which a line is followed within a tolerance: trials from slow to fast, each predicted before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.summary import Summarised
from scenes.line.cell import Prepared, prepared, set_up
from scenes.line.play import play
from scenes.line.scene import LineScene
from scenes.result import Progress, silent

FIRST = 0.3
"""Speed of the first trial, or the scene's own where that is lower [m/s]."""
STEP = 1.8
"""Largest factor from one trial to the next: what is learned at one speed says little of one far above."""
TRIALS = 7
CLOSE = 0.05
"""Share by which two speeds may differ to count as one."""
MARGIN = 0.9
"""Share of the tolerance that a prediction may use up: a line played again has other noise."""


@dataclass(frozen=True, repr=False)
class Fastest(Summarised):
    """What the trials gave.

    Attributes:
        speed: the fastest one that keeps the tolerance [m/s].
        tolerance: that 95 % of the way have to keep [m].
        predicted: 95 % of the error at that speed, as the other trials tell [m].
        trials: speed [m/s] and 95 % of the error [m] of each, in the order played.
    """

    speed: float
    tolerance: float
    predicted: float
    trials: tuple[tuple[float, float], ...]

    def summary(self) -> list[tuple[str, str]]:
        """The speed and what it keeps."""
        return [("speed", f"{self.speed:.3g} m/s within {1e3 * self.tolerance:g} mm"),
                ("95 % predicted", f"{1e3 * self.predicted:.3g} mm"), ("trials", str(len(self.trials)))]

    def json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"speed_m_s": self.speed, "tolerance_mm": 1e3 * self.tolerance, "predicted_mm": 1e3 * self.predicted,
                "trials": [{"speed_m_s": v, "p95_mm": 1e3 * error} for v, error in self.trials]}


def fastest(scene: LineScene, tolerance: float, *, method: Any = None, shared: Prepared | None = None,
            progress: Progress = silent) -> Fastest:
    """Looks for the fastest speed at which 95 % of the way lie within a tolerance.

    Errors grow with the accelerations, so with the square of the speed: e(v) = a + b v², a and b by least squares from
    the trials so far. The next trial is where that reaches the tolerance, until it no longer moves, or the joints allow
    no more.

    Args:
        scene: what to follow.
        tolerance: for 95 % of the distances from the line [m].
        method: how the path is corrected; the scene's own if None.
        shared: from ``prepared`` of the scene, to save its time.
        progress: called with the fraction done.

    Raises:
        InputError: a tolerance that is not positive, or one that even the slowest trial does not keep.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError("expected a positive length such as 0.2mm", field="--tolerance", value=tolerance)
    if shared is None:
        with prepared(scene, progress) as own:
            return fastest(scene, tolerance, method=method, shared=own, progress=progress)
    speed, ceiling, trials = min(FIRST, scene.speed), np.inf, list[tuple[float, float]]()
    while len(trials) < TRIALS:
        speed = _possible(scene, speed)
        if any(abs(speed / v - 1.0) < CLOSE for v, _ in trials):
            break
        progress(len(trials) / TRIALS, f"trial at {speed:.2f} m/s")
        result = play(scene.changed(speed=speed), method or scene.method, shared=shared)
        error = result.control_error.p95 if result.failure is None else np.inf
        trials.append((speed, error))
        kept = [v for v, e in trials if e <= tolerance]
        if not kept:
            raise InputError(f"at {speed:.2f} m/s 95 % of the way lie within {1e3 * error:.3f} mm; allow more",
                             field="--tolerance", value=f"{1e3 * tolerance:g} mm")
        if error > tolerance:
            ceiling = min(ceiling, speed)
        wanted = _reaching(trials, MARGIN * tolerance)
        # Beyond a trial that failed nothing is tried again.
        speed = min(wanted, STEP * max(kept), 0.5 * (max(kept) + ceiling) if np.isfinite(ceiling) else np.inf)
        speed = max(speed, max(kept))
    chosen = max(v for v, e in trials if e <= tolerance)
    others = [one for one in trials if one[0] != chosen] or trials
    a, b = _law(others)
    return Fastest(chosen, tolerance, a + b * chosen**2, tuple(trials))


def _law(trials: list[tuple[float, float]]) -> tuple[float, float]:
    """a, b of e(v) = a + b v², neither negative."""
    finite = [(v, e) for v, e in trials if np.isfinite(e)]
    if len(finite) < 2:
        return finite[0][1], 0.0
    v, e = np.array(finite).T
    b = max(float(np.polyfit(v**2, e, 1)[0]), 0.0)
    return max(float(np.mean(e - b * v**2)), 0.0), b


def _reaching(trials: list[tuple[float, float]], error: float) -> float:
    a, b = _law(trials)
    return float(np.sqrt(max(error - a, 0.0) / b)) if b > 0 else np.inf


def _possible(scene: LineScene, speed: float) -> float:
    """The speed, or the fastest below it that the joints allow on this path."""
    low, high = 0.0, speed
    while True:
        try:
            set_up(scene.changed(speed=round(high, 3)))
            low = round(high, 3)
        except InputError as error:
            if error.field != "speed":
                raise
            speed = high
        if low and (low == round(speed, 3) or speed - low < 0.02 * speed):
            return low
        high = 0.5 * (low + speed)
