"""Whether the standard deviations of what adaptation learns of friction are true."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.friction_adaptation import FrictionAdaptation, FrictionFactors
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.feedforward.learned_friction import INTERVAL, noise_variance
from ideal_robot.feedforward.training_motion import training_motion
from ideal_robot.friction.table import Friction, largest_speeds
from ideal_robot.friction.terms import OWN, SHARED, TERMS, dry_sizes, friction_terms, table_terms, with_terms
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.interface import RobotState
from scenes import load_scene
from scenes.path.cell import PathCell, set_up
from sim.arm.arm import SimulatedArm
from studies.closings import with_true_friction
from studies.report import head, row

Engine = Callable[[PathCell, Array, np.random.Generator], tuple[FrictionFactors, Friction]]
"""Learns along a motion ``(N, n)`` [rad]; gives what is known then, and the true friction."""

SPEEDS = np.array([0.01, 0.02, 0.05, 0.1, 0.2])
"""At which friction is compared, as shares of each joint's largest speed; where its motion reached them."""
_COMMON = 3
"""Parameters that all joints share: the last ones of the state."""


def friction_sigma(runs: int = 100, first: int = 1, scene: str = "iso9283_2") -> None:
    """(Estimate - truth) / σ of adapted friction at constant speeds, in the identified loop and on the simulated arm.

    Each run learns from one motion about the path of --scene. In the identified loop the truth is friction's terms,
    drawn from their prior, and torques have the noise that adaptation expects. The simulated arm starts between 15 and
    45 °C, its friction has other formulas, and its model is the identified one: what the model lacks is in what is
    compared, too.
    """
    cell = set_up(load_scene(scene), delay=False)  # type: ignore[arg-type]
    head("engine", "compared", "RMS of (estimate - truth) / σ", *(f"at {speed:g}" for speed in SPEEDS),
         "within 2 σ", "σ over dry friction", "|truth - identified| over dry friction")
    for name, engine in ENGINES.items():
        parts = [compared(cell, engine, seed) for seed in range(first, first + runs)]
        z, sigma, lacking = (np.concatenate([part[k] for part in parts]) for k in range(3))
        row(name, int(np.isfinite(z).sum()), f"{_rms(z):.2f}", *(f"{_rms(z[:, k]):.2f}" for k in range(len(SPEEDS))),
            f"{100 * np.mean(np.abs(z[np.isfinite(z)]) < 2.0):.0f} %", f"{np.nanmedian(sigma):.3f}",
            f"{np.nanmedian(lacking):.3f}")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def compared(cell: PathCell, engine: Engine, seed: int) -> tuple[Array, Array, Array]:
    """Errors over σ, σ and what the identified friction lacks over dry friction ``(n, speeds)``; NaN where unseen.

    Args:
        cell, engine: about whose path the arm moves, and what learns from that.
        seed: of motion, truth and noise.
    """
    rng, loop, robot = np.random.default_rng(seed), cell.loop(), cell.robot
    motion = training_motion(cell.path.q_d, robot.t_ipo)
    # Another motion in every run: more or less of the same, about another middle.
    motion = motion[0] + rng.uniform(0.5, 1.2, robot.n) * (motion - motion[0])
    known, truth = engine(cell, motion, rng)
    v_max, dry = largest_speeds(loop.path.v_max), dry_sizes(loop.friction)
    reached = np.max(np.abs(np.diff(motion, axis=0)), axis=0) / robot.t_ipo / v_max
    estimated, true, identified = (_sliding(friction, SPEEDS * v_max[:, None])
                                   for friction in (known.friction, truth, loop.friction))
    sigma = dry[:, None] * _sigma(known.covariance, robot.n)
    seen = np.where(reached[:, None] >= SPEEDS, 1.0, np.nan)
    return tuple(seen * values for values in ((estimated - true) / sigma, sigma / dry[:, None],
                                              np.abs(true - identified) / dry[:, None]))  # type: ignore[return-value]


def _sliding(friction: Friction, speeds: Array) -> Array:
    """Friction of unloaded gears at speeds ``(n, k)`` [rad/s], mean of both directions ``(n, k)`` [N m]."""
    both = friction.sliding.mean(axis=1)
    return np.array([np.interp(v, own, values) for v, own, values in zip(speeds, friction.speeds, both, strict=True)])


def _sigma(covariance: Array, n: int) -> Array:
    """Standard deviation of friction at ``SPEEDS`` over dry friction ``(n, k)``."""
    terms = friction_terms(SPEEDS, np.ones(len(SPEEDS)))
    own = (len(covariance) - _COMMON) // n
    sigma = np.empty((n, len(SPEEDS)))
    for i in range(n):
        h = np.zeros((len(SPEEDS), len(covariance)))
        h[:, i * own : i * own + TERMS] = OWN * terms
        h[:, -_COMMON : -_COMMON + 2] = SHARED * terms[:, :2]
        sigma[i] = np.sqrt(np.einsum("kp,pq,kq->k", h, covariance, h))
    return sigma


def _in_loop(cell: PathCell, motion: Array, rng: np.random.Generator) -> tuple[FrictionFactors, Friction]:
    """What is learned in the identified loop with drawn terms of friction, and that friction."""
    loop = cell.loop()
    values = OWN * rng.standard_normal((loop.n, TERMS))
    values[:, :2] += SHARED * rng.standard_normal(2)
    true = with_terms(loop.friction, table_terms(loop.friction, loop.path.v_max), values)
    done = simulate(loop.changed(friction=true), Inverse(loop).along(motion))
    adaptation = _adaptation(cell, loop)
    known = adaptation.init()
    std = np.sqrt(noise_variance(dry_sizes(loop.friction), INTERVAL, cell.model.noise_std))
    each = round(INTERVAL / loop.t_ipo)
    # What a model lacks is alike in neighbouring torques.
    noise = np.repeat(std * rng.standard_normal((len(done.t) // each + 1, loop.n)), each, axis=0)[: len(done.t)]
    tau = done.tau + noise
    for t, q, torque in zip(done.t, done.q_m, tau, strict=True):
        known = adaptation.update(known, RobotState(float(t), q, torque))
    return known, true


def _on_arm(cell: PathCell, motion: Array, rng: np.random.Generator) -> tuple[FrictionFactors, Friction]:
    """What is learned on the simulated arm at a drawn temperature, and its friction then."""
    loop, robot = cell.loop(), cell.robot
    world = cell.world.replace(start_temperature=float(rng.uniform(15.0, 45.0)))
    adaptation = _adaptation(cell, loop)
    known = adaptation.init()
    with SimulatedArm(robot, world, rng, motion[0]) as arm:
        for q_c in Inverse(loop).along(motion):
            known = adaptation.update(known, arm.cycle(q_c))
        warm = arm.history()["temperature"][-1]
    return known, with_true_friction(loop, robot, world, list(range(1, robot.n + 1)), warm).friction


def _adaptation(cell: PathCell, loop: Loop) -> FrictionAdaptation:
    return FrictionAdaptation(loop, tool=cell.robot.tool_place, noise_std=cell.model.noise_std)


ENGINES: dict[str, Engine] = {"identified loop": _in_loop, "simulated arm": _on_arm}
"""In which friction is known and learned."""
