"""The arm, its line and a recording in a browser (viser)."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import SHIPPED, Robot
from ideal_robot.robots.urdf import without_meshes
from ideal_robot.signals.recording import Recording


class Viewer:
    """A browser page with the arm; ``show(q)`` moves it.

    Args:
        robot: the arm, drawn from the primitive shapes of its URDF (meshes are left out).
        port: TCP port on this machine.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, robot: Robot, port: int = 8080) -> None:
        try:
            import viser
        except ImportError as error:
            raise InputError("needs the package viser (pip install 'ideal-robot[view]')", field="view") from error
        self._robot = robot
        self._data = robot.pinocchio.createData()
        shapes = without_meshes(robot.urdf.read_text(encoding="utf-8"))
        self._geometry = pin.buildGeomFromUrdfString(robot.pinocchio, shapes, pin.GeometryType.VISUAL)
        self.server: Any = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self.server.initial_camera.position = (2.6, -2.2, 1.7)
        self.server.initial_camera.look_at = (0.5, 0.0, 0.6)
        self._handles = [self._add(index, item) for index, item in enumerate(self._geometry.geometryObjects)]
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.25)
        self.show(robot.home)

    def _add(self, index: int, item: Any) -> Any:
        mesh = _mesh(item.geometry)
        if mesh is None:
            return None
        colour = item.meshColor
        return self.server.scene.add_mesh_simple(
            f"/arm/{index}", vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces),
            color=(float(colour[0]), float(colour[1]), float(colour[2])))

    def show(self, q: Array) -> None:
        """Shows the arm at joint positions ``q (n,)`` [rad]."""
        pin.forwardKinematics(self._robot.pinocchio, self._data, np.asarray(q, dtype=float))
        for item, handle in zip(self._geometry.geometryObjects, self._handles, strict=True):
            if handle is None:
                continue
            pose = self._data.oMi[item.parentJoint] * item.placement
            quaternion = pin.Quaternion(pose.rotation)
            handle.wxyz = (quaternion.w, quaternion.x, quaternion.y, quaternion.z)
            handle.position = tuple(pose.translation)

    def draw(self, name: str, points: Array, colour: tuple[int, int, int]) -> None:
        """Draws a curve through ``points (N, 3)`` [m] in the base frame."""
        segments = np.stack([points[:-1], points[1:]], axis=1)
        self.server.scene.add_line_segments(f"/curves/{name}", points=segments, colors=colour, line_width=3.0)

    def play(self, recording: Recording, *, speed: float = 1.0) -> None:
        """Plays a recording again and again, with a slider for the time; ends with the keyboard interrupt."""
        t = recording.t - recording.t[0]
        q = recording.joints("qa") if recording.has("qa") else recording.joints("q")
        slider = self.server.gui.add_slider("time [s]", min=0.0, max=float(t[-1]), step=0.01, initial_value=0.0)
        running = self.server.gui.add_checkbox("play", initial_value=True)
        period = 0.04
        while True:
            self.show(q[min(int(np.searchsorted(t, slider.value)), len(t) - 1)])
            if running.value:
                slider.value = (slider.value + period * speed) % float(t[-1])
            time.sleep(period)


def _mesh(shape: Any) -> Any:
    """A triangle mesh of a primitive shape, or None for what is not primitive."""
    import trimesh

    kind = type(shape).__name__
    if kind == "Box":
        return trimesh.creation.box(extents=2 * np.asarray(shape.halfSide))
    if kind == "Cylinder":
        return trimesh.creation.cylinder(radius=shape.radius, height=2 * shape.halfLength, sections=32)
    if kind == "Capsule":
        return trimesh.creation.capsule(radius=shape.radius, height=2 * shape.halfLength)
    if kind == "Sphere":
        return trimesh.creation.icosphere(radius=shape.radius, subdivisions=2)
    return None


def open_recording(path: Path, robot: str | None) -> tuple[Robot, Recording]:
    """The recording and the arm it is of.

    Raises:
        InputError: the file does not say its robot and none is given, or their joint counts differ.
    """
    recording = Recording.read(path)
    name = robot or recording.meta.get("robot")
    # A recording may name an arm that ships with the program; files are opened only where the user says so.
    if name is None or (robot is None and name not in SHIPPED):
        raise InputError("the recording does not say its robot; give --robot", file=path)
    arm = Robot.load(name)
    if arm.n != recording.n:
        raise InputError(f"the recording has {recording.n} joints, {arm.name} has {arm.n}", file=path)
    return arm, recording
