"""Shows an arm and its surroundings in a browser (viser)."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.report.replay import (
    Replay,
    arm_angles,
    error_colours,
    link_poses,
    polygons,
    read_replay,
    replay_beside,
    rises,
    sensed_force,
    sensed_line,
)

_AWAY = 1.2
"""How far away a page looks at the arm from, as a multiple of the diagonal of the box about it."""
GHOST = "ghost"
ARM = "arm"
_FARTHEST = 1.4
"""How much farther away a page looks from that is higher than wide, at most."""
_ABOVE_CONTROLS = 0.12
"""How far below the scene's middle it looks, as a share of the distance: there lie the controls."""


class Viewer:
    """A browser page with the arm; ``show(q)`` moves it.

    Args:
        robot: the arm, drawn from the primitive shapes of its URDF; rods where it has meshes only.
        port: TCP port on this machine; the next free one where it is taken, ``port`` then says which.

    Attributes:
        middle: of the box about the arm in its ready posture ``(3,)`` [m].

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, robot: Robot, port: int = 8080) -> None:
        try:
            import viser
        except ImportError as error:
            raise InputError("needs the package viser (pip install 'ideal-robot[view]')", field="view") from error
        self.robot = robot
        self.shapes, self._links = polygons(robot)
        self.server: Any = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self.port = int(self.server.get_port())
        self.server.scene.set_up_direction("+z")
        box = self._box()
        self.middle = box.mean(axis=0)
        self.look_at(self.middle, _AWAY * float(np.linalg.norm(box[1] - box[0])))
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.25)
        self.server.on_client_connect(self._step_back)
        self._arrows: dict[str, Any] = {}
        self.frames: dict[str, list[Any]] = {ARM: self._add(ARM, None)}
        self.show(robot.home)

    def _box(self) -> Array:
        """The corners of the box about the arm in its ready posture ``(2, 3)`` [m]."""
        poses = link_poses(self.robot, self.robot.home[None], self._links)[0]
        corners = np.concatenate([poses[:, 9:], *(
            np.concatenate(shape["faces"]) @ poses[shape["link"], :9].reshape(3, 3).T + poses[shape["link"], 9:]
            for shape in self.shapes)])
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    def _add(self, name: str, opacity: float | None) -> list[Any]:
        """Adds the arm to the browser's scene: returns a frame for each link, which carries the link's meshes.

        Args:
            name: of the arm in the scene.
            opacity: of the meshes; None for opaque.
        """
        frames = [self.server.scene.add_frame(f"/{name}/{link}", show_axes=False) for link in self._links]
        for index, shape in enumerate(self.shapes):
            corners = np.array([corner for face in shape["faces"] for corner in face])
            triangles, first = [], 0
            for face in shape["faces"]:
                triangles += [(first, first + i, first + i + 1) for i in range(1, len(face) - 1)]
                first += len(face)
            self.server.scene.add_mesh_simple(
                f"/{name}/{shape['link']}/{index}", vertices=corners, faces=np.array(triangles), flat_shading=True,
                side="double", opacity=opacity, color=tuple(shape["colour"]) if opacity is None else (120, 130, 145))
        return frames

    def show(self, q: Array, name: str = ARM) -> None:
        """Shows an arm at joint positions ``(n,)`` [rad]: ``ARM``, or ``GHOST`` for a second, pale one."""
        if name not in self.frames:
            self.frames[name] = self._add(name, 0.25)
        poses = link_poses(self.robot, np.asarray(q, dtype=float)[None], self._links)[0]
        with self.server.atomic():
            for frame, pose in zip(self.frames[name], poses, strict=True):
                frame.wxyz = tuple(Rotation.from_matrix(pose[:9].reshape(3, 3)).as_quat(scalar_first=True).tolist())
                frame.position = tuple(pose[9:])

    def draw(self, name: str, points: Array, colour: tuple[int, int, int] | Array, thickness: float = 3.0) -> None:
        """Draws a curve.

        Args:
            name: of the curve in the scene's tree.
            points: ``(N, 3)`` [m] in the base frame.
            colour: of the whole curve, or of each piece ``(N - 1, 3)``; 0 to 255.
            thickness: on the screen [px].
        """
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        whole = np.shape(colour) == (3,)
        colours: Any = colour if whole else np.repeat(np.asarray(colour, dtype=np.uint8)[:, None], 2, axis=1)
        self.server.scene.add_line_segments(f"/curves/{name}", points=pieces, colors=colours, thickness=thickness,
                                            thickness_units="screen")

    def arrow(self, name: str, start: Array, vector: Array, colour: tuple[int, int, int]) -> None:
        """Draws an arrow, or moves it.

        Args:
            name: of the arrow in the scene's tree.
            start: its first point ``(3,)`` [m].
            vector: from there to its point ``(3,)`` [m].
            colour: 0 to 255.
        """
        points = np.array([[start, start + vector]])
        if name in self._arrows:
            self._arrows[name].points = points
        else:
            self._arrows[name] = self.server.scene.add_arrows(f"/arrows/{name}", points=points, colors=colour,
                                                              shaft_radius=0.008, head_radius=0.02, head_length=0.05)

    def look_at(self, place: Array, distance: float) -> None:
        """Points the camera of new pages at ``place (3,)`` [m] from a distance [m]."""
        camera = self.server.initial_camera
        # Aimed to the right of the arm, which then appears left of the controls that cover the right of the picture.
        aim = np.asarray(place) + 0.12 * distance * np.array([0.66, 0.75, 0.0])
        camera.position = tuple(aim + distance * np.array([0.68, -0.6, 0.42]))
        camera.look_at = tuple(aim)

    def _step_back(self, client: Any) -> None:
        """A page that is higher than wide, as a phone's, sees the arm from farther away, above the controls."""
        if client.camera.aspect >= 1.0:
            return
        # The page reports its camera before it has set the first view.
        first = self.server.initial_camera
        aim, position = np.asarray(first.look_at), np.asarray(first.position)
        away = min(1.0 / client.camera.aspect, _FARTHEST) * (position - aim)
        aim = aim - [0.0, 0.0, _ABOVE_CONTROLS * float(np.linalg.norm(away))]
        with client.atomic():
            client.camera.position, client.camera.look_at = tuple(aim + away), tuple(aim)

    def surface(self, corners: Array) -> None:
        """Draws a flat surface with ``corners (4, 3)`` [m]."""
        # Slightly lower than it is, so that drawings on it stay visible.
        lowered = np.asarray(corners) - [0.0, 0.0, 0.003]
        self.server.scene.add_mesh_simple("/surface", vertices=lowered,
                                          faces=np.array([[0, 1, 2], [0, 2, 3]]), color=(245, 245, 240), side="double",
                                          cast_shadow=False)


MOST = 3000
"""Samples that are shown of a recording; longer ones are thinned out."""


def open_recording(path: Path, robot: str | None) -> tuple[Robot, Recording]:
    """Reads a recording; returns its arm and itself.

    Raises:
        InputError: the file does not say its robot and none is given, or their joint counts differ.
    """
    recording = Recording.read(path)
    name = robot or recording.meta.get("robot")
    if name is None:
        raise InputError("the recording does not say its robot; give --robot", file=path)
    # A recording may name an arm that ships with the program; files are opened only where the user says so.
    if robot is None and name not in SHIPPED:
        urdf = str(recording.meta.get("urdf") or "its URDF")[:200]
        raise InputError(f"the recording is of an arm that does not ship with the program; give --robot {urdf}",
                         file=path, field="robot", value=str(name)[:40])
    arm = Robot.load(name)
    if arm.n != recording.n:
        raise InputError(f"the recording has {recording.n} joints, {arm.name} has {arm.n}", file=path)
    if len(recording.t) < 2 or not rises(recording.t):
        raise InputError("times that rise are needed to show a motion, at least two; give t in seconds, sorted",
                         file=path, field="t")
    return arm, recording


def recorded_replay(path: Path, arm: Robot, recording: Recording) -> Replay:
    """The replay of a recording: the stored one, or one made from its columns.

    Args:
        path: of the recording; a replay of the same run beside it is taken.
        arm: the arm it is of.
        recording: the recording in the file.
    """
    beside = replay_beside(path)
    replay = read_replay(beside, arm, recording) if beside.is_file() else None
    return replay or replay_of_columns(arm, recording)


def replay_of_columns(arm: Robot, recording: Recording) -> Replay:
    """A replay of arm, tool path and tool error, from the recording's columns alone.

    The desired position is ``q_d_i`` if there is one, else ``q_c_i``; without either there is no error. The arm is at
    ``qa_i`` if measured, else at ``q_i``. Line points that a camera measured are drawn as a curve.

    Raises:
        InputError: positions are missing everywhere.
    """
    rows = np.unique(np.linspace(0, len(recording.t) - 1, MOST).astype(int))
    q = arm_angles(recording, rows)
    # A posture with missing positions cannot be drawn.
    measured = np.isfinite(q).all(axis=1)
    rows, q = rows[measured], q[measured]
    if len(rows) < 2:
        raise InputError("fewer than two samples hold the positions of all joints; record those of all joints",
                         file=recording.source, field="q_1")
    tool = arm.tool_places(q)
    name = next((prefix for prefix in ("q_d", "q_c") if recording.has(prefix)), None)
    wanted = tool if name is None else arm.tool_places(recording.joints(name, rows))
    error = np.full(len(rows), np.nan) if name is None else 1e3 * np.linalg.norm(tool - wanted, axis=1)
    sensed = sensed_line(arm, recording)
    curves = {"commanded" if name == "q_c" else "desired": wanted} if name is not None else {}
    if len(sensed) > 1:
        curves["line as sensed"] = sensed
    words = "distance from the desired position" if name == "q_d" else "distance from the commanded position"
    return Replay(arm, recording.t[rows], q, tool, wanted, error, words, curves=curves,
                  force=sensed_force(arm, recording, rows))


PERIOD = 0.04
"""Time between two pictures [s]."""
SPEEDS = ("0.1 ×", "0.25 ×", "0.5 ×", "1 ×", "2 ×", "5 ×")
_ARROW = 0.4
"""Length of a large force's arrow [m]."""
_ABOVE = 0.012
"""How far above where it was the tool's path is drawn [m]."""
_MARGIN, _WIDTH, _CONTROLS = 15, 320, 310
"""On a wide page: plot and picture are so far from the right edge, so wide, and below the controls [px]."""
_PLOTTED = 600
"""Most points of the error's plot."""
_COLOURS = ((40, 40, 40), (10, 110, 189), (120, 80, 160), (43, 138, 62))  # colours of further lines
_NAMES = ("black", "blue", "violet", "green")


class Player:
    """Controls for a replay beside the scene; ``show(k)`` shows one sample, ``play()`` all of them repeatedly."""

    def __init__(self, viewer: Viewer, replay: Replay) -> None:
        self.viewer, self.replay = viewer, replay
        self._t = replay.t - replay.t[0]
        self._pictures = [(t - replay.t[0], np.array(Image.open(io.BytesIO(png)).convert("RGB")))
                          for t, png in replay.pictures]
        self._set_up_scene()
        gui = viewer.server.gui
        error = np.abs(replay.error[np.isfinite(replay.error)])
        if len(error):
            gui.add_markdown(f"**{replay.error_name}: {error.mean():.3g} {replay.unit} on average, "
                             f"{error.max():.3g} at most**")
        self.slider = gui.add_slider("time [s]", min=0.0, max=float(self._t[-1]), step=0.002, initial_value=0.0)
        self.running = gui.add_checkbox("play", initial_value=True)
        self.speed = gui.add_dropdown("speed", SPEEDS, initial_value="0.5 ×")
        self.said = gui.add_markdown("")
        shown = [f"{name} {colour}" for name, colour in zip(replay.curves, _NAMES, strict=False)]
        gui.add_markdown(", ".join([*shown, "tool green to red by its error"])
                         + (", force on the tool a blue arrow" if replay.force is not None else ""))
        # The plot cannot have gaps, so only rows with an error are used.
        counts = np.flatnonzero(np.isfinite(replay.error))
        self._rows = counts[np.unique(np.linspace(0, len(counts) - 1, _PLOTTED).astype(int))] if len(counts) else counts
        self.plot: Any = None
        self.picture: Any = None
        if len(counts) > 1 or self._pictures:
            self._add_pictures(len(counts) > 1)
        self.slider.on_update(lambda event: self.show(self._at(float(self.slider.value))))
        self.show(0)

    def _add_pictures(self, plotted: bool) -> None:
        """The error's plot and the camera's picture, in a panel of their own: a phone's page begins with it closed."""
        gui, replay = self.viewer.server.gui, self.replay
        panel = gui.add_panel()
        panel.float(x=-_MARGIN, y=_CONTROLS, width=_WIDTH)
        with panel.add_tab("error and camera" if plotted and self._pictures else "error" if plotted else "camera"):
            if plotted:
                self.plot = gui.add_uplot(self._plotted(0), (
                    {"label": "t [s]"},
                    {"label": f"{replay.error_name} [{replay.unit}]", "stroke": "#e06a00", "width": 1.5},
                    {"label": "until now", "stroke": "#1c2430", "width": 1, "fill": "rgba(28, 36, 48, 0.25)"}),
                    scales={"x": {"time": False}}, axes=({"label": "t [s]"}, {"label": replay.unit}), aspect=1.8)
            if self._pictures:
                self.picture = gui.add_image(self._pictures[0][1], label="camera")

    def _set_up_scene(self) -> None:
        viewer, replay = self.viewer, self.replay
        viewer.look_at(0.5 * (replay.tool.mean(axis=0) + viewer.middle), 1.7 + float(np.ptp(replay.tool, axis=0).max()))
        if replay.surface is not None:
            viewer.surface(replay.surface)
        for (name, points), colour in zip(replay.curves.items(), _COLOURS, strict=False):
            # The tool's path lies on the line that it follows: the drawn line is wider, and the planned line thinner
            # than the coloured path, which lies a little above both.
            viewer.draw(name.replace(" ", "_"), points, colour, thickness=9.0 if name == "drawn line" else 1.5)
        step = max(1, len(self._t) // 1500)
        above = replay.tool[::step] + np.array([0.0, 0.0, _ABOVE])
        viewer.draw("tool", above, error_colours(replay.error[::step])[1:], thickness=4.0)
        # The 99th percentile, so that a shock does not make all other forces invisible.
        self._per_newton = 0.0 if replay.force is None else _ARROW / max(
            float(np.nanquantile(np.linalg.norm(replay.force, axis=1), 0.99)), 1e-9)
        self.tool = viewer.server.scene.add_icosphere("/tool", radius=0.008, color=(224, 106, 0))

    def show(self, k: int) -> None:
        """Shows sample ``k``: arm, tool, picture and the error in words."""
        replay = self.replay
        self.viewer.show(replay.q[k])
        self.tool.position = tuple(float(v) for v in replay.tool[k])
        if replay.force is not None and np.isfinite(replay.force[k]).all():
            # The arrow ends at the tool: on the other side it would be hidden in the wrist.
            push = self._per_newton * replay.force[k]
            self.viewer.arrow("force", replay.tool[k] - push, push, (0, 110, 190))
        error = replay.error[k]
        self.said.content = f"**{self._t[k]:.2f} s**" + (
            f", {replay.error_name} {abs(error):.3g} {replay.unit}" if np.isfinite(error) else "") + (
            f", force {np.linalg.norm(replay.force[k]):.3g} N" if replay.force is not None else "")
        if self.plot is not None:
            self.plot.data = self._plotted(k)
        if self.picture is not None:
            shown = min(self._pictures, key=lambda pair: abs(pair[0] - self._t[k]))[1]
            if shown is not self._shown_picture:
                self.picture.image = self._shown_picture = shown

    _shown_picture: Any = None

    def play(self) -> None:
        """Plays the replay repeatedly at the chosen speed, until a keyboard interrupt."""
        while True:
            begun = time.perf_counter()
            if self.running.value:
                factor = float(self.speed.value.split()[0])
                # Setting the slider shows the sample, as moving it by hand does.
                self.slider.value = float((self.slider.value + PERIOD * factor) % self._t[-1])
            time.sleep(max(0.0, PERIOD - (time.perf_counter() - begun)))

    def _at(self, t: float) -> int:
        return min(int(np.searchsorted(self._t, t)), len(self._t) - 1)

    def _plotted(self, k: int) -> tuple[Array, Array, Array]:
        """Times, errors, and the errors until sample ``k``, zero after it."""
        error = self.replay.error[self._rows]
        return self._t[self._rows], error, np.where(self._rows <= k, error, 0.0)
