"""Camera and force sensor of a served cell: they measure on their own clocks and send at their due times."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import BAD_ADDRESS, InputError
from scenes.online.processes import called, undisturbed
from sensing.camera.camera_model import CameraModel
from sensing.stream import Kind
from sim.camera.camera import CameraSettings
from sim.camera.live_camera import LiveCamera
from sim.contact.contact import ForceSensor
from sim.devices.ros2_camera import ImageTopic
from sim.devices.stream_server import (
    DeviceClock,
    NetFTServer,
    Outbox,
    StreamServer,
    Unkindness,
    camera_description,
    field_payload,
    now,
)

PoseAt = Callable[[float], pin.SE3]
ShapeAt = Callable[[float], tuple[Array, Array]]
ForceAt = Callable[[float], Array]
_BEHIND = 2
"""Pictures that may be drawn or wait for it: where there are as many the next one is left out, and comes not late."""
_STARTS = 20.0
"""Time within which the camera's process listens [s]."""
_PRIORITY = 20
"""Real-time priority of drawing, below that of the cell, which must not wait for a picture."""


@dataclass(frozen=True)
class CameraDevice:
    """The description that a camera's process gets at its start.

    Attributes:
        camera: the simulated camera.
        rate: pictures a second [Hz].
        address: of this computer on which it listens; port 0 for any free one.
        topic: of ROS 2 on which pictures are published, too; None without one.
        calibrated: the camera as it is believed to be, for the topic's ``CameraInfo``.
    """

    camera: LiveCamera
    rate: float
    address: tuple[str, int]
    clock: DeviceClock
    unkind: Unkindness
    rng: np.random.Generator
    topic: str | None = None
    calibrated: CameraModel | None = None


@dataclass(frozen=True)
class Exposure:
    """A picture to be drawn: number, stamp, arrival [s], arguments of ``LiveCamera.picture``, and the stamp's clock."""

    number: int
    stamp: float
    arrival: float
    poses: Sequence[pin.SE3]
    at: float
    shape: tuple[Array, Array]
    clock: DeviceClock


def draw_and_send(pipe: Connection) -> None:
    """Runs the camera's process: listens for clients, draws pictures while there are any, and sends them.

    The pipe delivers the camera, then exposures, and None for the end; it returns the address, or an error, then one
    word per picture.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        device: CameraDevice = pipe.recv()
    except (EOFError, OSError):  # the process that started this one has ended
        return
    model, clock = device.camera.model, device.clock
    with ExitStack() as stack:
        try:
            server = StreamServer(*device.address, lambda: clock.shows(now()), 1,
                                  camera_description(model.width, model.height, device.rate))
            stack.callback(server.close)
            topic = None if device.topic is None else ImageTopic(device.topic, device.calibrated or model)
        except (*BAD_ADDRESS, InputError) as error:
            pipe.send(str(error))
            return
        if topic is not None:
            stack.callback(topic.close)
        outbox = Outbox(device.unkind, device.rng)
        stack.callback(outbox.close)
        pipe.send(server.address)
        with suppress(EOFError, OSError), undisturbed(priority=_PRIORITY):
            while (exposure := pipe.recv()) is not None:
                clock = exposure.clock
                watched = server.watched, topic is not None and topic.watched
                if any(watched):
                    gray = device.camera.picture(exposure.poses, exposure.at, exposure.shape)
                if watched[0]:
                    payload = field_payload(exposure.number, gray.shape[1], gray.shape[0], gray.tobytes())
                    outbox.put(exposure.arrival, partial(server.send, Kind.FIELD, exposure.stamp, payload))
                if watched[1] and topic is not None:
                    outbox.put(exposure.arrival, partial(topic.send, exposure.stamp, gray))
                pipe.send(any(watched))


class ServedCamera:
    """Exposes while the arm moves; a separate process draws and sends whole pictures.

    Args:
        device: the camera.
        settings: exposure, latency and errors of the stamps.
        pose_at: true pose of the tool at a time of the session [s].
        shape_at: parts of the arm that may cast a shadow at a time.
        rng: of jitter, stamps and losses.

    Raises:
        OSError: the address cannot be listened on.

    Attributes:
        address: address at which it listens.
        left_out: pictures that were not drawn because others waited.
    """

    def __init__(self, device: CameraDevice, settings: CameraSettings, pose_at: PoseAt, shape_at: ShapeAt,
                 rng: np.random.Generator) -> None:
        self._settings, self._clock, self._rng = settings, device.clock, rng
        self._pose_at, self._shape_at = pose_at, shape_at
        self._number, self._waiting, self._next, self.left_out = 0, 0, 0.0, 0
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=called, args=("scenes.serve.carried:draw_and_send", theirs), daemon=True)
        self._process.start()
        theirs.close()
        # Sent by the pipe, not as an argument: a process whose parent ends while it reads arguments prints a traceback.
        with suppress(OSError):
            self._pipe.send(device)
        reply = self._pipe.recv() if self._pipe.poll(_STARTS) else f"the camera does not begin within {_STARTS:g} s"
        if isinstance(reply, str):
            self.close()
            raise OSError(reply)
        self.address: tuple[str, int] = reply

    def carry(self, t0: float, t1: float, host: float) -> None:
        """Notifies the device that the arm has moved from ``t0`` to ``t1`` [s]; see ``Carried.carry``."""
        s, half = self._settings, 0.5 * self._settings.exposure
        end = host + (t1 - t0)
        # Exposures are evenly spaced on the camera's clock, whatever the arm does.
        period = 1.0 / (s.rate * (1.0 + self._clock.drift))
        if self._next < host - 10 * period:
            self._next = host
        while self._next + half < end:
            instant, self._next = self._next, self._next + period
            self.expose(t0 + instant - host, instant, self._clock)

    def expose(self, t: float, instant: float, clock: DeviceClock) -> None:
        """Exposes once; the picture is drawn and sent by another process.

        Args:
            t: middle of the exposure, of the session [s].
            instant: the same by this computer's time [s].
            clock: of the picture's stamp.
        """
        s = self._settings
        self._number += 1
        if self._rng.random() < s.loss:
            return
        poses = [self._pose_at(t + ((i + 0.5) / s.sub_exposures - 0.5) * s.exposure) for i in range(s.sub_exposures)]
        stamp = clock.shows(instant) + s.stamp_offset + s.stamp_noise * self._rng.standard_normal()
        arrival = instant + max(s.latency + s.jitter * self._rng.standard_normal(), 0.0)
        self._ask(Exposure(self._number, float(stamp), float(arrival), poses, instant, self._shape_at(t), clock))

    def _ask(self, exposure: Exposure) -> None:
        """Never waits; a camera whose process has ended sends nothing any more."""
        with suppress(OSError, EOFError):
            while self._pipe.poll():
                self._pipe.recv()
                self._waiting -= 1
            if self._waiting >= _BEHIND:
                self.left_out += 1
                return
            self._pipe.send(exposure)
            self._waiting += 1

    def close(self) -> None:
        """Stops sending pictures."""
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(2.0)
        self._process.kill()


class ServedForce:
    """Samples on the sensor's own clock and sends records.

    Args:
        sensor: truth of the sensor.
        rate: samples a second [Hz].
        drift: by how much the sensor's clock runs fast.
        pose_at: true pose of the tool at a time of the session [s].
        force_at: true force on the tip in the base frame ``(3,)`` [N].
        server: sends records to clients.
        outbox: sends when it is due.
    """

    def __init__(self, sensor: ForceSensor, rate: float, drift: float, pose_at: PoseAt, force_at: ForceAt,
                 server: NetFTServer, outbox: Outbox) -> None:
        self._sensor, self._period = sensor, 1.0 / (rate * (1.0 + drift))
        self._pose_at, self._force_at, self._server, self._outbox = pose_at, force_at, server, outbox
        self._number, self._next = 1000, 0.0

    def carry(self, t0: float, t1: float, host: float) -> None:
        """Notifies the device that the arm has moved from ``t0`` to ``t1`` [s]; see ``Carried.carry``."""
        end = host + (t1 - t0)
        if self._next == 0.0:
            self._next = host
        while self._next < end:
            instant, self._next = self._next, self._next + self._period
            self._number += 1
            if instant < host - 1.0:
                # The whole program was blocked: the samples of that time are lost.
                continue
            t = t0 + instant - host
            sample = self._sensor.sample(t, self._pose_at(t), self._force_at(t))
            record = self._server.record(self._number, sample.wrench)
            self._outbox.put(instant + sample.t_arrival - t, partial(self._server.send, record))
