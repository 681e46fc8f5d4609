"""A scene's camera on an arm of another program: reads the arm's states and sends the rendered pictures.

A picture is exposed at an instant of the controller's clock, from the joint angles that the controller reports about
it, and stamped with that instant. By this computer's clock it was then what the states' stamps and arrivals say, so
that a follower which relates the same clock in the same way finds the arm's pose in it.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import BAD_ADDRESS, IdealRobotError, InputError
from ideal_robot.interfaces import read_arm
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.state_reader import ReportedState
from ideal_robot.row_log import RowLog
from scenes.line.cell import Cell, set_up
from scenes.online.live_arm import at_cycle
from scenes.online.processes import stopping_on_signals, undisturbed
from scenes.report.page import write_json
from scenes.scene_files.drawn_line import CameraTable
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene
from scenes.serve.carried import CameraDevice, ServedCamera
from scenes.serve.cell import beside_line, line_of
from sensing.clock_relation import ClockRelation
from sim.camera.image_chain import CameraSettings
from sim.camera.lamp import ArmShape
from sim.devices.stream_server import DeviceClock, Unkindness, now

_SOONEST = 2.0
"""Standard deviations of the latency by which a second's soonest picture of some twenty-five is early, on average."""
_REMEMBERED = 2.0
"""Time of which states are kept [s]; a picture is exposed as soon as the states about it are there."""
_ANEW = 1.0
"""By how much stamps have to go back, or leap, to be another clock's: a simulation that was begun anew [s]."""
_MOVES = 1e-6
"""Change of a joint that is motion [rad]; states at rest are not kept for what is measured in the end."""
_SILENT = 1.0
"""Silence that is said [s]."""
_PRIORITY = 25
"""Below that of the arm's simulation and of a follower on the same computer; above that of drawing."""


@dataclass(frozen=True)
class CameraPlaces:
    """Address of the arm and targets of its pictures.

    Attributes:
        arm: address of its interface.
        patience: how long its states are waited for [s].
        stream: address of this computer on which the stream listens, and TCP port.
        topic: of ROS 2 on which pictures are published, too; None without one.
    """

    arm: str
    patience: float = 10.0
    stream: tuple[str, int] = ("127.0.0.1", 50001)
    topic: str | None = None


class ArmElsewhere:
    """The motion of an arm as its controller reports it.

    Args:
        robot: the robot whose joints they are.

    Attributes:
        clock: how the controller's clock relates to this computer's.
        path: times [s], by the controller's clock, and places of the tool [m] while the arm moves, ``(4,)`` a row.
        restarts: how often the controller's clock restarted.
    """

    def __init__(self, robot: Robot) -> None:
        self._fk, self._bodies = robot.fk(), ArmShape(robot)
        self.clock, self.path, self.restarts = ClockRelation(), RowLog(), 0
        self._t: deque[float] = deque()
        self._q: deque[Array] = deque()

    def add(self, states: Sequence[ReportedState]) -> None:
        """Adds states in the order of arrival; duplicates and overtaken ones are skipped."""
        for state in states:
            if not (np.isfinite(state.t) and np.isfinite(state.q).all()):
                continue
            if self._t and not -_ANEW < state.t - self._t[-1] < _ANEW:
                self._t.clear()
                self._q.clear()
                self.clock, self.path, self.restarts = ClockRelation(), RowLog(), self.restarts + 1
            if self._t and state.t <= self._t[-1]:
                continue
            if self._q and np.abs(state.q - self._q[-1]).max() > _MOVES:
                self.path.append(np.array([state.t, *self._fk(state.q).translation]))
            self.clock.add(state.t, state.arrived)
            self._t.append(state.t)
            self._q.append(state.q)
            while self._t[-1] - self._t[0] > _REMEMBERED:
                self._t.popleft()
                self._q.popleft()

    @property
    def known(self) -> tuple[float, float]:
        """First and last time for which angles can be interpolated [s]; NaN where there are none."""
        return (self._t[1], self._t[-2]) if len(self._t) > 3 else (np.nan, np.nan)

    def q_at(self, t: float) -> Array:
        """Joint angles ``(n,)`` [rad] at a time within ``known`` [s]: a cubic through the four states about it."""
        i = min(max(bisect_left(self._t, t), 2), len(self._t) - 2)
        times = np.array([self._t[k] for k in range(i - 2, i + 2)])
        apart = t - times
        shares = [np.prod(np.delete(apart, k)) / np.prod(np.delete(times[k] - times, k)) for k in range(4)]
        return np.asarray(sum(share * self._q[i - 2 + k] for k, share in enumerate(shares)))

    def pose_at(self, t: float) -> pin.SE3:
        """Pose of the tool at a time within ``known`` [s]."""
        return self._fk(self.q_at(t))

    def shape_at(self, t: float) -> tuple[Array, Array]:
        """Parts of the arm that may cast a shadow at a time within ``known`` [s], as capsules."""
        return self._bodies.at(self.q_at(t)), self._bodies.radii


class CameraOfArm:
    """Exposes evenly on the controller's clock, once the states around an exposure are available.

    Args:
        arm: whose tool it is on.
        camera: draws and sends.
        settings: rate and exposure.
    """

    def __init__(self, arm: ArmElsewhere, camera: ServedCamera, settings: CameraSettings) -> None:
        self._arm, self._camera, self._period = arm, camera, 1.0 / settings.rate
        # A picture is drawn once the states after it are available, and before the next one is due.
        self._half, self._next = 0.5 * settings.exposure, np.nan

    def look(self) -> None:
        """Makes all exposures whose states are available."""
        first, last = self._arm.known
        if not np.isfinite(first):
            return
        begin = first + self._half
        # After a restart, or a pause in the states, missed pictures are not made.
        if not begin <= self._next <= last + self._period:
            self._next = max(begin, last - self._half)
        while self._next + self._half <= last:
            t, self._next = self._next, self._next + self._period
            instant = self._arm.clock.host(t)
            drift = 1.0 / (self._arm.clock.host(t + 1.0) - instant) - 1.0
            self._camera.expose(t, instant, DeviceClock(t, drift, instant))


def serve_camera(scene: Scene, places: CameraPlaces, unkind: Unkindness, json: Path | None, cycle: float | None,
                 say: Callable[[str], None]) -> dict[str, Any]:
    """Sends the pictures of a scene's camera on another program's arm until Ctrl-C or SIGTERM; returns statistics.

    Args:
        scene: of kind ``line``.
        places: of the arm and of the pictures.
        unkind: simulated faults of the network.
        json: file for the statistics; None for none.
        cycle: requested cycle of the states, where it can be chosen [s]; the robot's if None.
        say: prints a line.

    Raises:
        InputError: a scene of another kind, an arm that cannot be read or is another one, an address that cannot be
            listened on.
    """
    if not isinstance(scene, LineScene):
        raise InputError("only scenes of kind line are supported for the camera of another program's arm",
                         field="scene", value=scene.kind)
    robot = scene.arm if cycle is None else at_cycle(scene.arm, cycle)
    with read_arm(places.arm, robot, places.patience, "--camera-of") as reader:
        cell = set_up(scene)
        arm, stopped = ArmElsewhere(robot), list[str]()
        with _camera(cell, scene, arm, places, unkind) as camera, stopping_on_signals(stopped.append):
            _say_where(cell, scene, camera, places, say)
            eye, heard, silent = CameraOfArm(arm, camera, CameraSettings.of(scene.camera)), now(), False
            with undisturbed(priority=_PRIORITY):
                while not stopped:
                    try:
                        states = reader.read(0.05)
                    except IdealRobotError as error:
                        say(f"ended: {error}")
                        break
                    arm.add(states)
                    eye.look()
                    heard = now() if states else heard
                    if (now() - heard > _SILENT) != silent:
                        silent = not silent
                        say("no states of the arm: no pictures" if silent else "states of the arm again")
            # Written before the camera's process has ended, which takes a while: a second Ctrl-C loses nothing.
            figures = _figures(scene, cell, arm, camera)
            if json is not None:
                write_json(json, figures)
        say("; ".join(f"{key} {value}" for key, value in figures.items() if key.endswith(("_mm", "_out"))))
    return figures


@contextmanager
def _camera(cell: Cell, scene: LineScene, arm: ArmElsewhere, places: CameraPlaces, unkind: Unkindness
            ) -> Iterator[ServedCamera]:
    """The scene's camera in a process of its own."""
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence([scene.seed, 1]).spawn(4)]
    _, drawn = line_of(cell, scene)
    assert drawn is not None
    device = CameraDevice(drawn, scene.camera.rate, places.stream, DeviceClock(0.0, 0.0), unkind, streams[3],
                          places.topic, cell.known.camera)
    try:
        camera = ServedCamera(device, CameraSettings.of(scene.camera), arm.pose_at, arm.shape_at, streams[1])
    except BAD_ADDRESS as error:
        raise InputError(f"pictures cannot be sent from there ({error})", field="host:port",
                         value="{}:{}".format(*places.stream)) from error
    try:
        yield camera
    finally:
        camera.close()


def least_delay(camera: CameraTable) -> float:
    """Mean of the least delay from mid-exposure to arrival in each second [s], as a topic has no clock messages.

    Args:
        camera: of the scene, whose latency jitters normally.
    """
    return max(camera.latency - _SOONEST * camera.jitter, 0.0)


def _say_where(cell: Cell, scene: LineScene, camera: ServedCamera, places: CameraPlaces, say: Callable[[str], None]
               ) -> None:
    """Says where pictures come, and where the arm has to stand."""
    say("camera: stream://{}:{}".format(*camera.address))
    if places.topic is not None:
        say(f"camera: ros2://{places.topic} (--camera-delay {1e3 * least_delay(scene.camera):g})")
    say("the path starts at q = " + ", ".join(f"{angle:.4f}" for angle in cell.known.follower.q_start) + " rad")


def _figures(scene: LineScene, cell: Cell, arm: ArmElsewhere, camera: ServedCamera) -> dict[str, Any]:
    """What really happened, as far as the arm reports where it is."""
    path = np.array(arm.path).reshape(-1, 4)
    beside = beside_line(path[:, 0], path[:, 1:], cell.line) if len(path) else None
    return {**scene.played(), "control_error_mm": beside, "pictures_left_out": camera.left_out,
            "clock": arm.clock.report().to_dict(), "clock_restarts": arm.restarts}
