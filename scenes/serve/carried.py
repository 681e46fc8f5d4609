"""The camera and the force sensor of a served cell: they measure on clocks of their own and send when it is due."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from sensing.camera.camera_device import Gray
from sim.camera.camera import CameraSettings
from sim.camera.live_camera import LiveCamera
from sim.contact.contact import ForceSensor
from sim.devices.stream_server import DeviceClock, NetFTServer, Outbox, StreamServer, field_payload

PoseAt = Callable[[float], pin.SE3]
ShapeAt = Callable[[float], tuple[Array, Array]]
ForceAt = Callable[[float], Array]
_FIELD, _WRENCH = 2, 4
_BEHIND = 4
"""Pictures that may wait to be drawn; older ones are left out."""


class ServedCamera:
    """Exposes while the arm moves, draws in a thread of its own, and sends whole pictures.

    Args:
        camera: draws what the true camera sees.
        settings: rate, exposure, latency and what is wrong with the stamps.
        pose_at: true pose of the tool at a time of the session [s].
        shape_at: what of the arm may stand in the lamp's way then.
        clock: of the camera.
        server: to whoever looks.
        outbox: sends when it is due.
        rng: of jitter, stamps and losses.
    """

    def __init__(self, camera: LiveCamera, settings: CameraSettings, pose_at: PoseAt, shape_at: ShapeAt,
                 clock: DeviceClock, server: StreamServer, outbox: Outbox, rng: np.random.Generator) -> None:
        self._camera, self._settings, self._pose_at, self._clock = camera, settings, pose_at, clock
        self._shape_at = shape_at
        self._server, self._outbox, self._rng = server, outbox, rng
        self._number, self.left_out = 0, 0
        self._next = 0.0
        self._due: queue.Queue[tuple[int, float, float, Callable[[], Gray]] | None] = queue.Queue()
        self._thread = threading.Thread(target=self._draw, daemon=True)
        self._thread.start()

    def carry(self, t0: float, t1: float, host: float) -> None:
        """See ``sim.devices.served_arm.Carried``.

        Args:
            t0: since when, of the session [s].
            t1: until when [s].
            host: this computer's time of ``t0`` [s].
        """
        s, half = self._settings, 0.5 * self._settings.exposure
        end = host + (t1 - t0)
        # Exposures are evenly spaced on the camera's clock, whatever the arm does.
        period = 1.0 / (s.rate * (1.0 + self._clock.drift))
        if self._next < host - 10 * period:
            self._next = host
        while self._next + half < end:
            at, self._next = self._next, self._next + period
            t = t0 + at - host
            self._number += 1
            if not self._server.watched or self._rng.random() < s.loss:
                continue
            poses = [self._pose_at(t + ((i + 0.5) / s.sub_exposures - 0.5) * s.exposure)
                     for i in range(s.sub_exposures)]
            stamp = self._clock.shows(at) + s.stamp_offset + s.stamp_noise * self._rng.standard_normal()
            arrival = at + max(s.latency + s.jitter * self._rng.standard_normal(), 0.0)
            if self._due.qsize() >= _BEHIND:
                self.left_out += 1
                continue
            self._due.put((self._number, float(stamp), float(arrival),
                           partial(self._camera.picture, poses, at, self._shape_at(t))))

    def close(self) -> None:
        """No more pictures."""
        self._due.put(None)
        self._thread.join(2.0)

    def _draw(self) -> None:
        while (asked := self._due.get()) is not None:
            number, stamp, arrival, drawn = asked
            gray = drawn()
            payload = field_payload(number, gray.shape[1], gray.shape[0], gray.tobytes())
            self._outbox.put(arrival, lambda stamp=stamp, payload=payload: self._server.send(  # type: ignore[misc]
                _FIELD, stamp, payload))


class ServedForce:
    """Samples on the sensor's own clock and sends records.

    Args:
        sensor: truth of the sensor.
        rate: samples a second [Hz].
        drift: by how much the sensor's clock runs fast.
        pose_at: true pose of the tool at a time of the session [s].
        force_at: true force on the tip in the base frame ``(3,)`` [N].
        server: to whoever asked.
        outbox: sends when it is due.
    """

    def __init__(self, sensor: ForceSensor, rate: float, drift: float, pose_at: PoseAt, force_at: ForceAt,
                 server: NetFTServer, outbox: Outbox) -> None:
        self._sensor, self._period = sensor, 1.0 / (rate * (1.0 + drift))
        self._pose_at, self._force_at, self._server, self._outbox = pose_at, force_at, server, outbox
        self._number, self._next = 1000, 0.0

    def carry(self, t0: float, t1: float, host: float) -> None:
        """See ``sim.devices.served_arm.Carried``.

        Args:
            t0: since when, of the session [s].
            t1: until when [s].
            host: this computer's time of ``t0`` [s].
        """
        end = host + (t1 - t0)
        if self._next == 0.0:
            self._next = host
        while self._next < end:
            at, self._next = self._next, self._next + self._period
            self._number += 1
            if at < host - 1.0:
                # The whole program stood still: the sensor went on without anybody who could tell what it measured.
                continue
            t = t0 + at - host
            sample = self._sensor.sample(t, self._pose_at(t), self._force_at(t))
            record = self._server.record(self._number, sample.wrench)
            self._outbox.put(at + sample.t_arrival - t,
                             lambda record=record: self._server.send(record))  # type: ignore[misc]
