"""The line in the workshop: methods, how far ahead is told, latency, each cause of error alone, other shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scenes.commands.common import whole_numbers
from scenes.line.cell import prepared
from scenes.line.compare import best_gains
from scenes.line.kind import run
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.methods import ADAPTED, DIRECT, IDEAL, NONE, SENSOR_PATH
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import chosen
from studies.report import head, listed, row, scene_of

TITLES = {NONE: ("`none`: the reference path", "#8893a1"),
          DIRECT: ("`direct_feedback`: [L] (1) at its best gain", "#0a6ebd"),
          SENSOR_PATH: ("`sensor_path`: sensed path, no feedforward", "#2b8a3e"), IDEAL: ("`ideal`", "#e06a00"),
          ADAPTED: ("`adapted`: friction learned while the camera is calibrated and on the way", "#7d3c98"),
          "ideal_points": ("`ideal_points`: the map takes single points", "#1c2430")}
"""Method → title and colour in the picture."""
ONE = ("`ideal`, n_d = 1", "#c2255c")
"""The ideal robot that is given the next desired position alone ([L] 2.3)."""


def methods(seed: int = 1, speed: float | None = None, figure: Path | None = None) -> None:
    """Every method, adapted and with n_d = 1 besides: table, and a picture into --figure.

    Direct sensor feedback has the best gains that a search on this very scene finds.
    """
    scene = chosen(scene_of(LineScene, "line"), seed=seed, speed=speed)
    with prepared(scene) as shared:
        gains, _ = best_gains(scene, shared)
        runs = {title: play(scene, key, shared=shared, gains=gains) for key, title in TITLES.items()}
        runs[ONE] = play(scene.changed(n_d=1), IDEAL, shared=shared)
    head("method, in the workshop", "mean mm", "95 % mm", "max mm")
    for (title, _), result in runs.items():
        error = result.control_error.json_mm()
        row(title, *(f"{error[key]:.3f}" for key in ("mean", "p95", "max")))
    early = [title for (title, _), result in runs.items() if result.failure]
    print(f"\nseed {seed}, {scene.speed:g} m/s; direct feedback: K_p = {gains[0]:.3g}, K_d = {gains[1]:.3g}; "
          f"ended early: {', '.join(early) or 'none'}")
    if figure is not None:
        figure.parent.mkdir(parents=True, exist_ok=True)
        _picture(runs).savefig(figure, dpi=120, bbox_inches="tight")


def _picture(runs: dict[tuple[str, str], LineResult]) -> Figure:
    """Distance from the line along the line, on two scales, and each method's mean."""
    figure = Figure(figsize=(9.0, 5.6))
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    for (title, colour), result in runs.items():
        error = result.control_error
        for axis in axes:
            axis.plot(error.s, 1e3 * error.lateral, color=colour, lw=1.1,
                      label=f"{title.partition(':')[0].replace('`', '')}: {1e3 * error.mean:.2f} mm")
    axes[0].set_title("Distance of the tool from the drawn line, and its mean", loc="left", fontsize=10)
    axes[0].set_ylabel("mm")
    axes[1].set_ylabel("the same, enlarged [mm]")
    axes[1].set_ylim(-1.2, 1.2)
    axes[1].set_xlabel("way along the line [m]")
    for axis in axes:
        axis.axhline(0.0, color="#1c2430", lw=0.5)
        axis.spines[["top", "right"]].set_visible(False)
    ends = np.concatenate([result.control_error.s[[0, -1]] for result in runs.values() if len(result.control_error.s)])
    axes[1].set_xlim(float(ends.min()), float(ends.max()))
    axes[0].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.0))
    return figure


def horizon(seeds: int = 3) -> None:
    """Mean error in mm over n_d, the desired positions that the ideal robot is given in each cycle ([L] 2.2, 2.3)."""
    played = [(SENSOR_PATH, 1), *((IDEAL, n_d) for n_d in (1, 2, 3, 4, 6, 25))]
    means = np.empty((len(played), seeds))
    for seed in range(1, seeds + 1):
        scene = scene_of(LineScene, "line").changed(seed=seed)
        with prepared(scene) as shared:
            for i, (method, n_d) in enumerate(played):
                means[i, seed - 1] = _mean(run(scene.changed(n_d=n_d), method=method, shared=shared))
    head("method", "n_d", *(f"seed {seed}" for seed in range(1, seeds + 1)))
    for (method, n_d), values in zip(played, means, strict=True):
        row(f"`{method}`", n_d, *(f"{value:.3f}" for value in values))


def latency() -> None:
    """Mean error in mm over the camera's latency: the ideal robot, and direct sensor feedback with K_p = 0.09."""
    head("latency ms", "`ideal`", "`direct_feedback`, K_p = 0.09")
    for late in (0.02, 0.04, 0.08):
        scene = scene_of(LineScene, "line").changed(camera={"latency": late})
        ideal, direct = run(scene, method=IDEAL), run(scene, method=DIRECT, gains=(0.09, 0.0))
        row(f"{1e3 * late:.0f}", f"{_mean(ideal):.3f}", f"{_mean(direct):.2f}")


def _mean(result: LineResult) -> float:
    return float("nan") if result.failure else 1e3 * result.control_error.mean


def causes(seeds: int = 3, individual: int | None = None) -> None:
    """What stands between the kind bench and the workshop: each cause alone, then all.

    The world of an individual with kinematic errors is another one to the identification too, so models are its own.
    """
    workshop = scene_of(LineScene, "line")
    line, wear, camera = workshop.changed(world="bench"), workshop.workshop["wear"], workshop.workshop["camera"]

    def worn(*keys: str) -> dict[str, Any]:
        return {"wear": {key: wear[key] for key in keys}}

    changes: dict[str, dict[str, Any]] = {
        "none (`bench`)": {},
        "kinematic errors, 0.3 mm and 0.02°": {"world": workshop.arm_world},
        "surface off by 3 mm": {"displacement": {"height_mm": 3.0}},
        "surface tilted by 1°": {"displacement": {"tilt_deg": 1.0}},
        "rendered, tool and hose in the picture": {"camera": {"renderer": "bullet"}},
        "the same, surface bent by 1 mm": {"displacement": {"bow_mm": 1.0}, "camera": {"renderer": "bullet"}},
        "width and ink of the line": worn("width_percent", "fade_percent"), "gaps": worn("gaps"),
        "scratch and crossing": worn("scratches", "crossings"), "glare and shade": worn("glares", "shades"),
        "lamp: falloff, the arm's shadow, mirror image": {"light": workshop.workshop["light"]},
        "exposure that lags": {"camera": {"auto_exposure": camera["auto_exposure"]}},
        "fields jittered, lost and doubled": {"camera": {key: camera[key] for key in ("jitter", "loss", "doubled")}},
    }
    head("cause", f"mean mm, seeds 1 to {seeds}", "largest mm", "fields used, least", "constant beside the line mm",
         "tool above the surface mm")
    scenes = {name: line.changed(**change) for name, change in changes.items()} | {"all (`workshop`)": workshop}
    for name, scene in scenes.items():
        runs = [run(chosen(scene, seed=seed, individual=individual)) for seed in range(1, seeds + 1)]
        row(name, listed(map(_mean, runs)), f"{1e3 * np.max([result.control_error.max for result in runs]):.2f}",
            min(result.fields_used for result in runs),
            listed(1e3 * float(np.mean(result.control_error.lateral)) for result in runs),
            listed((1e3 * _height(result) for result in runs), 2))


def _height(result: LineResult) -> float:
    """Mean height of the true tool above the even surface while the error counts [m]."""
    columns, plane = result.recording.columns, result.geometry.plane
    counts = np.isin(np.round(columns["t"], 6), np.round(result.control_error.t, 6))
    tcp = np.column_stack([columns[axis][counts] for axis in "xyz"])
    return float(np.mean((tcp - plane.translation) @ plane.rotation[:, 2]))


LENGTH = 1.2
"""Of a line drawn freehand [m]."""
STEEPEST, TIGHTEST = np.tan(np.radians(30.0)), 6.0
"""Largest slope of such a line against its straight reference, and largest curvature [1/m]: 3 m/s² at 0.7 m/s."""


def freehand(size: float, rng: np.random.Generator) -> list[list[float]]:
    """Points of a smooth random line over a straight one ``(N, 2)`` [m], at most ``size`` [m] beside it.

    A sum of waves of random sizes and phases, no family of the follower's. It is less far off where it would otherwise
    be too steep or too tight.
    """
    x = np.linspace(0.0, LENGTH, 601)
    k = np.arange(1, 9)
    sizes = rng.standard_normal((2, len(k))) * np.exp(-0.5 * (k / 3.0) ** 2)
    angle = np.outer(k, 2.0 * np.pi * x / (1.3 * LENGTH))
    y = sizes[0] @ np.cos(angle) + sizes[1] @ np.sin(angle)
    slope = np.gradient(y, x)
    y *= min(size / np.abs(y).max(), STEEPEST / np.abs(slope).max(), TIGHTEST / np.abs(np.gradient(slope, x)).max())
    return np.column_stack([x, y]).tolist()


def line_shapes(sizes: str = "10,25,50", seeds: str = "1-20") -> None:
    """`line` drawn freehand before a straight reference: the tool's distance, by how far it leaves the reference.

    The line is displaced and turned as in the scene besides. On seeds 1 to 20 nothing was chosen.
    """
    scene, draws = scene_of(LineScene, "line"), whole_numbers(seeds, "--seeds")
    head("farthest from the reference mm", "runs", "mean mm", "worst run's mean", "largest", "steepest °", "stopped")
    for size in whole_numbers(sizes, "--sizes"):
        runs, steepest = [], 0.0
        for seed in draws:
            points = freehand(1e-3 * size, np.random.default_rng(10_000 * size + seed))
            steepest = max(steepest, float(np.abs(np.diff(points, axis=0) @ [0.0, 1.0]).max()) / (LENGTH / 600))
            runs.append(run(scene.changed(seed=seed, line={"formula": None, "length": None, "points": points},
                                  reference={"shape": {"points": [[0.0, 0.0], [LENGTH, 0.0]]}})))
        means = [1e3 * one.control_error.mean for one in runs]
        row(size, len(runs), f"{np.nanmean(means):.3f}", f"{np.nanmax(means):.3f}",
            f"{1e3 * np.nanmax([one.control_error.max for one in runs]):.2f}", f"{np.degrees(np.arctan(steepest)):.0f}",
            sum(one.failure is not None for one in runs))
