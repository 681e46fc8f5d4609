"""Compares several methods on one line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.results import Summarised
from planning.line.deviation_sensor import DeviationSensor
from scenes.line.cell import Prepared, prepared, set_up
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.methods import ADAPTED, DIRECT, IDEAL, NONE, GainSearch, GainTrial, SceneMethod
from scenes.result import Progress, ShownTable, part_of, silent
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError

K_P = (0.01, 0.02, 0.03, 0.045, 0.065, 0.09, 0.13, 0.18, 0.25)
"""Gains tried on the deviation, per cycle."""
K_D = (0.3, 1.0)
"""Gains tried on its change, at the best K_p, relative to four times that."""
OVERSHOOT = 0.05
"""Overshoot over a sideways step that counts as overshooting, relative to the step."""


def best_gains(scene: LineScene, shared: Prepared, *, progress: Progress = silent
               ) -> tuple[tuple[float, float], tuple[GainTrial, ...]]:
    """K_p and K_d of direct sensor feedback with the least mean error on this scene, and all trials.

    Args:
        scene: the scene in which they are searched.
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
    """Largest K_p that does not overshoot a lateral step with this camera and this speed, and all trials.

    The step is a straight line beside its reference by 10 mm; overshoot is the TCP's distance beyond the line.
    """
    origin = scene.surface.origin
    step = scene.changed(
        line={"formula": None, "length": None, "svg": None, "corner_radius": 0.0, "points": [(0.0, 0.0), (1.2, 0.0)]},
        surface={"origin": (0.98, -0.6, origin[2]), "heading_deg": 90.0, "tilt_deg": (0.0, 0.0)},
        displacement={"lateral_mm": 10.0, "along_mm": 0.0, "turn_deg": 0.0}, feature=(), reference={"shape": None})
    trials = []
    with prepared(step) as shared:
        for i, k_p in enumerate(K_P):
            result = play(step, DIRECT, gains=(k_p, 0.0), shared=shared)
            lateral = result.control_error_from_start.lateral
            # A line that the camera never shows is not followed with any gain.
            beyond = max(0.0, -np.min(lateral / lateral[0])) if len(lateral) else np.inf
            trials.append((k_p, float(beyond)))
            progress((i + 1) / len(K_P), "searching the gain at which direct feedback overshoots")
            if trials[-1][1] > 4 * OVERSHOOT:
                break
    return max((k_p for k_p, overshoot in trials if overshoot <= OVERSHOOT), default=0.0), tuple(trials)


@dataclass(frozen=True, repr=False)
class LineComparison(ShownTable):
    """Results of every method on the same scene, by their keys.

    Attributes:
        gains: K_p, K_d of direct sensor feedback, found by search; None where it is not among the methods.
        tried: every pair of gains tried, with its mean error [m].
        overshoot_gain: largest K_p whose overshoot over a sideways step stays below 5 %.
        overshoots: K_p → overshoot relative to the step.
    """

    scene: LineScene
    runs: dict[str, LineResult]
    gains: tuple[float, float] | None
    tried: tuple[GainTrial, ...]
    overshoot_gain: float
    overshoots: tuple[tuple[float, float], ...]
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: the runs stand under ``methods``."""
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
            "methods": {method: run.json() for method, run in self.runs.items()},
            "direct_feedback": None if self.gains is None else {
                "k_p": self.gains[0],
                "k_d": self.gains[1],
                "largest_k_p_without_overshoot": self.overshoot_gain,
                "overshoot_of_k_p": [{"k_p": k, "overshoot": o} for k, o in self.overshoots],
                "tried": [{"k_p": trial.k_p, "k_d": trial.k_d, "mean_mm": 1e3 * trial.error} for trial in self.tried],
            },
            "recording": {method: run.recording_path for method, run in self.runs.items()},
            "urdf": next(iter(self.runs.values())).urdf,
            "report": self.report,
        }

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The methods as a table: titles, and one row per method; errors in mm."""
        columns = ["method", "mean mm", "95 % mm", "max mm", "E_car time-matched", "E_car aligned", "E_car geometric",
                   "fields used", "ended early"]
        rows = []
        for method, run in self.runs.items():
            error, path = run.control_error.json_mm(), run.path_errors
            e_car = [1e3 * getattr(path, kind).E_car if path is not None else None
                     for kind in ("time_matched", "aligned", "geometric")]
            rows.append([method, error["mean"], error["p95"], error["max"], *e_car,
                         f"{run.fields_used} of {run.fields_seen}", run.failure or "no"])
        return columns, rows


def compare_lines(scene: LineScene, methods: Sequence[SceneMethod], *, sensors: Sequence[DeviationSensor] = (),
                  progress: Progress = silent) -> LineComparison:
    """Follows the line with each method; direct sensor feedback uses the best gains for this scene.

    Args:
        scene: the scene.
        methods: in the order of the table.
        sensors: besides the camera, with every method.
        progress: called with the fraction done.
    """
    gain = 0.0
    overshoots: tuple[tuple[float, float], ...] = ()
    gains: tuple[float, float] | None = None
    tried: tuple[GainTrial, ...] = ()
    direct = any(method.key == DIRECT for method in methods)
    if direct:
        gain, overshoots = overshoot_gain(scene, progress=lambda fraction, text: progress(0.35 * fraction, text))
    start = 0.75 if direct else 0.0
    runs: dict[str, LineResult] = {}
    with prepared(scene) as shared:
        if direct:
            gains, tried = best_gains(scene, shared, progress=lambda part, text: progress(0.35 + 0.4 * part, text))
        for i, method in enumerate(methods):
            runs[method.key] = play(scene, method, shared=shared, gains=gains, sensors=sensors,
                                    progress=part_of(progress, start + (1 - start) * i / len(methods),
                                                     (1 - start) / len(methods)))
    for key in runs.keys() & {IDEAL, ADAPTED} if NONE in runs else ():
        runs[key] = runs[key].beside_none(runs[NONE])
    return LineComparison(scene, runs, gains, tried, gain, overshoots)


FIRST = 0.3
"""Speed of the first trial, or the scene's own where that is lower [m/s]."""
STEP = 1.8
"""Largest factor from one trial to the next: what is learned at one speed says little of one far above."""
TRIALS = 7
"""Plays at most: factors of ``STEP`` from the first speed to thirty times it."""
CLOSE = 0.05
"""Share by which two speeds may differ to count as one."""
MARGIN = 0.9
"""Share of the tolerance that a prediction may use up: a line played again has other noise."""


@dataclass(frozen=True, repr=False)
class Fastest(Summarised):
    """The result of the search for the fastest speed.

    Attributes:
        speed: the fastest one that keeps the tolerance [m/s].
        tolerance: largest error over 95 % of the path [m].
        predicted: 95 % of the error at that speed, as predicted from the other trials [m].
        trials: speed [m/s] and 95 % of the error [m] of each, in the order of the trials.
    """

    speed: float
    tolerance: float
    predicted: float
    trials: tuple[tuple[float, float], ...]

    def summary(self) -> list[tuple[str, str]]:
        """The speed and its error as rows of label and value."""
        return [("speed", f"{self.speed:.3g} m/s within {1e3 * self.tolerance:g} mm"),
                ("95 % predicted", f"{1e3 * self.predicted:.3g} mm"), ("trials", str(len(self.trials)))]

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {"speed_m_s": self.speed, "tolerance_mm": 1e3 * self.tolerance, "predicted_mm": 1e3 * self.predicted,
                "trials": [{"speed_m_s": v, "p95_mm": 1e3 * error} for v, error in self.trials]}


def fastest(scene: LineScene, tolerance: float, *, method: Any = None, shared: Prepared | None = None,
            progress: Progress = silent) -> Fastest:
    """Searches the fastest speed at which 95 % of the path lie within a tolerance.

    Errors grow with the accelerations, so with the square of the speed: e(v) = a + b v², a and b by least squares from
    the trials so far. The next trial is where that reaches the tolerance, until it no longer moves, or the joints allow
    no more.

    Args:
        scene: the scene.
        tolerance: for 95 % of the distances from the line [m].
        method: how the path is corrected; the scene's own if None.
        shared: from ``prepared`` of the scene, to save its time.
        progress: called with the fraction done.

    Raises:
        InputError: a tolerance that is not positive.
        SceneError: even the slowest trial does not keep it.
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
        allowed = [v for v, e in trials if e <= tolerance]
        if not allowed:
            raise SceneError(f"--tolerance {1e3 * tolerance:g} mm is not kept: at {speed:.2f} m/s 95 % of the way lie "
                             f"within {1e3 * error:.3f} mm; allow more")
        if error > tolerance:
            ceiling = min(ceiling, speed)
        estimate = _reaching(trials, MARGIN * tolerance)
        # Speeds beyond a failed trial are not tried again.
        speed = min(estimate, STEP * max(allowed), 0.5 * (max(allowed) + ceiling) if np.isfinite(ceiling) else np.inf)
        speed = max(speed, max(allowed))
    chosen = max(v for v, e in trials if e <= tolerance)
    other_trials = [trial for trial in trials if trial[0] != chosen and np.isfinite(trial[1])] or trials
    a, b = _law(other_trials)
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
