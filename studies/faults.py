"""Faults of a cell's devices while the arm is led: what is done, how soon, how far the arm has moved meanwhile.

In lockstep with the simulated cell, so that the tables are the same every time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from planning.force.contact import most_force
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from studies.link_faults import FAULTS as LINKS
from studies.link_faults import play_link
from studies.report import head, keep, marked_page, plays_in, row, scene_of, write_tables
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
_NOTICED = {"sensor's gain is": "gain", "shows the same weight": "weight", "wrong sign": "weight",
            "does not turn": "weight", "lost the noise": "noise", "stuck": "stuck", "motor torques show": "motors",
            "leaps by": "leap", "not a contact force": "no push", "pulls with": "pull",
            "measured in the air": "in the air", "below the path's start": "depth", "surface without contact": "depth",
            "lies deeper": "forecast", "axes are not": "axes", "drifts by": "drift", "not done after": "time",
            "no contact within": "depth", "contact lost": "contact lost", "as the arm moves": "innovations",
            "it answers": "no answer", "above the limit": "limit", "allowed": "limit"}
"""What a failure says → the sign by which it was noticed."""
FROM = 70
"""Cycle of a controller in which its fault begins."""
_MARK = "faults of {}"
"""Of a table in the pages."""
MOST = 1.5
"""Largest acceleration of ours that a fault may come to, as a share of the arm's; controllers trip at twice it."""


def device_faults(tables: str = "force_wave,contour,glue,camera,arm,fanuc,egm,ros2", columns: str = "", only: str = "",
                  minutes: float = float("inf"), lines: Path | None = None, write: bool = False) -> None:
    """Faults x devices: by which sign each is noticed, how soon, how far the arm has moved, what a surface bears.

    A table for each device, a fault a row. Of force sensors (``force_wave``, ``contour``, ``glue``) the columns are the
    stages of the job in which it begins, and a cell says the sign, the largest true force on the surface since then,
    and how long after it the arm was at rest. Of cameras they are one that was calibrated and
    one that is believed as it was mounted: the largest distance of the tool from the line, time and way until it
    rests. Of an arm behind RSI, and of three makers' interfaces, see ``link_faults``.

    Each play is kept as a line of --lines and not repeated; after so many --minutes no other is begun. --write puts
    the table of force_wave between its marks in the page; the others have none. Exit code 1 where a
    surface bore more than 1.5 times the wanted force and more than 40 N, or an acceleration of ours is more than
    ``MOST`` of the arm's.

    Args:
        tables: with commas between.
        columns, only: of the tables and of the faults; with commas, and with semicolons between, all if empty.
        minutes: see above.
        lines: see above.
        write: see above.
    """
    kept = {tuple(cell["of"]): cell for cell in plays_in(lines)}
    begun = time.monotonic()
    if write:
        for name in tables.split(","):
            marked_page(_MARK.format(name))
    for name in tables.split(","):
        for fault, column, play in _cells_of(name):
            if (name, fault, column) in kept or (columns and column not in columns.split(",")) or (
                    only and fault not in only.split(";")) or time.monotonic() - begun > 60.0 * minutes:
                continue
            text, beyond = play()
            kept[name, fault, column] = cell = {"of": [name, fault, column], "text": text, "beyond": beyond}
            print(f"{name}, {fault}, {column}: {text}", file=sys.stderr, flush=True)
            keep(lines, cell)
    for name in tables.split(","):
        print(text := _table(name, kept), end="\n\n")
        if write:
            write_tables(_MARK.format(name), text)
    if any(cell["beyond"] for cell in kept.values()):
        sys.exit(1)


_Play = Callable[[], tuple[str, bool]]
"""What became of a fault, in words, and whether that is more than may be."""
_TITLES = {"camera": "the camera of `line`", "arm": "an arm behind RSI", "fanuc": "FANUC's emulated controller",
           "egm": "EGM", "ros2": "ROS 2"}


def _table(name: str, kept: dict[tuple[str, str, str], dict[str, Any]]) -> str:
    """The table of a device, and how many of its cells were played."""
    cells = [(fault, column) for fault, column, _ in _cells_of(name)]
    rows, columns = list(dict(cells)), list(dict.fromkeys(column for _, column in cells))
    played = sum((name, *cell) in kept for cell in cells)
    title = _TITLES.get(name, f"the force sensor of `{name}`")
    lines = [f"Faults of {title} ({played} of {len(cells)} played):", "",
             f"| fault | {' | '.join(columns)} |", "| --- " * (1 + len(columns)) + "|"]
    for fault in rows:
        told = [kept.get((name, fault, column), {"text": "–"})["text"] for column in columns]
        lines.append(f"| {fault} | {' | '.join(told)} |")
    return "\n".join(lines)


def _cells_of(name: str) -> Iterator[tuple[str, str, _Play]]:
    """Faults of a device, columns, and how each is played."""
    if name == "camera":
        for fault, calibrated in product(_CAMERA, (True, False)):
            yield fault, "calibrated" if calibrated else "by hand", partial(_camera, fault, calibrated)
    elif name == "arm":
        for fault in _ARM:
            yield fault, "what is said", partial(_arm, fault)
    elif name in LINKS:
        for fault in LINKS[name][2]:
            yield fault, "what is said", partial(_link, name, fault)
    elif name in ("force_wave", "contour", "glue"):
        for fault, stage in product(FAULTS, STAGES):
            yield fault, stage, partial(_force, name, fault, stage)
    else:
        raise InputError(f"expected of force_wave, contour, glue, camera, arm, {', '.join(LINKS)}", field="--tables",
                         value=name)


def _force(name: str, fault: str, stage: str) -> tuple[str, bool]:
    loaded = scene_of(ForceScene, name)
    with tempfile.TemporaryDirectory() as folder:
        run = followed(loaded, Path(folder), spoil=FAULTS[fault](), stage=stage)
    return _told(run), run.force > most_force(loaded.force)


def _told(run: SimpleNamespace) -> str:
    """What became of a run, in a cell of the table."""
    if run.failure is None:
        return f"{run.force:.0f} N, goes on"
    noticed = next((sign for words, sign in _NOTICED.items() if words in run.failure), run.failure[:60])
    return f"{noticed}: {run.force:.0f} N, {run.after:.1f} s"


def _camera(fault: str, calibrated: bool) -> tuple[str, bool]:
    loaded = scene_of(LineScene, "line")
    with tempfile.TemporaryDirectory() as folder:
        run = followed_by_eye(loaded, Path(folder), calibrated=calibrated, **_CAMERA[fault])  # type: ignore[arg-type]
    after = f"{run.after:.2f} s, {1e3 * run.moved:.0f} mm" if run.after > 0.0 else "before the line"
    return f"{_said(run.failure)}: {1e3 * run.beside.max(initial=0.0):.2f} mm, {after}", False


_TURNED, _STILL = np.array([1, 1, 1, -1, 1, 1.0]), np.array([1, 1, 1, 1, 1, 0.0])
_ARM: dict[str, tuple[Callable[[], dict[str, Any]], bool, int]] = {
    "a joint turns the other way": (lambda: {"gain": _TURNED}, False, 0),
    "the same, with relative corrections": (lambda: {"gain": _TURNED, "adds_up": True}, True, 0),
    "a joint stands still": (lambda: {"gain": _STILL}, False, 0),
    "the arm stands still (another tag)": (lambda: {"tag": "AKorr"}, False, 0),
    "absolute corrections are added up": (lambda: {"adds_up": True}, False, 0),
    "increments are taken as absolute": (dict, True, 0),
    "every motion is 1.6 times as large": (lambda: {"gain": np.full(6, 1.6)}, False, 0),
    "an encoder jumps by 40°": (lambda: {"measured": jump}, False, FROM),
    "encoders stand still": (lambda: {"measured": _Standing()}, False, FROM),
}
"""Faults of a controller behind RSI: what it is like, whether corrections are relative, the cycle it begins in."""


def _arm(fault: str) -> tuple[str, bool]:
    """In lockstep, 12 ms, on the path of the tests: from the fault's first cycle on."""
    like, relative, first = _ARM[fault]
    controller = LaggingController(HOME, **like())
    with tempfile.TemporaryDirectory() as folder:
        run = played(Path(folder), controller, relative=relative)
    commanded, share = np.array(controller.commanded)[first:], float(largest_acceleration(controller).max())
    return (f"{_said(run.failure)}: at rest after {controller.cycle * len(commanded):.2f} s, largest way of a joint "
            f"{np.ptp(commanded, axis=0).max():.1f}°, {share:.2f} of its acceleration"), share > MOST


def _link(name: str, fault: str) -> tuple[str, bool]:
    said, after, share, away, rests = play_link(name, fault)
    return (f"{said}: after {after or '–'} ms, {share} of its acceleration, {away} mrad from the path, "
            f"{'at rest' if rests == 'yes' else 'not at rest'}"), False


def sound_forces(scenes: str = "force_wave,contour,glue", speeds: str = "0", seeds: str = "1,2,3") -> None:
    """Force sensors without a fault: how near what they tell comes to each sign of a fault, as a share of its limit.

    A speed of 0 is the scene's. Of what a sensor is asked on the way it has to answer half at least. Exit code 1 where
    a sound one is stopped.
    """
    signs, stopped = ("motors", "sideways", "forecast"), 0
    head("scene", "speed [m/s]", "seed", *signs, "answers at least", "rms of the felt force [N]")
    for name, speed, seed in product(scenes.split(","), map(float, speeds.split(",")), map(int, seeds.split(","))):
        loaded = scene_of(ForceScene, name).changed(seed=seed)
        loaded = loaded.changed(speed=speed) if speed else loaded
        with tempfile.TemporaryDirectory() as folder:
            run = followed(loaded, Path(folder))
        stopped += run.failure is not None
        witness, rms = run.job.contact.witness, run.job.figures()["force_N"]["rms_error"]
        row(name, f"{loaded.speed:g}", str(seed), *(f"{witness.nearest.get(sign, 0.0):.2f}" for sign in signs),
            f"{run.job.contact.device.signs.answered:.2f}", run.failure or f"{rms:.2f}")
    if stopped:
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
