"""A film of a run: the arm, its path with the error enlarged, and the error over time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.progress import Progress, silent
from ideal_robot.whole_file import OutputError, whole_file
from scenes.report.replay import Replay, error_colours
from sim.arm.body import Picture, Stage, View

ENDINGS = (".mp4", ".gif", ".webp")
_ARM, _SIDE, _PLOT = (560, 420), 340, 120
"""Size of the arm's picture, width of the path's panel, height of the plot [px]."""
_OF_PAGES: dict[str, dict[str, Any]] = {"gif": {"optimize": True}, "webp": {"quality": 60, "method": 6}}
"""Films that can stand in a page, and how they are packed."""
_INK, _ACCENT, _PAPER = (28, 36, 48), (224, 106, 0), (244, 246, 248)  # red, green, blue


def check_video(path: Path) -> None:
    """Raises InputError for a file name without the ending of a film, before any work is done.

    Raises:
        InputError: another ending than those of ``ENDINGS``.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"expected a name ending in {' or '.join(ENDINGS)}", field="--video", value=str(path))


def write_video(replay: Replay, path: Path, *, rate: float = 12.0, slow: float = 1.5,
                progress: Progress = silent) -> Path:
    """Writes a replay as a film.

    Args:
        replay: the replay to show.
        path: ending in ``.mp4``, ``.gif`` or ``.webp``.
        rate: pictures a second of the film [1/s].
        slow: factor by which it is slower than the run.
        progress: called with the fraction done.

    Raises:
        InputError: another ending.
        OutputError: the file cannot be written.
        IdealRobotError: this OpenCV cannot write MP4 films.
    """
    check_video(path)
    with whole_file(path) as partial:
        kind = path.suffix.lower()[1:]
        if kind in _OF_PAGES:
            pictures = [_small(frame, kind == "gif") for frame in frames(replay, rate * slow, progress)]
            pictures[0].save(partial, format=kind, save_all=True, append_images=pictures[1:],
                             duration=round(1000.0 / rate), loop=0, **_OF_PAGES[kind])
        else:
            _mp4(replay, partial, rate, slow, progress)
    return path


def _small(frame: Picture, palette: bool) -> Image.Image:
    """A picture that can stand in a page: three quarters of the size, and few colours where it has a palette."""
    image = Image.fromarray(frame)
    small = image.resize((3 * image.width // 4, 3 * image.height // 4), Image.Resampling.LANCZOS)
    return small.quantize(64) if palette else small


def _mp4(replay: Replay, path: Path, rate: float, slow: float, progress: Progress) -> None:
    writer: cv2.VideoWriter | None = None
    count = 0
    for frame in frames(replay, rate * slow, progress):
        if writer is None:
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate,
                                     (frame.shape[1], frame.shape[0]))
            if not writer.isOpened():
                raise IdealRobotError("this OpenCV cannot write MP4 films; give a name ending in .gif")
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        count += 1
    if writer is not None:
        writer.release()
    # OpenCV does not report a full disk.
    written = cv2.VideoCapture(str(path))
    if int(written.get(cv2.CAP_PROP_FRAME_COUNT)) != count:
        raise OutputError.of(path, OSError("the film is incomplete"), "make room, or give another place")


def frames(replay: Replay, rate: float, progress: Progress = silent) -> Iterator[Picture]:
    """Pictures ``(height, width, 3)``, RGB, at even times.

    Args:
        replay: the replay to show.
        rate: pictures a second of the run [1/s].
        progress: called with the fraction done.
    """
    times = np.arange(replay.t[0], replay.t[-1], 1.0 / rate)
    rows = np.clip(np.searchsorted(replay.t, times), 0, len(replay.t) - 1)
    lines = [curve[:: max(1, len(curve) // 60)] for curve in list(replay.curves.values())[:1]]
    counts = np.isfinite(replay.error)
    scale = float(np.nanmax(np.abs(replay.error))) if counts.any() else 1.0
    colours, (path, shown, box) = error_colours(replay.error), _flattened(replay, counts)
    middle = 0.5 * (replay.tool.min(axis=0) + replay.tool.max(axis=0))
    target = [0.6 * float(middle[0]), 0.6 * float(middle[1]), 0.42]
    view = View(*_ARM, azimuth=62.0, elevation=-26.0, distance=2.2, target=target)
    with Stage(replay.robot, replay.q[0], view, lines=lines, surface=replay.surface) as stage:
        for i, k in enumerate(rows):
            progress(i / len(rows), "film")
            frame = np.full((_ARM[1] + _PLOT, _ARM[0] + _SIDE, 3), 255, dtype=np.uint8)
            frame[: _ARM[1], : _ARM[0]] = stage.show(replay.q[k])
            _path_panel(frame[: _ARM[1], _ARM[0] :], replay, path, shown, box, int(k), colours)
            _error_panel(frame[_ARM[1] :], replay, int(k), scale)
            yield frame


def _flattened(replay: Replay, counts: np.ndarray) -> tuple[Array, Array, tuple[Array, float]]:
    """Wanted path and enlarged trace in the plane in which the path spreads most, with middle and scale of a panel."""
    wanted = np.where(counts[:, None], replay.wanted, replay.tool)
    enlarged = wanted + replay.enlarged * (replay.tool - wanted)
    mean = wanted.mean(axis=0)
    plane = np.linalg.svd(wanted - mean, full_matrices=False)[2][:2]
    # A path that is taller than wide fits the panel better.
    a, b = (wanted - mean) @ plane[::-1].T, (enlarged - mean) @ plane[::-1].T
    both = np.vstack([a, b])
    low, high = np.percentile(both, 1.0, axis=0), np.percentile(both, 99.0, axis=0)
    scale = 0.86 * min(_SIDE / max(high[0] - low[0], 1e-6), (_ARM[1] - 60) / max(high[1] - low[1], 1e-6))
    return a, b, (0.5 * (low + high), float(scale))


def _path_panel(panel: np.ndarray, replay: Replay, wanted: Array, shown: Array, box: tuple[Array, float], k: int,
                colours: Array) -> None:
    panel[:] = _PAPER
    middle, zoom = box
    height, width = panel.shape[:2]

    def at(points: Array) -> np.ndarray:
        return np.rint((points - middle) * zoom * [1.0, -1.0] + [width / 2, height / 2 + 14]).astype(np.int32)

    cv2.polylines(panel, [at(wanted).reshape(-1, 1, 2)], False, _INK, 1, cv2.LINE_AA)
    trace = at(shown)
    step = max(1, len(trace) // 500)
    for i in range(step, k + 1, step):
        cv2.line(panel, trace[i - step].tolist(), trace[i].tolist(), colours[i].tolist(), 2, cv2.LINE_AA)
    cv2.circle(panel, trace[k].tolist(), 4, _ACCENT, -1, cv2.LINE_AA)
    if replay.enlarged != 1.0:
        _text(panel, f"error enlarged {replay.enlarged:g} times", (10, 20))


def _error_panel(panel: np.ndarray, replay: Replay, k: int, scale: float) -> None:
    height, width = panel.shape[:2]
    x = 60 + (width - 75) * (replay.t - replay.t[0]) / (replay.t[-1] - replay.t[0])
    y = height - 22 - (height - 50) * np.nan_to_num(np.abs(replay.error)) / scale
    for level in (0.0, scale):
        row = round(height - 22 - (height - 50) * level / scale)
        cv2.line(panel, (60, row), (width - 15, row), (223, 228, 234), 1)
        _text(panel, f"{level:.2g} {replay.unit}", (6, row + 4))
    counts = np.isfinite(replay.error)
    points = np.column_stack([x, y]).round().astype(np.int32)
    for first, last in _pieces(counts):
        cv2.polylines(panel, [points[first:last].reshape(-1, 1, 2)], False, _ACCENT, 1, cv2.LINE_AA)
    cv2.line(panel, (round(x[k]), 22), (round(x[k]), height - 22), _INK, 1)
    label = f"{replay.t[k] - replay.t[0]:.2f} s"
    if counts[k]:
        label += f"   {replay.error_name} {abs(replay.error[k]):.3f} {replay.unit}"
    _text(panel, label, (60, 15))


def _pieces(counts: np.ndarray) -> list[tuple[int, int]]:
    """First and last-plus-one indices of the stretches that count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], counts, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _text(panel: np.ndarray, text: str, at: tuple[int, int]) -> None:
    cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
