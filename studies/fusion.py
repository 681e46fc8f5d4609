"""The filter that fuses: the library's beside the two textbook lines it replaced, and beside its banks of filters."""

from __future__ import annotations

import copy
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter, MMAEFilterBank

from ideal_robot.arrays import Array
from planning.force.force_follower import surface_filter
from planning.line import hypotheses as fusing
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement
from scenes import load_scene
from scenes.commands.common import numbers, whole_numbers
from scenes.force.cell import true_surface
from scenes.line.kind import run as run_line
from scenes.methods import IDEAL
from scenes.play import run_scene as run
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene
from studies.report import head, row, scene_of


class TextbookFilter:
    """State and covariance with Joseph's update and nothing else: what fused before the library did.

    Args:
        dim_x: number of states.
        dim_z: not needed.
    """

    def __init__(self, dim_x: int, dim_z: int) -> None:
        del dim_z
        self.F, self.Q = np.eye(dim_x), np.eye(dim_x)
        self.x, self.P = np.zeros(dim_x), np.eye(dim_x)
        self._unit = np.eye(dim_x)

    def predict(self, F: Array, Q: Array) -> None:
        """x ← F x, P ← F P Fᵀ + Q."""
        self.x = np.dot(F, self.x)
        self.P = np.dot(np.dot(F, self.P), F.T) + Q

    def update(self, z: Array, R: Array, H: Array) -> None:
        """Takes in values ``z (m,)`` with covariance ``R (m, m)`` and rows ``H (m, k)``."""
        innovation = z - np.dot(H, self.x)
        PHT = np.dot(self.P, H.T)
        K = np.dot(PHT, np.linalg.inv(np.dot(H, PHT) + R))
        self.x = self.x + np.dot(K, innovation)
        remainder = self._unit - np.dot(K, H)
        self.P = np.dot(np.dot(remainder, self.P), remainder.T) + np.dot(np.dot(K, R), K.T)

    rts_smoother = KalmanFilter.rts_smoother


@dataclass
class Taken:
    """What one filter was given in a run: how it was made, and the calls in their order."""

    made: tuple[tuple[Any, ...], dict[str, Any]]
    calls: list[tuple[str, Any]] = field(default_factory=list)

    def fresh(self) -> DeviationFilter:
        """Such a filter before any call."""
        (model, *rest), named = copy.deepcopy(self.made)
        return DeviationFilter(model, *rest, **named)

    def measurements(self) -> Iterator[tuple[DeviationFilter, Measurement]]:
        """The measurements, with a filter that travels along and is given none."""
        filter_ = self.fresh()
        for name, argument in self.calls:
            if name == "travel":
                filter_.travel(argument)
            else:
                yield filter_, argument


@contextmanager
def recorded() -> Iterator[list[Taken]]:
    """Writes down what every filter is given meanwhile."""
    every: list[Taken] = []
    by_filter: dict[int, Taken] = {}
    inner = DeviationFilter.__init__, DeviationFilter.travel, DeviationFilter.take

    def make(self: DeviationFilter, *arguments: Any, **named: Any) -> None:
        by_filter[id(self)] = Taken((copy.deepcopy(arguments), dict(named)))
        every.append(by_filter[id(self)])
        inner[0](self, *arguments, **named)

    def travel(self: DeviationFilter, s: float) -> None:
        by_filter[id(self)].calls.append(("travel", s))
        inner[1](self, s)

    def take(self: DeviationFilter, measurement: Measurement) -> Fused:
        by_filter[id(self)].calls.append(("update", measurement))
        return inner[2](self, measurement)

    with (patch.object(DeviationFilter, "__init__", make), patch.object(DeviationFilter, "travel", travel),
          patch.object(DeviationFilter, "take", take)):
        yield every


@dataclass
class Replayed:
    """What a filter decided about each measurement, the map after each, and the time of an update."""

    decisions: list[tuple[tuple[bool, ...], str]]
    map: Array
    seconds: float


def replayed(taken: Taken, kind: type) -> Replayed:
    """Plays recorded measurements into a filter of this kind."""
    with patch.object(fusing, "KalmanFilter", kind):
        filter_, decisions, maps, used = taken.fresh(), [], [], 0.0
        s = 0.0
        for name, argument in taken.calls:
            if name == "travel":
                filter_.travel(argument)
                s = argument
                continue
            begun = time.perf_counter()
            fused = filter_.update(argument)
            used += time.perf_counter() - begun
            decisions.append((tuple(bool(flag) for flag in fused.used), fused.reason))
            maps.append(filter_.mean(np.array([s, s + 0.05])).ravel())
    return Replayed(decisions, np.array(maps), used / max(len(decisions), 1))


def shipped() -> dict[str, Scene]:
    """The scenes whose measurements are compared, with what knocks a camera and what breaks a map."""
    line = scene_of(LineScene, "line")
    scenes: dict[str, Scene] = {f"`{name}`": load_scene(name) for name in
                                ("line", "straight", "corner", "gap", "cluttered", "svg", "force_wave", "glue")}
    scenes["`line`, another arm"] = line.changed(seed=2)
    scenes["`line`, 1.5 m/s"] = line.changed(speed=1.5)
    scenes["`line`, camera knocked by 0.5°"] = line.changed(camera={"knock_deg": 0.5})
    scenes["`line`, on the bench, knocked by 2°"] = line.changed(world="bench", camera={"knock_deg": 2.0})
    return scenes


def _error(result: Any) -> float:
    return float(result.figures.rms if hasattr(result, "figures") else 1e3 * result.control_error.mean)


def fusion() -> None:
    """Recorded measurements of twelve scenes through the library's filter and the one before: decisions and maps.

    Each scene is played with the library's filter, what its filters were given is played again into both, and the
    scene is played once more with the one before. Errors: mm from the line, N of force scenes.
    """
    head("scene", "measurements", "used", "left out", "map replaced", "sensor moved", "decisions that differ",
         "largest difference of the maps [µm]", "error, library", "error before")
    for name, scene in shipped().items():
        with recorded() as every:
            now = run(scene, method=IDEAL)
        with patch.object(fusing, "KalmanFilter", TextbookFilter):
            before = run(scene, method=IDEAL)
        taken = max(every, key=lambda record: len(record.calls))
        library, textbook = replayed(taken, KalmanFilter), replayed(taken, TextbookFilter)
        reasons = [reason for _, reason in library.decisions]
        row(name, len(reasons), sum(any(used) for used, _ in library.decisions),
            sum(not any(used) for used, _ in library.decisions), reasons.count("map replaced"),
            reasons.count("sensor moved"),
            sum(a != b for a, b in zip(library.decisions, textbook.decisions, strict=True)),
            f"{1e6 * np.abs(library.map - textbook.map).max():.2g}", f"{_error(now):.4f}", f"{_error(before):.4f}")


PROBE = """
import sys, time, types
if sys.argv[1] == "before":
    class KalmanFilter: pass
    package, module = types.ModuleType("filterpy"), types.ModuleType("filterpy.kalman")
    module.KalmanFilter = KalmanFilter
    sys.modules |= {"filterpy": package, "filterpy.kalman": module}
begun = time.process_time()
import scenes.commands.devices
from scenes.online.run import load_cell
[load_cell(name) for name in ("line", "glue")]
from studies.report import resident
print(resident(), time.process_time() - begun)
"""


def fusion_cost(repeats: int = 5) -> None:
    """What the library costs: memory and start of the process that leads an arm, an update, a cycle of `line`."""
    lines: dict[str, list[list[float]]] = {"before": [], "library": []}
    for _ in range(repeats):
        for which, figures in lines.items():
            done = subprocess.run([sys.executable, "-c", PROBE, which], capture_output=True, text=True, check=True)
            figures.append([float(number) for number in done.stdout.split()])
    scene = scene_of(LineScene, "line").changed(world="bench")
    with recorded() as every:
        run_line(scene)
    taken = max(every, key=lambda record: len(record.calls))
    kinds = {"before": TextbookFilter, "library": KalmanFilter}
    for _ in range(repeats):
        for which, kind in kinds.items():
            with patch.object(fusing, "KalmanFilter", kind):
                timing = run_line(scene).timing.json_ms()
            lines[which].append([1e6 * replayed(taken, kind).seconds, timing["median_with_field"], timing["p99"]])
    head("filter", "memory of the process [MiB]", "processor time of its start [s]", "an update with its gates [µs]",
         "a cycle with a field, median [ms]", "of all cycles, p99 [ms]")
    for which, figures in lines.items():
        process, cycles = figures[:repeats], figures[repeats:]
        middle = [statistics.median(column) for part in (process, cycles) for column in zip(*part, strict=True)]
        row(which, f"{middle[0]:.0f}", f"{middle[1]:.2f}", f"{middle[2]:.0f}", f"{middle[3]:.2f}", f"{middle[4]:.2f}")


SWITCH = 0.01
"""Probability with which a bank's sensor is moved between two measurements."""


def _bank(taken: Taken, kind: str) -> tuple[list[float], Array, float]:
    """Recorded measurements in a bank of two: sensor as it was, and its errors drawn anew at each measurement."""
    filter_ = taken.fresh()
    entries, errors = filter_.hypotheses.moved["camera"]
    sigmas = np.square(errors)
    members = [filter_._fresh().kf for _ in range(2)]
    size, p, used, off = filter_._size, [], 0.0, []
    for member in members:
        member.Q = np.zeros((size, size))
    members[1].F[entries, entries] = 0.0
    members[1].Q[entries, entries] = np.diag(sigmas)
    switch = np.array([[1.0 - SWITCH, SWITCH], [1.0 - SWITCH, SWITCH]])
    bank = (IMMEstimator(members, (1.0 - SWITCH, SWITCH), switch) if kind == "IMM"
            else MMAEFilterBank(members, [1.0 - SWITCH, SWITCH], dim_x=size))
    begin, own = filter_.model.begin, taken.fresh()
    for travelled, measurement in taken.measurements():
        while begin < travelled.model.begin - 1e-9:
            F, Q = np.eye(size), np.zeros((size, size))
            block = slice(0, travelled.model.size)
            F[block, block], Q[block, block] = travelled.model._F, travelled.model._Q  # type: ignore[attr-defined]
            for member in members:
                member.predict(F=F, Q=Q)
            begin += travelled.model._knot  # type: ignore[attr-defined]
            own.travel(begin + travelled.model._behind)  # type: ignore[attr-defined]
        own.update(measurement)
        H, begun = travelled._rows(measurement), time.perf_counter()
        bank.predict()
        if kind == "IMM":
            for member in members:
                member.H, member.R, member.dim_z = H, measurement.covariance, len(H)
            bank.update(measurement.value)
        else:
            bank.update(measurement.value, R=measurement.covariance, H=H)
        used += time.perf_counter() - begun
        p.append(float((bank.mu if kind == "IMM" else bank.p)[1]))
        rows = H[:, : travelled.model.size]
        off.append(float(np.abs(rows @ (bank.x[: travelled.model.size] - own.state)).max()))
    return p, np.array(off), used / len(p)


def fusion_banks() -> None:
    """Four gates and hypotheses that begin when they are needed, beside the library's IMM and MMAE on the same data.

    A bank holds two filters, the sensor as it was and with its errors drawn anew. It says *moved* where the second is
    likelier than not. Its map is held against ours where both were measured.
    """
    head("measurements of", "estimator", "sensor said to be moved", "measurements left out",
         "map apart from ours, median, largest [µm]", "an update [µs]")
    for name in ("`line`", "`cluttered`", "`line`, camera knocked by 0.5°"):
        with recorded() as every:
            run(shipped()[name], method=IDEAL)
        taken = max(every, key=lambda record: len(record.calls))
        replayed(taken, KalmanFilter)  # compiles
        ours = replayed(taken, KalmanFilter)
        row(name, "gates and hypotheses", sum(reason == "sensor moved" for _, reason in ours.decisions),
            sum(not any(used) for used, _ in ours.decisions), "", f"{1e6 * ours.seconds:.0f}")
        for kind in ("IMM", "MMAE"):
            p, off, seconds = _bank(taken, kind)
            row("", kind, sum(share > 0.5 for share in p), 0, f"{1e6 * np.median(off):.0f}, {1e6 * off.max():.0f}",
                f"{1e6 * seconds:.0f}")


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
