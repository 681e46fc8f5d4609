"""Contact of the simulated arm's tool tip with a surface whose shape only the simulator knows.

The tip is a spring on the tool frame's origin, pressed along the surface normal n and dragged against dry friction:

    F = max(0, E δ + D δ̇) n − μ F_n v_t / √(|v_t|² + v_0²)

δ is how deep the undeformed tip would be in the surface. The force acts on PyBullet's link before each 0.5 ms step, so
it deflects gears and slows joints as any load does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import GRAVITY, Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from ideal_robot.row_log import RowLog, let_go, new_array
from sensing.force.sensors import WrenchSample
from sim.arm.arm import SimulatedArm
from sim.arm.world import STEP
from sim.bullet import pybullet


@dataclass(frozen=True)
class Wave:
    """One sine of a surface: amplitude [m], wavelength [m], heading in the surface [rad], phase [rad]."""

    amplitude: float
    wavelength: float
    heading: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True)
class HeightSurface:
    """Height over a plane: sines, a bump of constant curvature, an offset and a tilt against the nominal plane.

    Attributes:
        plane: nominal plane, z out of the material.
        waves: sines that are added.
        curvature: of a cylinder about the plane's y axis, highest at ``crest``; positive: a hill [1/m].
        crest: where along x the cylinder is highest or lowest [m].
        offset: shift along z [m].
        tilt: slopes along x and y.
    """

    plane: pin.SE3
    waves: tuple[Wave, ...] = ()
    curvature: float = 0.0
    crest: float = 0.0
    offset: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)

    def height(self, x: Array | float, y: Array | float) -> Array:
        """Height over the plane at plane coordinates [m]."""
        z = self.offset + self.tilt[0] * np.asarray(x) + self.tilt[1] * np.asarray(y)
        z = z - 0.5 * self.curvature * (np.asarray(x) - self.crest) ** 2
        for wave in self.waves:
            k = 2 * np.pi / wave.wavelength
            z = z + wave.amplitude * np.sin(k * (np.cos(wave.heading) * x + np.sin(wave.heading) * y) + wave.phase)
        return np.asarray(z)

    def points(self, xy: Array) -> Array:
        """Points of the surface in the base frame ``(m, 3)`` above plane coordinates ``(m, 2)``."""
        local = np.column_stack([xy, self.height(xy[:, 0], xy[:, 1])])
        return np.asarray(local @ self.plane.rotation.T + self.plane.translation)


@dataclass(frozen=True)
class Tip:
    """The elastic tip of the tool.

    Attributes:
        stiffness: E [N/m].
        damping: D [N s/m].
        friction: μ against the surface.
        slip: v_0, speed over which friction builds up [m/s].
    """

    stiffness: float = 5000.0
    damping: float = 8.0
    friction: float = 0.15
    slip: float = 0.005

    def __post_init__(self) -> None:
        if not self.stiffness > 0 or self.damping < 0 or self.friction < 0 or not self.slip > 0:
            raise InputError("expected positive stiffness and slip, damping and friction not negative", field="tip")


class TipContact:
    """Keeps the tip of an arm's tool out of a surface while the object is attached.

    Args:
        arm: gets the forces; its ``step_hook`` is taken.
        surface, tip: the truth.
    """

    def __init__(self, arm: SimulatedArm, surface: HeightSurface, tip: Tip) -> None:
        self._arm, self.surface, self.tip = arm, surface, tip
        self._law = np.array([tip.stiffness, tip.damping, tip.friction, tip.slip, surface.offset, *surface.tilt,
                              surface.curvature, surface.crest])
        self._waves = np.array([[w.amplitude, 2 * np.pi / w.wavelength, np.cos(w.heading), np.sin(w.heading), w.phase]
                                for w in surface.waves]).reshape(-1, 5)
        self._R, self._origin = np.array(surface.plane.rotation), np.array(surface.plane.translation)
        self._before = np.full(3, np.nan)
        self._log = RowLog(9)
        arm.step_hook = self._push

    def _push(self, t: float) -> None:
        arm = self._arm
        tip = arm.tcp.translation
        self._log.reserve(1)
        row = self._log.next_row
        self._log.rows += 1
        row[0] = t
        _contact(tip, self._before, self._R, self._origin, self._law, self._waves, row)
        arm.touch(row[2:5])
        if row[2] != 0.0 or row[3] != 0.0 or row[4] != 0.0:
            pybullet.applyExternalForce(arm.body, arm.tool_link, row[2:5].tolist(), tip.tolist(), pybullet.WORLD_FRAME,
                                        physicsClientId=arm.client)

    def history(self) -> dict[str, Array]:
        """The contact quantities every 0.5 ms; in a long run they lie in files and are read when used.

        Keys: ``t (N,)`` [s], ``normal`` force ``(N,)`` [N], ``force`` on the tip in the base frame ``(N, 3)`` [N],
        ``height`` of the surface ``(N,)`` and ``tip (N, 3)`` in plane coordinates [m].
        """
        count = self._log.rows
        signals = {name: new_array(count) for name in ("t", "normal", "height")}
        signals |= {name: new_array(count, 3) for name in ("force", "tip")}
        for first, rows in self._log.blocks():
            part = slice(first, first + len(rows))
            for name, columns in (("t", 0), ("normal", 1), ("force", slice(2, 5)), ("height", 5), ("tip", slice(6, 9))):
                signals[name][part] = rows[:, columns]
            let_go(*signals.values())
        return signals

    def force_at(self, t: float) -> Array:
        """Force on the tip in the base frame ``(3,)`` at ``t`` [s], zero before the start."""
        index = min(round(t / STEP), self._log.rows - 1)
        return self._log.row(index)[2:5].copy() if index >= 0 else np.zeros(3)


@jit()
def _contact(tip: Array, before: Array, R: Array, origin: Array, law: Array, waves: Array, row: Array) -> None:
    """The law above at one instant; ``row`` gets the normal force, the force in the base frame, height and tip."""
    x = R.T @ (tip - origin)
    velocity = np.zeros(3)
    if not np.isnan(before[0]):
        velocity = (x - before) / STEP
    before[:] = x
    z = law[4] + law[5] * x[0] + law[6] * x[1] - 0.5 * law[7] * (x[0] - law[8]) ** 2
    along, across = law[5] - law[7] * (x[0] - law[8]), law[6]
    for wave in waves:
        phase = wave[1] * (wave[2] * x[0] + wave[3] * x[1]) + wave[4]
        z += wave[0] * np.sin(phase)
        steep = wave[0] * wave[1] * np.cos(phase)
        along += wave[2] * steep
        across += wave[3] * steep
    row[5], row[6:9] = z, x
    if x[2] >= z:
        return
    normal = np.array([-along, -across, 1.0]) / np.sqrt(1.0 + along * along + across * across)
    speed = normal @ velocity
    pressed = max(0.0, law[0] * (z - x[2]) * normal[2] - law[1] * speed)
    slide = velocity - speed * normal
    force = pressed * (normal - law[2] * slide / np.sqrt(slide @ slide + law[3] ** 2))
    row[1] = pressed
    row[2:5] = R @ force


# A force/torque sensor between flange and tool: bias, noise, weight of the tool, sampling rate, latency.

@dataclass(frozen=True)
class ForceSensorSettings:
    """True errors of the force sensor, and the tool that it carries.

    Attributes:
        rate: [Hz].
        latency, jitter: from measurement to availability, and its standard deviation [s].
        noise: standard deviations of force [N] and moment [N m].
        bias: standard deviations from which the constant bias of force [N] and moment [N m] is drawn.
        mass: of the tool behind the sensor [kg].
        com: its centre in the tool frame ``(3,)`` [m].
        drift: change of the bias since calibration ``(6,)`` [N, N m]; none if empty.
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
    """Samples a wrench at an even rate on its own schedule; ``rng`` draws bias, noise and jitter."""

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
