"""An arm of which everything is known: a KR 15 without friction, noise and steps, and the model that says exactly that.

What is then added to the simulated arm is its only misfit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from unittest import mock

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.feedforward.method import Setting
from ideal_robot.feedforward.registry import method
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.path.cell import Play, play
from scenes.scene_files.path_scene import JointPath, PathScene, joint_path
from sim.arm import arm as simulated
from sim.arm.specimen import Specimen, draw_specimen
from sim.arm.world import World
from sim.bullet import pybullet
from studies.report import scene_of

ROBOT = Robot.load("kr15")
WORLD = World.ideal("kr15").replace(elasticity=True)
JOINT = 2
"""The joint in which most effects are tried, from 1."""


@lru_cache(maxsize=1)
def model() -> Model:
    """The exact model."""
    n, T = ROBOT.n, ROBOT.t_ipo
    k_v, k_ff, k_p, time = (WORLD.per_joint(name, n) for name in ("position_gain", "velocity_feedforward",
                                                                  "velocity_gain", "integral_time"))
    controller = ControllerModel(T, k_v * k_p, k_ff * k_p, (k_ff - 1.0) * k_p, WORLD.velocity_filter * k_p, T / time,
                                 np.zeros(n))
    return dataclasses.replace(Model.nominal(ROBOT), controller=controller,
                               gears=Gears(WORLD.per_joint("stiffness", n), WORLD.per_joint("damping", n)))


@lru_cache(maxsize=1)
def path() -> JointPath:
    """A circle of 250 mm at 0.5 m/s."""
    scene = scene_of(PathScene, "close_stribeck").changed(path={"size_mm": 250.0}, speed=0.5)
    return joint_path(scene, ROBOT, ROBOT.t_ipo)


def played(world: World, known: Model, *, of: Specimen | None = None, along: JointPath | None = None) -> Play:
    """One play along a path, the circle if None, of the individual that the world draws if no other is given."""
    path_ = along or path()
    law = method("ideal").make(Setting(ROBOT, known, 30, 0, path_.q_d))
    with individual(of):
        return play(ROBOT, world, path_, law, np.random.default_rng(1))


@lru_cache(maxsize=1)
def aim() -> Play:
    """What the exact model leaves of the arm without an effect."""
    return played(WORLD, model())


def exact() -> Specimen:
    """The individual without an effect."""
    return draw_specimen(ROBOT, WORLD)


@contextmanager
def individual(of: Specimen | None) -> Iterator[None]:
    """Puts an individual in the place of the one that a world draws."""
    if of is None:
        yield
        return
    begin = simulated.start_physics

    def start_physics() -> int:
        client = begin()
        pybullet.setGravity(*of.model.gravity.linear, physicsClientId=client)
        return client

    with (mock.patch.object(simulated, "draw_specimen", return_value=of),
          mock.patch.object(simulated, "start_physics", start_physics)):
        yield


def recording(world: World, *, of: Specimen | None = None) -> Recording:
    """What an arm logs of a motion of all joints at several speeds, with the usual noise.

    The device that measures arm and tool is averaged over ten repetitions, as calibrations are.
    """
    t = ROBOT.t_ipo * np.arange(700.0)
    amplitude = np.array([0.35, 0.25, 0.3, 0.5, 0.4, 0.6])
    rate = np.array([0.31, 0.23, 0.27, 0.41, 0.37, 0.47])
    swell = np.clip(t / 1.5, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(t / 1.5, 0.0, 1.0))
    phase = 2.0 * np.pi * rate * t[:, None]
    q = ROBOT.home + swell[:, None] * amplitude * (np.sin(phase) + 0.25 * np.sin(2.7 * phase + 1.0))
    rest = np.tile(q[:1], (40, 1))
    q = np.concatenate([rest, q])
    times = ROBOT.t_ipo * np.arange(float(len(q)))
    motion = JointPath(q, np.zeros((len(q), 3)), times, np.ones(len(q), dtype=bool))
    noisy = world.replace(current_noise=0.005, external_position_noise=6e-6, external_rotation_noise=6e-6)
    return played(noisy, model(), of=of, along=motion).recording


def with_body(link: int, mass: float, centre: Array) -> Specimen:
    """The individual with a point mass on a link (from 1): its centre in the frame of the link's joint ``(3,)`` [m]."""
    bare = exact()
    model_: pin.Model = bare.model.copy()
    model_.inertias[link] = model_.inertias[link] + pin.Inertia(mass, np.asarray(centre), np.zeros((3, 3)))
    return dataclasses.replace(bare, model=model_)
