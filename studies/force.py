"""Force in the workshop, on contacts whose stiffness nobody told, and what its error is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import UnivariateSpline

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.feedforward.method import Setting
from planning.follower import Phase
from planning.force.force_follower import surface_filter
from planning.line.filter_bank import FilterBank
from planning.line.measurement import Measurement
from scenes.commands.common import numbers, whole_numbers
from scenes.force.cell import Cell, Prepared, set_up, true_surface
from scenes.force.kind import run
from scenes.force.play import ForceResult, methods, play, pressed
from scenes.methods import DIRECT, IDEAL, method_of
from scenes.online.configured import force_task
from scenes.online.contact import ContactSensor
from scenes.online.task import Sensor, Work
from scenes.scene_files.force_scene import ForceScene
from studies.closings import with_true_friction
from studies.report import head, row, scene_of

FRICTION = (0.05, 0.4)
"""From the softest to the stiffest contact."""
UNSTOPPED = {"force": 1e4, "lost": 60.0}
"""Limits that no run of direct feedback reaches, so that it has a number where it loses contact."""
DRIFT = (0.1, -0.1, 0.3, 0.0, 0.0, 0.0)
"""By which the sensor's bias has changed since its calibration [N, N m]."""


def contact_scene(stiffness: float, seed: int) -> ForceScene:
    """`force_wave` on a contact of this stiffness [N/mm]."""
    friction = float(np.interp(np.log(stiffness), np.log([2.0, 50.0]), FRICTION))
    return scene_of(ForceScene, "force_wave").changed(seed=seed, gains=None, sensor={"drift": DRIFT},
                                            tip={"stiffness": 1e3 * stiffness, "friction": friction})


def force(stiffness: str = "2,5,10,20,50", seeds: str = "1,2", direct: bool = False) -> None:
    """`force_wave` over stiffnesses in N/mm, and `glue`: RMS and largest force, with --direct of direct feedback too.

    Wanted: RMS at most 1 N and a quarter of direct feedback's, never above 40 N. Direct feedback has the best gains
    that a search in the same cell finds, and no emergency stop.
    """
    draws = whole_numbers(seeds, "--seeds")
    scenes = {f"{k:g} N/mm": [contact_scene(k, seed) for seed in draws] for k in numbers(stiffness, "--stiffness")}
    glue = {"`glue`, 4 N/mm": [scene_of(ForceScene, "glue").changed(seed=seed) for seed in draws]}
    ideal: dict[str, float] = {}
    head("contact", *(f"RMS N, seed {seed}" for seed in draws), *(f"largest N, seed {seed}" for seed in draws))
    for name, each in (scenes | glue).items():
        runs = [run(scene, method=IDEAL) for scene in each]
        ideal[name] = runs[0].figures.rms
        title = f"{name}, μ = {each[0].tip.friction:.2f}" if name in scenes else name
        row(title, *(_figure(result, "rms", 2) for result in runs), *(_figure(result, "largest", 1) for result in runs))
    if direct:
        print()
        head("contact", "direct feedback, RMS N", "largest N", "least N", "ours, of it")
        for name, each in scenes.items():
            result = run(each[0].changed(emergency=UNSTOPPED), method=DIRECT)
            row(name, _figure(result, "rms", 2), *(_figure(result, key, 1) for key in ("largest", "least")),
                f"{ideal[name] / result.figures.rms:.2f}")


def _figure(result: ForceResult, key: str, digits: int) -> str:
    return f"{getattr(result.figures, key):.{digits}f}" + (f", {result.failure}" if result.failure else "")


LATER = 10
"""Cycles after which the forces of a cycle have arrived."""
FULL = 0.95
"""Share of the speed from which on it counts as full."""
SMOOTH = 3e-6
"""Standard deviation of the surface that is told from the one that was found [m]."""


def force_parts(stiffness: str = "10,20,50", seed: int = 1, told: bool = False) -> None:
    """Heights in µm over the travel: planned against right, tip against planned, believed against true tip.

    *plan* is the height that was planned against the one at which the force would have been right, *arm* the height of
    the tip against the planned one, *tip* where the program thinks, once its forces have arrived, that the tip was
    against where it was; root mean squares. --told plays twice more: with the surface known beforehand (the height at
    which the force would have been right in the first play), and with the true friction of all joints told besides.
    """
    five = ["plan µm", "arm µm", "tip µm", "RMS N", "at full speed"]
    more = ["surface known: plan", *five[1:], "and friction: plan", *five[1:]]
    head("contact", *five, *(more if told else []))
    for k in numbers(stiffness, "--stiffness"):
        scene = contact_scene(k, seed)
        felt = _played(scene)
        cells = felt.cells()
        if told:
            surface = _KnownSurface(felt.s, felt.right)
            cells += _played(scene, surface=surface).cells()
            cells += _played(scene, _knowing_friction(scene), surface).cells()
        row(f"{k:g} N/mm", *cells)


def forecast_errors(speed: float = 0.2, stiffness: str = "2,5,10,20,50", ms: str = "34,41,50,67", seeds: str = "1,2,3"
                    ) -> None:
    """RMS in N by which the filter forecasts the surface of `force_wave` wrongly, by stiffness [N/mm] and time ahead.

    Samples come at 250 Hz with the sensor's noise; the arm is where it should be, and all else is known.
    """
    scene, ahead = scene_of(ForceScene, "force_wave"), 1e-3 * np.array(numbers(ms, "--ms"))
    noise, surface = scene.sensor.noise[0], true_surface(scene.surface)
    t = np.arange(0.0, (scene.line.length or 0.0) / speed, 1.0 / scene.sensor.rate)
    along = np.array([0.0, 1.0])
    head("contact", *(f"{1e3 * lead:g} ms" for lead in ahead))
    for k in numbers(stiffness, "--stiffness"):
        wrong = []
        for seed in whole_numbers(seeds, "--seeds"):
            bank, sigma = surface_filter((1e-6, 1e-6, 1e-6)), noise / (1e3 * k)
            felt = surface.height(speed * t, 0.0) + sigma * np.random.default_rng(seed).standard_normal(len(t))
            for instant, z in zip(t, felt, strict=True):
                s = speed * np.array([instant])
                bank.update(Measurement(instant, s, np.array([z]), np.array([[sigma**2]]), along[None], "force",
                                        at=float(s[0])))
                # Of the first tenth of a second a forecast knows next to nothing.
                if instant > 0.1:
                    places = speed * (instant + ahead)
                    wrong.append(bank.mean(places)[:, 1] - surface.height(places, 0.0))
        row(f"{k:g} N/mm", *(f"{rms:.2f}" for rms in 1e3 * k * np.sqrt(np.mean(np.square(wrong), axis=0))))


class _Watched(Sensor):
    """Writes down for each cycle of the travel what was planned, where the arm is, and later where it is thought."""

    def __init__(self, contact: ContactSensor) -> None:
        self._contact = contact
        self.rows: list[tuple[float, float, float, Array]] = []
        self.believed: dict[float, Array] = {}

    def fuse(self, t: float) -> Work:
        return Work.NOTHING

    def request(self, t0: float, t1: float) -> None:
        follower, log = self._contact.follower, self._contact.log
        if follower.phase is Phase.TRAVEL:
            arm = vars(self._contact.device)["_arm"]
            self.rows.append((t0, follower.s_at(t0), follower.desired_deviation(t0)[1], arm.q_a.copy()))
        late = len(log.t) - 1 - LATER
        if late >= 0:
            self.believed[log.t[late]] = follower.history.q(log.t[late])


class _KnownSurface(FilterBank):
    """Takes the filter's place: what was felt before is followed, whatever is felt now."""

    def __init__(self, s: Array, height: Array) -> None:
        new = np.concatenate([[True], np.diff(s) > 1e-6])
        self._end = float(s[-1])
        self._spline = UnivariateSpline(s[new], height[new], s=np.count_nonzero(new) * SMOOTH**2, k=5)

    def in_place_of(self, bank: FilterBank) -> None:
        super().__init__(bank.members)

    def mean(self, s: Array) -> Array:
        height = self._spline(np.clip(s, 0.0, self._end))
        return np.column_stack([np.zeros(len(s)), height]) if self._s > 0 else super().mean(s)


@dataclass(frozen=True)
class _Parts:
    """Heights along the travel ``(N,)`` [m] at arc lengths ``s (N,)`` [m]; RMS of the force, also at full speed [N]."""

    s: Array
    right: Array
    planned: Array
    tip: Array
    believed: Array
    rms: float
    at_speed: float

    def cells(self) -> list[str]:
        differences = (self.right - self.planned, self.planned - self.tip, self.believed - self.tip)
        return [*(f"{1e6 * np.sqrt(np.mean(difference**2)):.0f}" for difference in differences), f"{self.rms:.2f}",
                f"{self.at_speed:.2f}"]


def _played(scene: ForceScene, method: Any = IDEAL, surface: _KnownSurface | None = None) -> _Parts:
    """One play, taken apart; by a method's key or factory, on what is felt unless the surface is known."""
    shared = Prepared(scene)
    cell = set_up(scene)
    configured = force_task(cell.known, method_of(method, methods()), *shared.contact,
                            friction=shared.friction)
    contact = configured.contact
    assert contact is not None
    watched = _Watched(contact)
    configured.task.sensors.append(watched)
    if surface is not None:
        surface.in_place_of(vars(contact.follower)["fusion"])
        vars(contact.follower)["fusion"] = surface
    result = pressed(cell, configured, "ideal")
    if result.failure:
        raise SystemExit(result.failure)
    return _taken_apart(cell, watched, scene, result.history)


def _taken_apart(cell: Cell, task: _Watched, scene: ForceScene, history: dict[str, Array]) -> _Parts:
    fk, reference = cell.known.robot.fk(), cell.known.reference

    def height(q: Array, s: float) -> float:
        return float(reference.project(fk(q).translation[None], s, span=0.06)[2][0])

    rows = [cycle for cycle in task.rows if cycle[0] in task.believed]
    t, s, planned = (np.array([cycle[i] for cycle in rows]) for i in range(3))
    tip = np.array([height(q_a, place) for _, place, _, q_a in rows])
    believed = np.array([height(task.believed[instant], place) for instant, place, _, _ in rows])
    wrong = np.interp(t, history["t"], history["normal"]) - scene.force
    travel = (history["t"] >= t[0]) & (history["t"] <= t[-1])
    rms = float(np.sqrt(np.mean((history["normal"][travel] - scene.force) ** 2)))
    fast = np.gradient(s, t) > FULL * scene.speed
    at_speed = float(np.sqrt(np.mean(wrong[fast] ** 2)))
    return _Parts(s, tip + wrong / scene.tip.stiffness, planned, tip, believed, rms, at_speed)


def _knowing_friction(scene: ForceScene) -> Any:
    """A factory of the ideal robot that is told the true friction of the scene's arm."""
    cell = set_up(scene)

    def ideal_with_true_friction(setting: Setting) -> Feedforward:
        every = list(range(1, cell.known.robot.n + 1))
        return Inverse(with_true_friction(setting.loop(), cell.known.robot, cell.world, every), setting.horizon(30))

    return ideal_with_true_friction


# How wrong distance and elasticity may be assumed before sensor-based following becomes unstable ([L] 2.3).
#
# "Stability is touched only when the robot position itself is fed back. This may be the case if the transformation
# from sensor values to desired robot positions is totally wrong because of an erroneously assumed distance in image
# processing or an incorrectly measured compliance in force control." With the ratio r of assumed to true elasticity,
# [L] (3) gives
#
#     x̂_a + (F_r − F)/(r E) = x_s + (1 − 1/r)(x_a − x_s)
#
# so the share 1 − 1/r of the arm's own position is fed back: none for r = 1, minus one for r = 1/2. With the ratio of
# assumed to true distance, the share is 1 − r: minus one for r = 2. The map that looks ahead makes more of that share
# than a plain feedback would; estimating both ratios on the way takes it away again. Both are measured here.

RATIOS = {"elasticity": (0.25, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5, 4.0),
          "distance": (0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5)}
"""Of the assumed to the true value."""
SCENES = {"elasticity": ("force_wave", 0.4), "distance": ("glue", 0.5)}
"""Where each is assumed, and length of the line [m]."""
UNITS = {"elasticity": "RMS force error [N]", "distance": "mean lateral error [mm]"}
WORSE = 3.0
"""A run counts as stable if it is done and its error is below this many times that with the right value, plus …"""
FREE = {"elasticity": 4.0, "distance": 0.5}
"""… this much, which costs accuracy but not stability [N, mm]."""


@dataclass(frozen=True)
class StabilityRun:
    """A run with a wrong assumption: its ratio, its error [N or mm], whether it is stable, why it was stopped."""

    ratio: float
    error: float
    stable: bool
    reason: str = ""


def stability(figure: Path | None = None) -> None:
    """Short `force_wave` and `glue` with elasticity and distance assumed wrongly: stable ranges of assumed to true.

    --figure draws the errors over the ratios.
    """
    curves = {(quantity, estimated): curve(quantity, estimated, RATIOS[quantity])
              for quantity in RATIOS for estimated in (False, True)}
    head("assumed wrongly", "estimated on the way", "stable", "error by ratio")
    for (quantity, estimated), runs in curves.items():
        low, high = bounds(runs)
        row(quantity, "yes" if estimated else "no", f"{low:g} to {high:g}",
            "; ".join(f"{trial.ratio:g}: {trial.reason.partition(';')[0] or f'{trial.error:.2f}'}" for trial in runs))
    if figure is not None:
        _drawn(curves).savefig(figure, dpi=90)


def curve(quantity: str, estimated: bool, ratios: Sequence[float]) -> list[StabilityRun]:
    """Runs over the ratios, 1 among them, with the ratio estimated on the way or taken as assumed."""
    name, length = SCENES[quantity]
    scene = scene_of(ForceScene, name).changed(line={"length": length})
    runs: list[tuple[float, float, str]] = []
    for ratio in ratios:
        assumed = {f"{quantity}_ratio": ratio, f"{quantity}_estimated": estimated}
        result = play(scene.changed(assumed=assumed), "ideal")
        error = (result.figures.rms if quantity == "elasticity"
                 else result.lateral.get("control_error_mm", {}).get("mean", float("nan")))
        runs.append((ratio, float(error), result.failure or ""))
    most = WORSE * next(error for ratio, error, _ in runs if ratio == 1.0) + FREE[quantity]
    return [StabilityRun(ratio, error, not why and error < most, why) for ratio, error, why in runs]


def bounds(runs: Sequence[StabilityRun]) -> tuple[float, float]:
    """Smallest and largest ratio of the stable range around 1."""
    unstable = [trial.ratio for trial in runs if not trial.stable]
    below, above = max((r for r in unstable if r < 1), default=0.0), min((r for r in unstable if r > 1), default=np.inf)
    inside = [1.0, *(trial.ratio for trial in runs if below < trial.ratio < above)]
    return min(inside), max(inside)


def _drawn(curves: dict[tuple[str, bool], list[StabilityRun]]) -> Figure:
    """Error over the ratio of assumed to true, both quantities; circles are stable, what was stopped is at the top."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for axis, quantity in zip(figure.subplots(1, 2), RATIOS, strict=True):
        both = (*curves[quantity, False], *curves[quantity, True])
        top = 4 * max((trial.error for trial in both if trial.stable), default=1.0)
        for estimated, colour in ((False, "#1f5fa8"), (True, "#e06000")):
            points = curves[quantity, estimated]
            shown = [min(trial.error, top) if np.isfinite(trial.error) else top for trial in points]
            axis.plot([trial.ratio for trial in points], shown, color=colour, lw=0.8,
                      label="estimated on the way" if estimated else "taken as assumed")
            for trial, value in zip(points, shown, strict=True):
                axis.plot(trial.ratio, value, "o" if trial.stable else "x", color=colour)
        axis.set_xscale("log")
        axis.set_xticks([0.25, 0.5, 1.0, 2.0, 4.0], ["1/4", "1/2", "1", "2", "4"])
        axis.minorticks_off()
        axis.set(xlabel=f"assumed / true {quantity}", ylabel=UNITS[quantity])
        axis.grid(alpha=0.3)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


# Surfaces that no file of the simulator has: bumps, filtered steps and random waves, of seeds kept apart.

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
    spectrum = np.fft.rfft(height) / len(height) * 2
    return [{"amplitude_mm": 1e3 * abs(spectrum[k]), "wavelength_mm": 1e3 * PERIOD / k,
             "phase_deg": float(np.degrees(np.angle(spectrum[k]) + np.pi / 2))}
            for k in range(1, round(PERIOD / FINEST)) if abs(spectrum[k]) > 1e-8]


def surface_shapes(seeds: str = "1,2,3", kinds: str = "bumps,steps,waves") -> None:
    """`force_wave` on drawn surfaces: RMS and largest error of the force, and the least force, by seed.

    The surface is displaced and tilted as in the scene. Bumps are 1 to 3 mm high and 25 to 50 mm wide (σ), steps 0.5 to
    2 mm high over 20 to 40 mm, waves random with a slope of 0.06 RMS down to 80 mm.
    """
    scene, draws = scene_of(ForceScene, "force_wave"), whole_numbers(seeds, "--seeds")
    head("surface", *(f"RMS N, seed {seed}" for seed in draws), *(f"least, largest N, seed {seed}" for seed in draws))
    for kind in kinds.split(","):
        runs: list[Any] = []
        for seed in draws:
            waves = as_waves(drawn(kind, np.random.default_rng(1000 + seed)))
            runs.append(run(scene.changed(seed=seed, gains=None, surface={"wave": waves}), method=IDEAL))
        row(kind, *(f"{result.figures.rms:.2f}{', ' + result.failure if result.failure else ''}" for result in runs),
            *(f"{result.figures.least:.1f}, {result.figures.largest:.1f}" for result in runs))
