"""A replay inside a page: the arm moves, the error is drawn enlarged, all in one self-contained piece of HTML.

No library is loaded and nothing is fetched: the arm's primitive shapes become polygons that a short script draws on a
canvas, so that the page also plays on a phone and without a network.
"""

from __future__ import annotations

import base64
import io
import json
import zipfile
import zlib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.file_limits import REPLAY_BYTES
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import let_go
from ideal_robot.signals.recording import Recording
from scenes.report.arm_shapes import link_poses, polygons, rounded
from scenes.result import step

FRAMES = 400
"""A replay has no more frames than that; longer runs are thinned out."""


def rises(t: Array) -> bool:
    """Whether times ``(N,)`` can be played: finite, sorted, and not all the same."""
    return bool(np.isfinite(t).all() and np.all(np.diff(t) >= 0.0) and t[0] < t[-1])


@dataclass(frozen=True)
class Replay:
    """What a replay shows; everything over one time axis of ``N`` samples.

    Attributes:
        robot: the arm, drawn from its URDF's primitive shapes.
        t: times ``(N,)`` [s].
        q: arm angles ``(N, n)`` [rad].
        tool: where the TCP truly was ``(N, 3)`` [m].
        wanted: the point it should have been at, or the nearest one of the line ``(N, 3)`` [m].
        error: what is plotted below and colours the trace ``(N,)``, in ``unit``; NaN where it does not count.
        error_name, unit: what that is.
        curves: further curves by name ``(K, 3)`` [m], e.g. the drawn line.
        surface: corners of the surface ``(4, 3)`` [m], or None.
        pictures: camera pictures, time [s] and PNG.
        ghost: arm angles of another method at the same times ``(N, n)`` [rad], drawn pale, or None.
        enlarged: how many times the error is enlarged in the view from above.
        force: of the environment on the tool ``(N, 3)`` [N] in the base frame, drawn as an arrow, or None.
    """

    robot: Robot
    t: Array
    q: Array
    tool: Array
    wanted: Array
    error: Array
    error_name: str = "distance from the path"
    unit: str = "mm"
    curves: dict[str, Array] = field(default_factory=dict)
    surface: Array | None = None
    pictures: tuple[tuple[float, bytes], ...] = ()
    ghost: Array | None = None
    enlarged: float = 50.0
    force: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.t)
        shapes = {"q": (n, self.robot.n), "tool": (n, 3), "wanted": (n, 3), "error": (n,)}
        optional = {"force": (n, 3), "ghost": (n, self.robot.n), "surface": (4, 3)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"expected the shape {shape}", field=name, value=np.shape(getattr(self, name)))
        for name in ("q", "ghost"):
            if getattr(self, name) is not None and not np.isfinite(getattr(self, name)).all():
                raise InputError("expected finite angles", field=name)
        if n < 2:
            raise InputError("a replay needs two samples at least", field="t", value=n)
        if not rises(self.t):
            raise InputError("the times of a replay must rise", field="t")
        for name, curve in self.curves.items():
            if np.ndim(curve) != 2 or np.shape(curve)[1] != 3 or len(curve) < 2:
                raise InputError("expected two points (K, 3) at least", field=name, value=np.shape(curve))

    def html(self) -> str:
        """The replay as a piece of HTML for a page."""
        script = resources.files("scenes").joinpath("templates/replay.js").read_text(encoding="utf-8")
        # "</" inside a script would end it.
        data = json.dumps(self._data(), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
        return f'<div class="replay"></div>\n<script>\n(function () {{\nconst DATA = {data};\n{script}}})();\n</script>'

    def _data(self) -> dict[str, Any]:
        step = max(1, -(-len(self.t) // FRAMES))
        rows = slice(None, None, step)
        shapes, links = polygons(self.robot)
        counts = np.isfinite(self.error)
        # Where the error does not count, there is nothing to enlarge.
        wanted = np.where(counts[:, None], self.wanted, self.tool)
        error = [None if not np.isfinite(value) else round(float(value), 4) for value in self.error[rows]]
        return {
            "t": rounded(self.t[rows] - self.t[0], 3),
            "links": rounded(link_poses(self.robot, self.q[rows], links), 4),
            "ghost": None if self.ghost is None else rounded(link_poses(self.robot, self.ghost[rows], links), 4),
            "shapes": shapes,
            "tool": rounded(self.tool[rows], 5), "wanted": rounded(wanted[rows], 5),
            "error": error, "errorName": self.error_name, "unit": self.unit,
            "curves": {name: rounded(curve[:: max(1, len(curve) // 300)], 4) for name, curve in self.curves.items()},
            "surface": None if self.surface is None else rounded(self.surface, 4),
            "pictures": [[round(float(t - self.t[0]), 3), "data:image/png;base64,"
                          + base64.b64encode(png).decode("ascii")] for t, png in self.pictures],
            "enlarged": self.enlarged,
            "force": None if self.force is None else rounded(np.nan_to_num(self.force[rows]), 2),
        }


ENDING = ".replay.npz"
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
    arrays = {name: np.asarray(value, dtype=float) for name in _ARRAYS if (value := getattr(replay, name)) is not None}
    words = {"recording": recording.hash, "error_name": replay.error_name, "unit": replay.unit,
             "enlarged": replay.enlarged, "curves": list(replay.curves), "times": [t for t, _ in replay.pictures]}
    curves = {f"curve_{i}": np.asarray(curve, dtype=float) for i, curve in enumerate(replay.curves.values())}
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
            REPLAY_BYTES.check(sum(info.file_size for info in file.zip.infolist()), path)
            words = json.loads(str(file["words"]))
            if words["recording"] != recording.hash:
                return None
            arrays = {name: _floats(file[name]) for name in _ARRAYS if name in file}
            curves = {str(name): _floats(file[f"curve_{i}"]) for i, name in enumerate(words["curves"])}
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


def _floats(values: Array) -> Array:
    """Numbers as they were written; of another type they would take more room than was counted."""
    if values.dtype != np.float64:
        raise ValueError(f"numbers of type {values.dtype}")
    return values


_GRAVITY = np.array([0.0, 0.0, -9.81])


def sensed_line(arm: Robot, recording: Recording) -> Array:
    """The middle line point of every camera field ``(K, 3)`` [m]; none where no camera measured.

    Args:
        arm: the arm.
        recording: with ``line_x_i line_y_i line_z_i`` in the tool frame.
    """
    count = sum(name.startswith("line_x_") for name in recording.columns)
    if count == 0:
        return np.empty((0, 3))
    middle = (count + 1) // 2
    columns = [recording.columns[f"line_{axis}_{middle}"] for axis in "xyz"]
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(column) for column in columns]))
    rows = rows[:: step(len(rows))]
    points = np.column_stack([column[rows] for column in columns])
    q = recording.joints("qa" if recording.has("qa") else "q", rows)
    let_go(*columns)
    pose = arm.fk()
    return np.array([pose(q_k).act(point) for q_k, point in zip(q, points, strict=True)]).reshape(-1, 3)


def sensed_force(arm: Robot, recording: Recording, rows: Any = slice(None)) -> Array | None:
    """Force of the environment on the tool ``(N, 3)`` [N]; None where no sensor measured.

    The tool's own weight and the sensor's bias are taken away where the recording says what calibration found of them.

    Args:
        arm: the arm.
        recording: with ``fx fy fz`` in the tool frame.
        rows: of the recording, as NumPy takes them; all by default.
    """
    if not all(name in recording.columns for name in ("fx", "fy", "fz")):
        return None
    felt = np.column_stack([recording.columns[name][rows] for name in ("fx", "fy", "fz")])
    q = recording.joints("qa" if recording.has("qa") else "q", rows)
    tool = recording.meta.get("tool", {})
    tool = tool if isinstance(tool, dict) else {}
    bias = np.asarray(tool.get("bias", np.zeros(6)), dtype=float)[:3]
    weight = float(tool.get("mass", 0.0)) * _GRAVITY
    pose = arm.fk()
    return np.array([pose(row).rotation @ force - weight for row, force in zip(q, felt - bias, strict=True)])
