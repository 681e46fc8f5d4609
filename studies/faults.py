"""Faults of a cell's sensors while the arm is led: what is done, how soon, how far the arm has moved meanwhile."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from planning.force.contact import most_force
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from studies.report import head, row, scene_of
from tests.scenes.follow.eye_on_bench import followed as followed_by_eye
from tests.scenes.follow.eye_on_bench import shaken, shifted
from tests.scenes.follow.on_bench import FAULTS, STAGES, followed

_CAMERA = {"pictures moved by 2 pixels": {"picture": shifted(2)}, "pictures moved by 8 pixels": {"picture": shifted(8)},
           "pictures moved by 40 pixels": {"picture": shifted(40)}, "stamps within 20 ms": {"stamp": shaken(0.02)},
           "stamps within 50 ms": {"stamp": shaken(0.05)}}


def faults(scene: str = "force_wave", stages: str = ",".join(STAGES)) -> None:
    """Each fault of a force sensor from each stage of a job on: largest force, time and way to the stop, what is said.

    In lockstep with the simulated cell, so that the table is the same every time. Exit code 1 where the surface bore
    more than 1.5 times the wanted force, or 40 N.
    """
    loaded, worst = scene_of(ForceScene, scene), 0.0
    head("fault", "since", "largest force [N]", "stopped after [s]", "moved [mm]", "what is said")
    for fault in FAULTS:
        for stage in stages.split(","):
            with tempfile.TemporaryDirectory() as folder:
                run = followed(loaded, Path(folder), spoil=FAULTS[fault](), stage=stage)
            worst = max(worst, run.force)
            row(fault, stage, f"{run.force:.1f}", f"{run.after:.2f}", f"{1e3 * run.moved:.0f}", _said(run.failure))
    if worst > most_force(loaded.force):
        sys.exit(1)


def camera_faults(scene: str = "line") -> None:
    """Each fault of a camera: largest distance of the tool from the line, and what is said."""
    loaded = scene_of(LineScene, scene)
    head("fault", "calibrated", "largest distance [mm]", "what is said")
    for fault, spoilt in _CAMERA.items():
        for calibrated in (True, False):
            with tempfile.TemporaryDirectory() as folder:
                run = followed_by_eye(loaded, Path(folder), calibrated=calibrated, **spoilt)  # type: ignore[arg-type]
            farthest = f"{1e3 * run.beside.max(initial=0.0):.2f}"
            row(fault, "yes" if calibrated else "by hand", farthest, _said(run.failure))


def _said(failure: str | None) -> str:
    """The cause without the instant."""
    return (failure or "the job is done").partition(" s: ")[2][:110] or (failure or "the job is done")[:110]
