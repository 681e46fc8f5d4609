"""The models that are shipped for the simulated arms: identified from recordings of the default world, as a user would.

Nothing is read from the world but what a controller logs and an external measuring device sees.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ideal_robot.identification.closed_loop_fit import fit_controller
from ideal_robot.identification.excitation import approach, design_excitation
from ideal_robot.identification.idim import Identification, identify
from ideal_robot.identification.stiffness_from_arm import stiffness_from_arm
from ideal_robot.interface import Array, RobotInterface
from ideal_robot.model import Model
from ideal_robot.recording import Recording
from ideal_robot.robot import Robot


def play(arm: RobotInterface, commands: Array, progress: Callable[[float], None] | None = None) -> None:
    """Hands over the commands ``(N, n)`` one after another."""
    for k, q_c in enumerate(commands):
        arm.cycle(q_c)
        if progress is not None and k % 100 == 0:
            progress(k / len(commands))


def identification_motion(robot: Robot, start: Array, *, seed: int = 1, period: float = 20.0, periods: int = 1,
                          t_ipo: float = 0.012) -> Array:
    """Commands ``(N, n)`` from ``start`` through periods of an optimised Fourier motion and slow reversals."""
    rng = np.random.default_rng(seed)
    motion = design_excitation(robot, rng, period=period)
    t = np.asarray(np.arange(1, round(periods * period / t_ipo) + 1) * t_ipo, dtype=float)
    q = motion.at(t)[0]
    first = motion.at(np.zeros(1))[0][0]
    a_max = np.where(np.isfinite(robot.a_max), robot.a_max, 10.0)
    v_max = np.where(np.isfinite(robot.v_max), robot.v_max, 2.0)
    lead = approach(start, first, t_ipo, v_max, a_max)
    hold = np.repeat(first[None], round(0.3 / t_ipo), axis=0)
    slow = slow_reversals(q[-1], t_ipo, v_max)
    return np.concatenate([lead, hold, q, hold, slow])


def slow_reversals(q0: Array, t_ipo: float, v_max: Array, duration: float = 8.0) -> Array:
    """All joints back and forth about ``q0`` at one to eight per cent of their speed: what paths of tools look like."""
    t = np.arange(1, round(duration / t_ipo) + 1) * t_ipo
    w = 2.0 * np.pi / duration * np.array([2.0, 3.0, 5.0, 7.0, 4.0, 6.0])[np.arange(len(q0)) % 6]
    size = 0.08 * v_max / w
    envelope = np.sin(np.pi * t / duration)[:, None] ** 2
    return np.asarray(q0 + envelope * size * np.sin(np.outer(t, w)))


def identified_model(robot_name: str, *, seed: int = 1, period: float = 20.0,
                     progress: Callable[[float], None] | None = None,
                     ) -> tuple[Model, Identification, Sequence[Recording]]:
    """Plays the identification motion in the default world of a simulated arm and identifies everything from it."""
    from sim.arm import SimulatedArm
    from sim.world import World

    robot = Robot.load(robot_name)
    world = World.default(robot_name)
    recordings = []
    for run in range(2):
        with SimulatedArm(robot, world, np.random.default_rng(seed + run)) as arm:
            play(arm, identification_motion(robot, arm.truth.q_m, seed=seed + run, period=period, t_ipo=arm.t_ipo),
                 progress)
            recordings.append(arm.recording(external=True))
    result = identify(recordings, robot)
    controller = fit_controller(recordings[0], robot).controller
    stiffness, damping = stiffness_from_arm(recordings, result.model)
    model = dataclasses.replace(result.model, controller=controller, stiffness=stiffness, damping=damping)
    return model, result, recordings


def write_models(names: Sequence[str], folder: Path) -> list[Path]:
    """Identifies and writes the shipped models."""
    return [identified_model(name)[0].save(folder / f"{name}.json") for name in names]


if __name__ == "__main__":
    import sys

    for path in write_models(sys.argv[1:] or ["kr6", "kr15", "manutec_r15"], Path(__file__).parent / "models"):
        print(path)
