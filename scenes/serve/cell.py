"""A scene's simulated cell behind devices: controller, camera, force sensor, and the true results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import BAD_ADDRESS, InputError
from ideal_robot.rsi.message import Axes
from scenes.force.cell import Cell as ForceCell
from scenes.force.cell import glue_line, true_tip
from scenes.force.cell import set_up as set_up_force
from scenes.line.cell import Cell as LineCell
from scenes.line.cell import lamp_over
from scenes.line.cell import set_up as set_up_line
from scenes.line.cell import streams as line_streams
from scenes.metrics import ControlError
from scenes.online.log import SETTLING
from scenes.online.processes import stopping_on_signals, undisturbed
from scenes.report.page import write_json
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene
from scenes.serve.carried import CameraDevice, ServedCamera, ServedForce
from sim.arm.arm import SimulatedArm
from sim.arm.world import STEP
from sim.camera.image_chain import CameraSettings
from sim.camera.lamp import ArmShape
from sim.camera.live_camera import LiveCamera
from sim.camera.surface import DrawnLine
from sim.contact.contact import TipContact
from sim.devices.served_arm import Carried, ServedArm, ServedEgm, ServedRos2, ServedRtde, Session
from sim.devices.stream_server import DeviceClock, NetFTServer, Outbox, Unkindness

MARGIN = 0.002
"""Distance from where the travel on the surface begins and ends within which the force does not count [m]."""


CONTROLLERS: dict[str, type[ServedArm]] = {"rsi": ServedArm, "rtde": ServedRtde, "egm": ServedEgm, "ros2": ServedRos2}
"""Controllers that a cell can be served behind, by the scheme of their address."""


@dataclass(frozen=True)
class Places:
    """Addresses of the devices.

    Attributes:
        arm: where the follower listens for RSI or EGM, or this controller for RTDE.
        host: address of this computer on which camera and force sensor listen.
        camera, force: ports; 0 for any free one.
        relative: whether corrections add up.
        scheme: which interface the controller speaks: a key of ``CONTROLLERS``.
        namespace: of ROS 2's topics.
    """

    arm: tuple[str, int] = ("127.0.0.1", 49152)
    host: str = "127.0.0.1"
    camera: int = 50001
    force: int = 49151
    relative: bool = False
    scheme: str = "rsi"
    namespace: str = ""


class ServedCell:
    """A simulated cell in real time.

    Args:
        cell: the scene set up.
        arm: at its start.
        line: the drawn line; None without one.
        contact: creates a new contact of the tip; None without contact.

    Attributes:
        camera, force: where they listen; None where the scene has none.
    """

    def __init__(self, cell: LineCell | ForceCell, arm: SimulatedArm, line: DrawnLine | None,
                 contact: Callable[[], TipContact] | None) -> None:
        self.cell, self.arm, self._line, self._new_contact = cell, arm, line, contact
        self.contact = contact() if contact is not None else None
        self._bodies = ArmShape(cell.known.robot)
        self.camera: tuple[str, int] | None = None
        self.force: tuple[str, int] | None = None

    def pose_at(self, t: float) -> pin.SE3:
        """True pose of the tool at a time of the session [s]; the present one where the arm has not moved yet."""
        return self.arm.tcp_at(min(max(t, 0.0), self.arm.t)) if self.arm.t > 0 else self.arm.truth.tcp

    def anew(self) -> None:
        """Restarts the times of arm and contact."""
        self.contact = None if self._new_contact is None else self._new_contact()

    def shape_at(self, t: float) -> tuple[Array, Array]:
        """Parts of the arm that may cast a shadow at a time of the session [s], as capsules."""
        q = self.arm.q_at(min(max(t, 0.0), self.arm.t)) if self.arm.t > 0 else self.arm.truth.q_a
        return self._bodies.at(q), self._bodies.radii

    def force_at(self, t: float) -> Array:
        """True force on the tip in the base frame ``(3,)`` [N]."""
        return np.zeros(3) if self.contact is None or self.arm.t == 0 else self.contact.force_at(t)

    def truth(self, session: Session) -> dict[str, Any]:
        """True figures of a session, which no device reports."""
        commands = np.array(session.commands)
        T, limits = self.arm.t_ipo, self.arm.robot.a_max
        steps = np.diff(commands, axis=0, prepend=commands[:1])
        sharp = np.abs(np.diff(steps, axis=0)).max(axis=0) / T**2 if len(steps) > 1 else np.zeros(len(limits))
        figures: dict[str, Any] = {
            "ended": session.ended, "cycles": len(commands), "answered": session.answered, "late": session.late,
            "held_up": session.held_up, "slipped": session.slipped,
            "largest_acceleration_share": float(np.max(sharp / limits)),
            "at_rest": bool(np.abs(steps[-3:]).max() < 1e-9) if len(steps) > 3 else True}
        if self._line is not None:
            figures["control_error_mm"] = beside_line(*self.arm.tcp_path(), self._line)
        if self.contact is not None:
            figures["force_N"] = self._pressed(self.contact)
        return figures

    def _pressed(self, contact: TipContact) -> dict[str, float]:
        """Normal force while the tip is on the surface and travels."""
        history, wanted = contact.history(), float(self.cell.known.scene.force)  # type: ignore[union-attr]
        force, tip = history["normal"], history["tip"]
        figures = {"rms_error": float("nan"), "largest": float(force.max(initial=0.0))}
        touched = np.flatnonzero(force > 0.0)
        if len(touched) > 1:
            # The calibration pressed before, too: the last contact is used, between its ends.
            apart = np.flatnonzero(np.diff(touched) > round(0.3 / STEP))
            first, last = touched[0 if not len(apart) else apart[-1] + 1], touched[-1]
            visit = slice(first, last + 1)
            begun, ended = (np.linalg.norm((tip[visit] - tip[row])[:, :2], axis=1) > MARGIN for row in (first, last))
            error = force[visit][begun & ended] - wanted
            if len(error):
                figures["rms_error"] = float(np.sqrt(np.mean(error**2)))
        return figures


def beside_line(t: Array, tcp: Array, line: DrawnLine) -> dict[str, float]:
    """Distance of the tool from the drawn line in the surface on its last visit [mm]; see ``ControlError.json_mm``.

    Args:
        t: times ``(N,)`` [s].
        tcp: places of the tool then ``(N, 3)`` [m].
        line: the drawn line.
    """
    s, lateral = line.beside(tcp)
    counts = (s > 1e-6) & (s < line.length - 1e-6)
    if counts.any():
        # The calibration visited the line before, too: the last visit is used.
        last = len(t) - int(np.argmax(counts[::-1]))
        outside = np.flatnonzero(~counts[:last])
        counts &= t >= t[int(outside[-1]) + 1 if len(outside) else 0] + SETTLING
    return ControlError.of(t, s, lateral, counts).json_mm()


@contextmanager
def _served_cell(scene: Scene, places: Places, unkind: Unkindness) -> Iterator[tuple[ServedCell, ServedArm]]:
    """The devices of a scene; they listen from now on, and the arm is led as soon as ``sessions`` is called."""
    if not isinstance(scene, LineScene | ForceScene):
        raise InputError("only scenes of kind line and force have devices", field="scene", value=scene.kind)
    cell: LineCell | ForceCell = set_up_line(scene) if isinstance(scene, LineScene) else set_up_force(scene)
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence([scene.seed, 1]).spawn(4)]
    start = cell.known.follower.q_start if isinstance(cell, LineCell) else cell.known.q_start()
    _loaded(cell, start)
    with ExitStack() as stack:
        arm = stack.enter_context(SimulatedArm(cell.known.robot, cell.world, cell.noise, start))
        outbox = Outbox(unkind, streams[0])
        stack.callback(outbox.close)
        line, drawn = line_of(cell, scene)
        contact = (lambda: TipContact(arm, cell.surface, true_tip(cell.known.scene.tip))
                   ) if isinstance(cell, ForceCell) else None
        served = ServedCell(cell, arm, line, contact)
        carried: list[Carried] = []
        try:
            if drawn is not None:
                device = CameraDevice(drawn, scene.camera.rate, (places.host, places.camera),
                                      DeviceClock(100.0 + unkind.offset, unkind.drift), unkind, streams[3])
                camera = ServedCamera(device, CameraSettings.of(scene.camera), served.pose_at, served.shape_at,
                                      streams[1])
                stack.callback(camera.close)
                served.camera = camera.address
                carried.append(camera)
            if isinstance(cell, ForceCell) and isinstance(scene, ForceScene):
                netft = NetFTServer(places.host, places.force)
                stack.callback(netft.close)
                force = ServedForce(cell.sensor, scene.sensor.rate, -unkind.drift, served.pose_at, served.force_at,
                                    netft, outbox)
                served.force = netft.address
                carried.append(force)
            named = {"namespace": places.namespace} if places.scheme == "ros2" else {}
            served_arm = CONTROLLERS[places.scheme](
                arm, places.arm, **named, relative=places.relative, unkind=unkind, rng=streams[2],
                carried=tuple(carried), sign=Axes.of(cell.known.robot).sign)
            served_arm.anew = served.anew
        except BAD_ADDRESS as error:
            raise InputError(f"cannot listen there ({error})", field="host:port", value=places.host) from error
        yield served, served_arm


def _loaded(cell: LineCell | ForceCell, start: Array) -> None:
    """Moves an arm for a cycle that is thrown away: a controller that compiles its code is silent to its follower."""
    with SimulatedArm(cell.known.robot, cell.world, np.random.default_rng(0), start) as arm:
        contact = TipContact(arm, cell.surface, true_tip(cell.known.scene.tip)) if isinstance(cell, ForceCell) else None
        arm.cycle(start)
        if contact is not None:
            contact.force_at(arm.t)
        arm.tcp_at(0.5 * arm.t)


def line_of(cell: LineCell | ForceCell, scene: LineScene | ForceScene) -> tuple[DrawnLine | None, LiveCamera | None]:
    """The drawn line of a scene and the camera over it."""
    table, settings = scene.camera, CameraSettings.of(scene.camera)
    if table.rolling_ms > 0.0:
        raise InputError("a served camera exposes all rows together", field="camera.rolling_ms", value=table.rolling_ms)
    if isinstance(cell, LineCell):
        lamp = lamp_over(scene, cell.geometry, line_streams(scene)[6])  # type: ignore[arg-type]
        return cell.line, LiveCamera(cell.true_camera, cell.line, settings, cell.camera_noise, lamp=lamp,
                                     relief=cell.relief, tool=table.renderer == "bullet")
    if cell.known.scene.task != "glue":
        return None, None
    line, true = glue_line(cell)
    return line, LiveCamera(true, line, settings, cell.camera_streams[0], relief=cell.surface)


_PRIORITY = 30
"""Below that of a follower on the same computer: the time the world takes must not be counted as the follower's."""


def serve_scene(scene: Scene, places: Places, unkind: Unkindness, sessions: int, json: Path | None,
                say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Serves a scene's cell until Ctrl-C or SIGTERM; returns the results of each session.

    Args:
        scene: of kind ``line`` or ``force``.
        places: where the devices are.
        unkind: simulated faults of clocks and network.
        sessions: after how many it ends; 0 for no end.
        json: file for the results of the last session; None for none.
        say: prints a line.

    Raises:
        InputError: a scene of another kind, or an address that cannot be listened on.
    """
    summaries: list[dict[str, Any]] = []
    with _served_cell(scene, places, unkind) as (cell, arm):
        def done(session: Session) -> None:
            figures = {"session": len(summaries) + 1, **scene.played(), **cell.truth(session)}
            summaries.append(figures)
            if json is not None:
                write_json(json, figures)
            say(f"session {len(summaries)}: {session.answered} of {session.answered + session.late} cycles answered; "
                f"{session.ended}; "
                + "; ".join(f"{key} {value}" for key, value in figures.items() if key.endswith(("_mm", "_N"))))

        with stopping_on_signals(lambda _: arm.stop()), undisturbed(priority=_PRIORITY):
            _say_where(cell, places, scene, say)
            arm.sessions(sessions, done)
    return summaries


def _say_where(cell: ServedCell, places: Places, scene: Scene, say: Callable[[str], None]) -> None:
    """Says where the devices are, once they answer."""
    if places.scheme == "ros2":
        say(f"controller: ros2://{places.namespace}")
    else:
        say("controller: {} {}:{}".format("listens on" if places.scheme == "rtde" else "sends to", *places.arm))
    if cell.camera is not None:
        say("camera: stream://{}:{}".format(*cell.camera))
    if cell.force is not None and isinstance(scene, ForceScene):
        say("force: netft://{}:{}?rate={:g}".format(*cell.force, scene.sensor.rate))
