"""The replay of a run in a file beside its recording, for the viewer: what the recording's columns do not say."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.report.replay import Replay

ENDING = ".replay.npz"
_LARGEST = 1_000_000_000
"""Bytes that a replay may unpack to."""
_ARRAYS = ("t", "q", "tool", "wanted", "error", "surface", "ghost", "force")


def replay_beside(recording: Path) -> Path:
    """Where the replay of a recording is."""
    return recording.with_name(recording.stem + ENDING)


def write_replay(replay: Replay, path: Path, recording: Recording) -> Path:
    """Writes a replay.

    Args:
        replay: to write.
        path: ending in ``.replay.npz``.
        recording: of the same run; its hash is noted.
    """
    arrays = {name: np.asarray(value) for name in _ARRAYS if (value := getattr(replay, name)) is not None}
    words = {"recording": recording.hash, "error_name": replay.error_name, "unit": replay.unit,
             "enlarged": replay.enlarged, "curves": list(replay.curves), "times": [t for t, _ in replay.pictures]}
    curves = {f"curve_{i}": np.asarray(curve) for i, curve in enumerate(replay.curves.values())}
    pictures = {f"picture_{i}": np.frombuffer(png, np.uint8) for i, (_, png) in enumerate(replay.pictures)}
    content: dict[str, Any] = {"words": np.array(json.dumps(words)), **arrays, **curves, **pictures}
    with path.open("wb") as file:
        np.savez_compressed(file, **content)
    return path


def read_replay(path: Path, robot: Robot, recording: Recording) -> Replay | None:
    """Reads a replay; None where it belongs to another recording.

    Args:
        path: as written by ``write_replay``.
        robot: the arm.
        recording: that the replay has to be of.

    Raises:
        InputError: not such a file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if sum(info.file_size for info in file.zip.infolist()) > _LARGEST:
                raise ValueError(f"more than {_LARGEST / 1e6:.0f} MB in it")
            words = json.loads(str(file["words"]))
            if words["recording"] != recording.hash:
                return None
            arrays = {name: np.asarray(file[name], dtype=float) for name in _ARRAYS if name in file}
            curves = {str(name): np.asarray(file[f"curve_{i}"], dtype=float) for i, name in enumerate(words["curves"])}
            pictures = tuple((float(t), file[f"picture_{i}"].astype(np.uint8).tobytes())
                             for i, t in enumerate(words["times"]))
            for _, png in pictures:
                Image.open(io.BytesIO(png)).load()
            return Replay(robot, **arrays, error_name=str(words["error_name"]), unit=str(words["unit"]), curves=curves,
                          pictures=pictures, enlarged=float(words["enlarged"]))
    except InputError as error:
        raise InputError(f"not a readable replay ({error}); delete it to see the recording alone", file=path) from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, SyntaxError, OverflowError,
            RecursionError, zlib.error, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError(f"not a readable replay ({type(error).__name__}: {error}); delete it to see the "
                         "recording alone", file=path) from error
