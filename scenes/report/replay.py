"""A replay inside a page: the arm moves, the error is drawn enlarged, in one self-contained piece of HTML.

No library is loaded and nothing is fetched: the arm's primitive shapes become polygons that a short script draws on a
canvas, so that the page also plays on a phone and without a network.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from PIL import Image

from ideal_robot.arrays import GRAVITY, Array
from ideal_robot.bounded_values import REPLAY_BYTES, parsed_json
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes
from ideal_robot.row_log import let_go
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import whole_file
from scenes.result import step

SIDES = 10
"""Corners of a circle."""


def polygons(robot: Robot) -> tuple[list[dict[str, Any]], list[int]]:
    """The visible shapes of an arm as polygons, meshes left out, and the joints whose poses carry them.

    Returns:
        For each shape its link's place in the second list, colour, and faces with their corners [m]; and Pinocchio's
        joint indices of these links. Without any shape the links are drawn as rods between the joints.
    """
    model = robot.pinocchio
    shapes: list[dict[str, Any]] = []
    text = without_meshes(robot.description)
    for item in pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL).geometryObjects:
        if faces := _faces(item.geometry):
            shapes.append({"link": int(item.parentJoint), "faces": _placed(item.placement, faces),
                           "colour": [round(255 * float(c)) for c in item.meshColor[:3]]})
    if robot.tool_length > 0.0:
        flange = model.frames[model.frames[robot.tool_id].parentFrame]
        rod = _rod(np.array([0.0, 0.0, robot.tool_length]), 0.006)
        shapes.append({"link": int(flange.parentJoint), "faces": _placed(flange.placement, rod),
                       "colour": [51, 51, 51]})
    if not shapes:
        for joint in range(1, model.njoints):
            end = model.jointPlacements[joint].translation
            if np.linalg.norm(end) > 1e-6:
                shapes.append({"link": int(model.parents[joint]), "faces": _rod(end, 0.04), "colour": [224, 106, 0]})
    return shapes, list(range(model.njoints))


def _placed(placement: pin.SE3, faces: list[list[list[float]]]) -> list[list[list[float]]]:
    return [[rounded(placement.act(np.asarray(corner)), 4) for corner in face] for face in faces]


def link_poses(robot: Robot, q: Array, links: list[int]) -> Array:
    """Poses of links along a motion, rotation matrix by rows and place, ``(N, links, 12)``.

    Args:
        robot: the arm.
        q: arm angles ``(N, n)`` [rad].
        links: Pinocchio's joint indices.
    """
    data = robot.pinocchio.createData()
    poses = np.empty((len(q), len(links), 12))
    for k, row in enumerate(np.ascontiguousarray(q)):
        pin.forwardKinematics(robot.pinocchio, data, row)
        for i, link in enumerate(links):
            poses[k, i, :9] = data.oMi[link].rotation.ravel()
            poses[k, i, 9:] = data.oMi[link].translation
    return poses


def _faces(shape: Any) -> list[list[list[float]]]:
    """Faces of a primitive shape in its own frame; none for meshes."""
    kind = type(shape).__name__
    if kind == "Box":
        return _box(*(float(v) for v in shape.halfSide))
    if kind in ("Cylinder", "Capsule"):
        return _cylinder(float(shape.radius), float(shape.halfLength))
    if kind == "Sphere":
        return _sphere(float(shape.radius))
    return []


def _box(x: float, y: float, z: float) -> list[list[list[float]]]:
    corner = [[sx * x, sy * y, sz * z] for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    order = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return [[corner[i] for i in face] for face in order]


def _cylinder(radius: float, half: float) -> list[list[list[float]]]:
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    low = [[radius * float(np.cos(a)), radius * float(np.sin(a)), -half] for a in angle]
    high = [[x, y, half] for x, y, _ in low]
    sides = [[low[i], low[(i + 1) % SIDES], high[(i + 1) % SIDES], high[i]] for i in range(SIDES)]
    return [*sides, high, low[::-1]]


def _sphere(radius: float) -> list[list[list[float]]]:
    rings = 6
    grid = [[[radius * float(np.sin(p) * np.cos(a)), radius * float(np.sin(p) * np.sin(a)), radius * float(np.cos(p))]
             for a in 2.0 * np.pi * np.arange(SIDES) / SIDES] for p in np.pi * np.arange(rings + 1) / rings]
    return [[grid[i][j], grid[i + 1][j], grid[i + 1][(j + 1) % SIDES], grid[i][(j + 1) % SIDES]]
            for i in range(rings) for j in range(SIDES)]


def _rod(end: Array, radius: float) -> list[list[list[float]]]:
    """A square rod from the origin to ``end (3,)`` [m]."""
    length = float(np.linalg.norm(end))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.asarray(end) / length).matrix()
    return [[rounded(rotation @ (np.asarray(corner) + np.array([0.0, 0.0, 0.5 * length])), 4) for corner in face]
            for face in _box(radius, radius, 0.5 * length)]


def rounded(values: Array, digits: int) -> list[Any]:
    """Nested lists of the values, rounded to keep pages small."""
    short: list[Any] = np.round(np.asarray(values, dtype=float), digits).tolist()
    return short


FRAMES = 400
"""A replay has no more frames than that; longer runs are thinned out."""


def rises(t: Array) -> bool:
    """Whether times ``(N,)`` can be animated: finite, sorted, and not all the same."""
    return bool(np.isfinite(t).all() and np.all(np.diff(t) >= 0.0) and t[0] < t[-1])


@dataclass(frozen=True)
class Replay:
    """The data of a replay, over one time axis of ``N`` samples.

    Attributes:
        robot: the arm, drawn from its URDF's primitive shapes.
        t: times ``(N,)`` [s].
        q: arm angles ``(N, n)`` [rad].
        tool: where the TCP truly was ``(N, 3)`` [m].
        wanted: the point it should have been at, or the nearest one of the line ``(N, 3)`` [m].
        error: error that is plotted and colours the trace ``(N,)``, in ``unit``; NaN where it is not evaluated.
        error_name, unit: name and unit of the error.
        curves: further curves by name ``(K, 3)`` [m], e.g. the drawn line.
        surface: corners of the surface ``(4, 3)`` [m], or None.
        pictures: camera pictures, time [s] and PNG.
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
    enlarged: float = 50.0
    force: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.t)
        shapes = {"q": (n, self.robot.n), "tool": (n, 3), "wanted": (n, 3), "error": (n,)}
        optional = {"force": (n, 3), "surface": (4, 3)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"expected the shape {shape}", field=name, value=np.shape(getattr(self, name)))
        if not np.isfinite(self.q).all():
            raise InputError("expected finite angles", field="q")
        if n < 2:
            raise InputError("a replay needs two samples at least", field="t", value=n)
        if not rises(self.t):
            raise InputError("the times of a replay must rise", field="t")
        for name, curve in self.curves.items():
            if np.ndim(curve) != 2 or np.shape(curve)[1] != 3 or len(curve) < 2:
                raise InputError("expected two points (K, 3) at least", field=name, value=np.shape(curve))

    def html(self) -> str:
        """The replay as a piece of HTML for a page."""
        return _html(self.data())

    def data(self) -> dict[str, Any]:
        """The data for the page's script: plain values, thinned out and rounded."""
        step = max(1, -(-len(self.t) // FRAMES))
        rows = slice(None, None, step)
        shapes, links = polygons(self.robot)
        counts = np.isfinite(self.error)
        # Where the error is not evaluated, nothing is enlarged.
        wanted = np.where(counts[:, None], self.wanted, self.tool)
        error = [None if not np.isfinite(value) else round(float(value), 4) for value in self.error[rows]]
        return {
            "t": rounded(self.t[rows] - self.t[0], 3),
            "links": rounded(link_poses(self.robot, self.q[rows], links), 4),
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


def enlarged_alike(replays: Sequence[Replay]) -> list[Replay]:
    """The replays with a common magnification of their errors: the largest is drawn as a sixth of the path at most.

    Magnifications are 1, 2 or 5 times a power of ten, and 50 at most.
    """
    extent = max(float(np.ptp(replay.wanted, axis=0).max()) for replay in replays)
    away = max(float(np.max(np.linalg.norm((replay.tool - replay.wanted)[np.isfinite(replay.error)], axis=1),
                            initial=0.0)) for replay in replays)
    most = min(50.0, extent / (6.0 * max(away, 1e-9)))
    enlarged = max([1.0, *(one for one in (2.0, 5.0, 10.0, 20.0, 50.0) if one <= most)])
    return [replace(replay, enlarged=enlarged) for replay in replays]


@dataclass(frozen=True)
class KeptReplay:
    """A stored replay of an earlier version, to be shown beside another one.

    Attributes:
        data: as ``Replay.data`` gives it.
    """

    data: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> KeptReplay | None:
        """The replay of a file that ``keep`` has written; None where there is none that can be read."""
        try:
            with gzip.open(path, "rt", encoding="utf-8") as file:
                data = parsed_json(file.read(REPLAY_BYTES.most), path, "a replay")
        except (OSError, EOFError, ValueError, zlib.error, InputError):
            return None
        return cls(data) if isinstance(data, dict) else None

    def keep(self, path: Path) -> None:
        """Writes the replay, compressed; OutputError where that fails."""
        with whole_file(path) as partial:
            partial.write_bytes(gzip.compress(json.dumps(self.data, allow_nan=False).encode(), mtime=0))

    def html(self) -> str:
        """The replay as a piece of HTML for a page."""
        return _html(self.data)


def _html(data: dict[str, Any]) -> str:
    script = resources.files("scenes").joinpath("templates/replay.js").read_text(encoding="utf-8")
    # "</" inside a script would end it.
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return f'<div class="replay"></div>\n<script>\n(function () {{\nconst DATA = {text};\n{script}}})();\n</script>'


def error_colours(error: Array) -> Array:
    """Green for none to red for the largest error ``(N,)``, gray where it is NaN: ``(N, 3)``, 0 to 255."""
    counts = np.isfinite(error)
    size = np.abs(np.nan_to_num(error)) / max(float(np.max(np.abs(error[counts]), initial=0.0)), 1e-12)
    colours = np.column_stack([40 + 190 * size, 150 - 110 * size, np.full(len(error), 50.0)])
    colours[~counts] = (136, 147, 161)
    return np.asarray(colours.round().astype(np.uint8))


ENDING = ".replay.npz"
_ARRAYS = ("t", "q", "tool", "wanted", "error", "surface", "force")


def arm_angles(recording: Recording, rows: Any = slice(None)) -> Array:
    """Arm angles ``(N, n)`` [rad] of some rows; the motors' where no tracker measured the arm's."""
    return recording.joints("qa" if recording.has("qa") else "q", rows)


def shown_motion(robot: Robot, recording: Recording) -> tuple[slice, Array, Array, Array]:
    """Rows of a recording that are shown; times ``(N,)`` [s], arm angles ``(N, n)`` [rad] and tool ``(N, 3)`` [m]."""
    rows = slice(None, None, step(len(recording.t)))
    q = arm_angles(recording, rows)
    return rows, recording.t[rows], q, robot.tool_places(q)


def replay_beside(recording: Path) -> Path:
    """File of a recording's replay, beside the recording."""
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
        recording: the recording that the replay has to belong to.

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
            RecursionError, zlib.error, RuntimeError, zipfile.BadZipFile, tokenize.TokenError) as error:
        raise InputError(f"not a readable replay ({type(error).__name__}: {error}); delete it to see the "
                         "recording alone", file=path) from error


def _floats(values: Array) -> Array:
    """Returns the values; ValueError where they are no float64, for which the limit of memory was checked."""
    if values.dtype != np.float64:
        raise ValueError(f"expected numbers of type float64, not {values.dtype}")
    return values


def sensed_line(arm: Robot, recording: Recording) -> Array:
    """The middle line point ``line_x_i line_y_i line_z_i`` of every camera field ``(K, 3)`` [m]; none without any."""
    count = sum(name.startswith("line_x_") for name in recording.columns)
    if count == 0:
        return np.empty((0, 3))
    middle = (count + 1) // 2
    columns = [recording.columns[f"line_{axis}_{middle}"] for axis in "xyz"]
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(column) for column in columns]))
    rows = rows[:: step(len(rows))]
    points = np.column_stack([column[rows] for column in columns])
    q = arm_angles(recording, rows)
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
    q = arm_angles(recording, rows)
    tool = recording.meta.get("tool", {})
    tool = tool if isinstance(tool, dict) else {}
    bias = np.asarray(tool.get("bias", np.zeros(6)), dtype=float)[:3]
    weight = float(tool.get("mass", 0.0)) * GRAVITY
    pose = arm.fk()
    return np.array([pose(row).rotation @ force - weight for row, force in zip(q, felt - bias, strict=True)])
