"""What scenes of kind ``clamped`` offer: clamp, push, record and identify, by one method or both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
from scenes.arms import arm_of
from scenes.clamped.page import stiffness_page
from scenes.clamped.play import ClampedResult, configurations, record
from scenes.kind import SceneKind
from scenes.methods import method_of
from scenes.outputs import whole_folder
from scenes.result import Progress, silent
from scenes.scene_files.clamped_scene import ClampedScene
from sim.contact.clamp_world import ClampWorld

METHODS = ("motor", "wrench", "both")


def run(scene: ClampedScene, *, method: Any = None, out: Path | None = None,
        progress: Progress = silent) -> ClampedResult:
    """Clamps, pushes, records, identifies.

    Args:
        scene: what to play.
        method: ``motor``, ``wrench`` or ``both``, which is the default.
        out: folder for recordings and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: no such method, or a scene that cannot be played.
    """
    chosen = method_of(method or "both", METHODS).key
    robot = arm_of(scene.robot)
    world = ClampWorld.from_table(robot, scene.arm_world, scene.source)
    rng = np.random.default_rng(scene.seed)
    progress(0.05, "choosing configurations")
    postures = configurations(scene, robot, rng)
    recordings, truths = record(scene, robot, world, postures, rng)
    progress(0.4, "identifying")
    analysis = analyse_stiffness(recordings, robot, chosen)
    progress(0.7, "drawing")
    files: tuple[Path, ...] = ()
    page = None
    if out is not None:
        names = ["recording.parquet", *(f"recording_{i}.parquet" for i in range(2, len(recordings) + 1))]
        with whole_folder(out) as new:
            for one, name in zip(recordings, names, strict=True):
                one.write(new / name)
            stiffness_page(analysis, title=scene.title, truth=world.stiffness).write(new / "report.html")
        files, page = tuple(out / name for name in names), out / "report.html"
    return ClampedResult(scene, analysis, tuple(truths), files, postures, page)


def compare(scene: ClampedScene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
            progress: Progress = silent) -> ClampedResult:
    """The methods (and payloads, where the scene has them) side by side.

    Args:
        scene: what to play.
        methods: one of ``motor`` and ``wrench``, or both; both if None.
        out: folder for recordings and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: no such method, or a scene that cannot be played.
    """
    return run(scene, method=methods[0] if methods and len(methods) == 1 else "both", out=out, progress=progress)


def _methods() -> tuple[str, ...]:
    return METHODS


CLAMPED = SceneKind(ClampedScene, _methods, run, compare)
