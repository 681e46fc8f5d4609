"""A rigid arm with friction that moves along Fourier series: recordings whose truth is known to the last digit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ideal_robot.dynamics import BaseParameters, base_parameters, link_parameters, torques, with_link_parameters
from ideal_robot.friction import FrictionModel, PerJointFriction
from ideal_robot.friction.laws import ViscousCoulomb
from ideal_robot.identification.excitation import FourierMotion, design_excitation
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@cache
def robot(name: str = "kr6") -> Robot:
    return Robot.load(name)


@cache
def base() -> BaseParameters:
    return base_parameters(robot().pinocchio)


@cache
def motion(seed: int = 1, period: float = 12.0) -> FourierMotion:
    return design_excitation(robot(), np.random.default_rng(seed), period=period, trials=30, refinements=60)


@dataclass(frozen=True)
class Truth:
    """Full parameters (links, rotors, offsets) and friction of the arm that is recorded."""

    full: np.ndarray
    friction: PerJointFriction

    @property
    def base(self) -> np.ndarray:
        return base().of(self.full)


def truth(laws: list[FrictionModel] | None = None) -> Truth:
    arm = robot()
    full = np.concatenate([link_parameters(arm.pinocchio), arm.rotor_inertia, 0.01 * arm.tau_max])
    if laws is None:
        laws = [ViscousCoulomb(np.array([[0.02 * tau], [0.04 * tau]])) for tau in arm.tau_max]
    return Truth(full, PerJointFriction(laws))


def record(what: Truth, rng: np.random.Generator, *, noise: float = 0.005, rate: float = 250.0,
           seed: int = 1) -> Recording:
    """A recording of two periods; the noise of the torque is relative to its limit, that of the position 2 µrad."""
    arm = robot()
    n = arm.n
    t = np.arange(0.0, 24.0, 1.0 / rate)
    q, qd, qdd = motion(seed).at(t)
    model = with_link_parameters(arm.pinocchio, what.full[: 10 * n])
    load = torques(model, q, qd, qdd)
    tau = load + what.full[10 * n : 11 * n] * qdd + what.full[11 * n :] + what.friction.torque(qd, load, q)
    return Recording.from_arrays(t, q=q + rng.normal(scale=2e-6, size=q.shape),
                                 tau=tau + noise * arm.tau_max * rng.normal(size=tau.shape), source="known truth")


def wrong_by_half(rng: np.random.Generator) -> Robot:
    """The robot with every link's inertias half or one and a half times what they are."""
    arm = robot()
    factors = np.repeat(rng.choice([0.5, 1.5], arm.n), 10)
    return replace(arm, pinocchio=with_link_parameters(arm.pinocchio, link_parameters(arm.pinocchio) * factors))
