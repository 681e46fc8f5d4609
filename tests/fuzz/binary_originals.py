"""Sound files in binary formats that fuzzing breaks: pictures, a film, bags."""

from __future__ import annotations

import io
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from ideal_robot.signals.recording import Recording
from ideal_robot.signals.ros_export import write_mcap, write_rosbag2
from scenes.report.replay import write_replay
from scenes.view.viewer import replay_of_columns
from tests.fuzz import mutate_table, mutate_text, originals

PICTURES = (".png", ".jpg", ".bmp", ".tif", ".webp", ".pgm")


@cache
def picture(ending: str) -> bytes:
    """A dark line on light ground, 160 × 120 pixels, as a file with that ending."""
    return cv2.imencode(ending, _drawn(0))[1].tobytes()


@cache
def film() -> bytes:
    """Six such pictures, the line moving, as an AVI file of JPEGs."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "film.avi"
        film = cv2.VideoWriter(str(place), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (160, 120))
        for shift in range(6):
            film.write(cv2.cvtColor(_drawn(shift), cv2.COLOR_GRAY2BGR))
        film.release()
        return place.read_bytes()


def blank(height: int, width: int) -> bytes:
    """A black picture of that size as PNG: few bytes in the file, many in memory."""
    return cv2.imencode(".png", np.zeros((height, width), dtype=np.uint8))[1].tobytes()


@cache
def bag(folder: Path, *, mcap: bool) -> bytes:
    """The small arm's recording as an MCAP file, or the database of a ROS 2 bag.

    Args:
        folder: for the sound files; any that lasts.
        mcap: the one or the other.
    """
    recording = Recording(dict(originals.motion(folder)), {}, "small arm")
    with tempfile.TemporaryDirectory() as there:
        if mcap:
            return write_mcap(recording, Path(there) / "r.mcap").read_bytes()
        return next(write_rosbag2(recording, Path(there) / "bag").glob("*.db3")).read_bytes()


def broken_replay(folder: Path, rng: np.random.Generator) -> bytes:
    """The replay of the small arm's motion with bytes of it changed, or one of its arrays of another shape or kind.

    Args:
        folder: for the sound files; any that lasts.
        rng: draws what is broken.
    """
    raw = _replay(folder)
    if rng.random() < 0.5:
        return mutate_text.mutated(raw, rng)
    with np.load(io.BytesIO(raw)) as file:
        arrays = dict(file)
    name = list(arrays)[rng.integers(len(arrays))]
    others = (np.zeros(0), np.zeros(3), np.zeros((2, 2)), np.full((500, 3), np.nan), np.zeros((500, 7)), np.array("x"),
              np.array("{}"), np.arange(500.0)[::-1], np.full(500, 1e300), np.zeros((1, 1, 1)))
    arrays[name] = others[rng.integers(len(others))]
    if rng.random() < 0.2:
        del arrays[name]
    made = io.BytesIO()
    np.savez_compressed(made, **arrays)
    return made.getvalue()


@cache
def _replay(folder: Path) -> bytes:
    arm = originals.arm(folder)
    with tempfile.TemporaryDirectory() as there:
        (Path(there) / "r.csv").write_bytes(mutate_table._csv(originals.motion(folder)))
        recording = Recording.read(Path(there) / "r.csv")
        replay = replace(replay_of_columns(arm, recording), pictures=((0.0, picture(".png")),),
                         surface=np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]))
        return write_replay(replay, Path(there) / "r.replay.npz", recording).read_bytes()


def _drawn(shift: int) -> np.ndarray:
    gray = np.full((120, 160), 200, dtype=np.uint8)
    cv2.line(gray, (60 + shift, 0), (90 + shift, 119), 40, 6)
    return gray
