"""Faults of a cell's devices while the arm is led: what is done, how soon, how far the arm has moved meanwhile.

In lockstep with the simulated cell, so that the tables are the same every time.
"""

from __future__ import annotations

import sys
import tempfile
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from planning.force.contact import most_force
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from studies.report import head, row, scene_of
from tests.scenes.follow.eye_on_bench import black, frozen, held, mirrored, shaken, shifted
from tests.scenes.follow.eye_on_bench import followed as followed_by_eye
from tests.scenes.follow.on_bench import FAULTS, STAGES, followed
from tests.scenes.rsi.test_faults import HOME, jump, largest_acceleration, played
from tests.sim.devices.controllers import LaggingController

_CAMERA = {"pictures moved by 2 pixels": {"picture": shifted(2)}, "pictures moved by 8 pixels": {"picture": shifted(8)},
           "pictures moved by 40 pixels": {"picture": shifted(40)}, "black": {"picture": black},
           "mirrored": {"picture": mirrored}, "the same picture for ever": {"picture": frozen()},
           "stamps within 20 ms": {"stamp": shaken(0.02)}, "stamps within 50 ms": {"stamp": shaken(0.05)},
           "stamps that stand still": {"stamp": held}}
_NOTICED = {"sensor's gain is": "gain",
            "weigh the same": "weight", "wrong sign": "weight", "does not turn": "weight", "lost the noise": "noise",
            "stuck": "stuck", "motors feel": "motors", "leaps by": "leap", "which is no push": "no push",
            "pull with": "pull", "felt in the air": "in the air", "below the path's start": "depth",
            "felt none": "depth", "lies deeper": "forecast", "axes are not": "axes", "drifts by": "drift",
            "not done after": "time", "no contact within": "depth", "contact lost": "contact lost",
            "as the arm moves": "innovations", "it answers": "no answer", "above the limit": "limit",
            "allowed": "limit"}
"""What a failure says → the sign by which it was noticed."""
FROM = 70
"""Cycle of a controller in which its fault begins."""


def faults(scenes: str = "force_wave,contour,glue", stages: str = ",".join(STAGES), only: str = ";".join(FAULTS),
           speed: float = 0.0) -> None:
    """Faults of a force sensor from each stage of a job on: sign by which it is noticed, largest force, time, way.

    A table for each scene: a fault a row, the stage in which it begins a column; the true force on the surface since
    then, how long after it the arm was stopped, how far the tip moved. Exit code 1 where the surface bore more than 1.5
    times the wanted force and more than 40 N. ``only`` takes faults with semicolons between them; with a ``speed``
    [m/s] below the scene's the job is longer.
    """
    too_much = 0
    for name in scenes.split(","):
        loaded = scene_of(ForceScene, name)
        loaded = loaded.changed(speed=speed) if speed else loaded
        print(f"\n{name}, {loaded.force:.0f} N wanted\n")
        head(name, *stages.split(","))
        for fault in only.split(";"):
            cells = []
            for stage in stages.split(","):
                with tempfile.TemporaryDirectory() as folder:
                    run = followed(loaded, Path(folder), spoil=FAULTS[fault](), stage=stage)
                print(f"{name}, {fault}, {stage}: {run.force:.1f} N, {run.failure}", file=sys.stderr, flush=True)
                too_much += run.force > most_force(loaded.force)
                cells.append(_told(run))
            row(fault, *cells)
    if too_much:
        sys.exit(1)


def _told(run: SimpleNamespace) -> str:
    """What became of a run, in a cell of the table."""
    if run.failure is None:
        return f"{run.force:.0f} N, goes on"
    noticed = next((sign for words, sign in _NOTICED.items() if words in run.failure), run.failure[:60])
    return f"{noticed}: {run.force:.0f} N, {run.after:.1f} s, {1e3 * run.moved:.0f} mm"


def sound_forces(scenes: str = "force_wave,contour,glue", speeds: str = "0", seeds: str = "1,2,3") -> None:
    """Force sensors without a fault: how near what they tell comes to each sign of a fault, as a share of its limit.

    A speed of 0 is the scene's. What a sensor answers of what it is asked on the way is hidden by noise with some
    probability: 1e-06 stops. Exit code 1 where a sound one is stopped.
    """
    signs, stopped = ("motors", "sideways", "forecast"), 0
    head("scene", "speed [m/s]", "seed", *signs, "answers hidden", "rms of the felt force [N]")
    for name, speed, seed in product(scenes.split(","), map(float, speeds.split(",")), map(int, seeds.split(","))):
        loaded = scene_of(ForceScene, name).changed(seed=seed)
        loaded = loaded.changed(speed=speed) if speed else loaded
        with tempfile.TemporaryDirectory() as folder:
            run = followed(loaded, Path(folder))
        stopped += run.failure is not None
        witness, rms = run.job.contact.witness, run.job.figures()["force_N"]["rms_error"]
        row(name, f"{loaded.speed:g}", str(seed), *(f"{witness.nearest.get(sign, 0.0):.2f}" for sign in signs),
            f"{np.exp(run.job.contact.device.signs.unanswered):.0e}", run.failure or f"{rms:.2f}")
    if stopped:
        sys.exit(1)


def camera_faults(scene: str = "line") -> None:
    """Faults of a camera: largest distance of the tool from the line, time and way until it rests, what is said."""
    loaded = scene_of(LineScene, scene)
    head("fault", "camera", "largest distance [mm]", "at rest after [s]", "moved [mm]", "what is said")
    for fault, spoilt in _CAMERA.items():
        for calibrated in (True, False):
            with tempfile.TemporaryDirectory() as folder:
                run = followed_by_eye(loaded, Path(folder), calibrated=calibrated, **spoilt)  # type: ignore[arg-type]
            row(fault, "calibrated" if calibrated else "by hand", f"{1e3 * run.beside.max(initial=0.0):.2f}",
                f"{run.after:.2f}" if run.after > 0.0 else "before the line", f"{1e3 * run.moved:.0f}",
                _said(run.failure))


def arm_faults() -> None:
    """Faults of an arm behind RSI: what is said, after how long, how far it has moved, with which acceleration.

    Of a controller in lockstep, 12 ms, on the path of the tests: from the first cycle on, or from the seventieth where
    the fault is one of what is measured. Exit code 1 where an acceleration of ours is above the arm's.
    """
    head("fault", "corrections", "at rest after [s]", "largest way of a joint [°]", "largest acceleration / allowed",
         "what is said")
    turned, still = np.array([1, 1, 1, -1, 1, 1.0]), np.array([1, 1, 1, 1, 1, 0.0])
    cases: dict[str, tuple[dict, bool, int]] = {
        "a joint turns the other way": ({"gain": turned}, False, 0),
        "the same": ({"gain": turned, "adds_up": True}, True, 0),
        "a joint stands still": ({"gain": still}, False, 0),
        "the arm stands still (another tag)": ({"tag": "AKorr"}, False, 0),
        "absolute corrections are added up": ({"adds_up": True}, False, 0),
        "increments are taken as absolute": ({}, True, 0),
        "every motion is 1.6 times as large": ({"gain": np.full(6, 1.6)}, False, 0),
        "an encoder jumps by 40°": ({"measured": jump}, False, FROM),
        "encoders stand still": ({"measured": _Standing()}, False, FROM),
    }
    worst = 0.0
    for fault, (like, relative, first) in cases.items():
        controller = LaggingController(HOME, **like)
        with tempfile.TemporaryDirectory() as folder:
            run = played(Path(folder), controller, relative=relative)
        commanded = np.array(controller.commanded)[first:]
        share = float(largest_acceleration(controller).max())
        worst = max(worst, share)
        row(fault, "relative" if relative else "absolute", f"{controller.cycle * len(commanded):.2f}",
            f"{np.ptp(commanded, axis=0).max():.1f}", f"{share:.2f}", _said(run.failure))
    if worst > 1.0:
        sys.exit(1)


class _Standing:
    """Encoders that tell the same from a cycle on."""

    def __init__(self) -> None:
        self._last = HOME

    def __call__(self, cycle: int, measured: np.ndarray) -> np.ndarray:
        self._last = measured if cycle < FROM else self._last
        return self._last


def _said(failure: str | None) -> str:
    """The cause without the instant."""
    cause = failure or "the job is done"
    return (cause.partition(" s: ")[2] or cause)[:110]
