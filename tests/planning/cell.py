"""A small cell for the planning tests: kr6, a sine-like reference, a line drawn elsewhere, a camera of geometry."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.line.deviation_model import DeviationModel
from planning.line.line_follower import LineFollower
from planning.path.joint_path import JointPath
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile

T = 0.012


@cache
def kr6() -> Robot:
    return Robot.load("kr6")


def sine_points(amplitude: float = 0.03, wavelength: float = 0.8, length: float = 1.0) -> Array:
    """A sine-like curve in front of the robot, along the base's y axis."""
    x = np.linspace(0.0, length, 2001)
    return np.column_stack([0.98 - amplitude * np.sin(2 * np.pi * x / wavelength), x - 0.5 * length, 0.35 + 0 * x])


@cache
def reference() -> ReferencePath:
    return ReferencePath(sine_points(), turning=1.0)


class Constant(DeviationModel):
    """The same deviation everywhere, to a standard deviation known beforehand [m]: [L] (5), averaged."""

    def __init__(self, sigma: float, directions: int = 1) -> None:
        self.sigma, self.directions, self.size = sigma, directions, directions

    def prior(self) -> tuple[Array, Array]:
        return np.zeros(self.size), self.sigma**2 * np.eye(self.size)

    def basis(self, s: Array, stand: object = None) -> Array:
        return np.broadcast_to(np.eye(self.size), (len(s), self.size, self.size)).copy()


@cache
def joint_path() -> JointPath:
    return JointPath.of(kr6(), reference())


@cache
def profile(speed: float = 0.7) -> SpeedProfile:
    return SpeedProfile.plan(kr6(), reference(), Limits(speed), joint_path())


def displaced(points: Array, across: float = 0.01, along: float = 0.004, turn: float = 0.015) -> Array:
    """The points moved and turned in their plane."""
    c, s = np.cos(turn), np.sin(turn)
    middle = points.mean(axis=0)
    return (points - middle) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + middle + np.array([across, along, 0.0])


def distance(tcp: Array, line: Array) -> Array:
    """Distance of points from a polyline ``(m,)`` [m]."""
    a, b = line[:-1], line[1:]
    edge = b - a
    out = np.empty(len(tcp))
    for i, p in enumerate(tcp):
        u = np.clip(np.sum((p - a) * edge, axis=1) / np.sum(edge * edge, axis=1), 0.0, 1.0)
        out[i] = np.min(np.linalg.norm(p - a - u[:, None] * edge, axis=1))
    return out


@dataclass
class Seen:
    """A camera field as the follower takes it."""

    t: float
    points_tcp: Array
    sigma: Array
    used: Array
    seen: bool = True


@dataclass
class Camera:
    """Finds the line where the predicted points' lateral directions cut it, with noise; knows the true pose."""

    line: Array
    rng: np.random.Generator
    noise: float = 3e-5
    yaw: float = 0.0

    def look(self, follower: LineFollower, t: float, pose: pin.SE3, stamp: float = 0.0) -> Seen:
        ahead = follower.predict(t)
        points = np.full((len(ahead.s), 3), np.nan)
        for i, (p, along, up) in enumerate(zip(ahead.points, ahead.tangents, ahead.up, strict=True)):
            before = (self.line - p) @ along
            cuts = np.flatnonzero((before[:-1] < 0) & (before[1:] >= 0))
            if len(cuts) == 0:
                continue
            j = min(cuts, key=lambda k: float(np.linalg.norm(self.line[k] - p)))
            w = before[j] / (before[j] - before[j + 1])
            points[i] = (
                (1 - w) * self.line[j] + w * self.line[j + 1] + self.noise * self.rng.normal() * np.cross(up, along)
            )
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        local = (points - pose.translation) @ pose.rotation @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        used = np.isfinite(local).all(axis=1)
        return Seen(t + stamp, local, np.full(len(local), self.noise), used, bool(used.sum() >= 3))


@dataclass
class Run:
    """What a run with an ideal arm gave: per cycle time, TCP, desired positions; fields as they were handed over."""

    t: Array
    tcp: Array
    horizons: list[Array]
    fields: list[Seen] = field(repr=False)


def follow(
    follower: LineFollower,
    camera: Camera,
    *,
    latency: float = 0.04,
    rate: float = 50.0,
    blind: tuple[float, float] = (9, 9),
    shuffle: bool = False,
    stamp: float = 0.0,
) -> Run:
    """Runs the follower around an arm that follows its commands exactly.

    Args:
        follower: what is tested.
        camera: what it sees with.
        latency: from exposure to arrival [s].
        rate: fields a second.
        blind: arc lengths of the TCP between which nothing is seen [m].
        shuffle: every third field is so late that the next two overtake it.
        stamp: error of the time stamps [s].
    """
    kinematics = follower.robot.fk()
    under_way: list[tuple[float, Seen]] = []
    times, tcp, horizons, fields = [], [], [], []
    count, exposures = int(follower.duration / T) + 2, 0
    for k in range(count):
        t = k * T
        arrived = [f for due, f in under_way if due <= t]
        under_way = [(due, f) for due, f in under_way if due > t]
        for seen in arrived:
            follower.update(seen)
            fields.append(seen)
        q_d = follower.horizon(t)
        follower.observe(t, q_d[0])
        horizons.append(q_d)
        times.append(t)
        tcp.append(kinematics(q_d[0]).translation)
        while exposures / rate <= t - 2 * T:
            # Looked at two cycles later, so that the interpolated pose is that of the finished motion.
            exposure = exposures / rate
            exposures += 1
            if exposure < 3 * T:
                continue
            seen = camera.look(follower, exposure, follower.history.pose(exposure), stamp)
            s = float(follower.profile.s(exposure))
            if blind[0] < s < blind[1]:
                seen = Seen(seen.t, seen.points_tcp, seen.sigma, np.zeros(len(seen.used), dtype=bool), False)
            delay = latency + (0.05 if shuffle and exposures % 3 == 0 else 0.0)
            under_way.append((max(exposure + delay, t + 1e-9), seen))
    return Run(np.array(times), np.array(tcp), horizons, fields)
