"""A force/torque sensor between flange and tool: bias, noise, weight of the tool, sampling rate, latency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.force.wrench import WrenchSample

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class ForceSensorSettings:
    """Truth of the sensor and of the tool that hangs on it.

    Attributes:
        rate: [Hz].
        latency: from measurement to availability [s].
        jitter: standard deviation of the latency [s].
        noise: standard deviations of force [N] and moment [N m].
        bias: standard deviations from which the constant bias of force [N] and moment [N m] is drawn.
        mass: of the tool behind the sensor [kg].
        com: its centre in the tool frame ``(3,)`` [m].
        drift: what the bias has changed by since calibration ``(6,)`` [N, N m]; none if empty.
        lie: from and to [s]: the sensor reports nonsense; none if empty.
    """

    rate: float = 250.0
    latency: float = 0.02
    jitter: float = 0.0005
    noise: tuple[float, float] = (0.3, 0.02)
    bias: tuple[float, float] = (3.0, 0.1)
    mass: float = 0.8
    com: tuple[float, float, float] = (0.0, 0.01, -0.08)
    drift: tuple[float, ...] = ()
    lie: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.rate > 0 or self.latency < 0 or self.jitter < 0 or self.mass < 0:
            raise InputError("expected a positive rate; latency, jitter and mass not negative", field="force_sensor")
        if self.drift and len(self.drift) != 6:
            raise InputError("expected six components [N, N m]", field="force_sensor.drift", value=list(self.drift))


class ForceSensor:
    """Samples at an even rate on its own schedule.

    Args:
        settings: truth of the sensor.
        rng: draws bias, noise and jitter.
    """

    def __init__(self, settings: ForceSensorSettings, rng: np.random.Generator) -> None:
        self.settings, self._rng = settings, rng
        self._bias = np.repeat(settings.bias, 3) * rng.standard_normal(6)
        if settings.drift:
            self._bias = self._bias + np.asarray(settings.drift)
        self._noise = np.repeat(settings.noise, 3)
        self._phase = float(rng.uniform(0, 1 / settings.rate))
        self._next = 0

    def due(self, t0: float, t1: float, pose_at: Callable[[float], pin.SE3],
            force_at: Callable[[float], Array]) -> list[WrenchSample]:
        """Samples measured in [t0, t1).

        Args:
            t0: begin [s].
            t1: end [s].
            pose_at: true pose of the tool frame at a time.
            force_at: true force on the tool frame's origin in the base frame at a time ``(3,)`` [N].
        """
        s = self.settings
        samples = []
        first = int(np.ceil((t0 - self._phase) * s.rate - 1e-9))
        self._next = max(self._next, first)
        while (t := self._phase + self._next / s.rate) < t1 - 1e-12:
            self._next += 1
            if t < t0 - 1e-12:
                continue
            samples.append(self.sample(t, pose_at(t), force_at(t)))
        return samples

    def sample(self, t: float, pose: pin.SE3, force: Array) -> WrenchSample:
        """One sample at a given true pose and force.

        Args:
            t: instant of the measurement [s].
            pose: true pose of the tool frame in the base frame.
            force: true force on the tool frame's origin in the base frame ``(3,)`` [N].
        """
        s = self.settings
        if s.lie and s.lie[0] <= t < s.lie[1]:
            wrench = 40.0 * self._rng.standard_normal(6)
        else:
            weight = pose.rotation.T @ (s.mass * GRAVITY)
            (x, y, z), (a, b, c) = s.com, weight
            wrench = np.array([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])
            wrench[:3] += pose.rotation.T @ force
            wrench += self._bias + self._noise * self._rng.standard_normal(6)
        delay = max(0.0, s.latency + s.jitter * float(self._rng.standard_normal()))
        return WrenchSample(t, t + delay, wrench)
