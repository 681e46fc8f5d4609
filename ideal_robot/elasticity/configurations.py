"""Chooses the few clamped configurations that determine the stiffness of all joints best.

Past [J], which takes one configuration a joint: with all six wrench components and one motor shifted after the other,
every configuration has information on every joint. How much is predicted from the geometry, a rough guess of the
stiffnesses, the limits and the noise of the sensor; configurations are added one by one, the best first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.stiffness import condition_number, flange_jacobian
from ideal_robot.elasticity.stiffness_analysis import compliance_shapes
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import reach_at_home


@dataclass(frozen=True)
class ClampLimits:
    """Limits of the arm, the sensor and the site on a clamped configuration.

    Attributes:
        torque_share: motor torque as a share of its limit.
        force, moment: at the flange [N, N m].
        radius: distance of the flange from the vertical through the base [m].
        height: of the flange above the base [m].
        noise: standard deviation of sensed forces [N] and moments [N m].
        condition: largest condition number of the Jacobian, moments divided by 1 m.
        stiffness_guess: joint stiffness as a multiple of the torque limit [1/rad].
    """

    torque_share: float = 0.5
    force: float = 12e3
    moment: float = 6e3
    radius: tuple[float, float] = (0.9, 2.6)
    height: tuple[float, float] = (0.2, 2.2)
    noise: tuple[float, float] = (12.0, 4.0)
    condition: float = 20.0
    stiffness_guess: float = 200.0

    @classmethod
    def of(cls, robot: Robot) -> ClampLimits:
        """Limits in proportion to the arm's reach and strength."""
        reach = reach_at_home(robot)
        strength = float(np.max(robot.tau_max)) / reach
        return cls(force=0.8 * strength, moment=0.4 * strength, radius=(0.4 * reach, 1.2 * reach),
                   height=(0.1 * reach, 1.0 * reach), noise=(1e-3 * strength, 4e-4 * strength))


@dataclass(frozen=True)
class ChosenConfigurations:
    """The chosen configurations with their predicted standard deviations.

    Attributes:
        q: configurations ``(c, n)`` [rad], the most useful first.
        std_percent: predicted %σ of each joint after the first, second, … of them ``(c, n)``, from sensor noise.
        condition: of the Jacobians ``(c,)``, moments divided by 1 m.
    """

    q: Array
    std_percent: Array
    condition: Array


_ENOUGH = 0.02
"""Predicted %σ of the worst joint at which no more configurations are added."""


def choose_configurations(robot: Robot, limits: ClampLimits, rng: np.random.Generator, *, most: int = 3,
                          candidates: int = 400) -> ChosenConfigurations:
    """Up to ``most`` configurations whose worst joint has the smallest predicted %σ.

    Raises InputError where no candidate is within the limits.

    Args:
        robot, limits: geometry and limits; those of arm, sensor and site.
        rng, candidates: for the candidates, and how many are compared.
        most: largest number of configurations that can be clamped.
    """
    guess = limits.stiffness_guess * robot.tau_max
    if not np.all(np.isfinite(guess)):
        raise InputError("the URDF gives no torque limits (effort); they say how hard the arm may press",
                         file=robot.urdf, field="effort")
    pool = []
    for _ in range(20 * candidates):
        q = rng.uniform(np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi))
        if _within(robot, q, limits):
            pool.append((q, _information(robot, q, guess, limits)))
        if len(pool) == candidates:
            break
    if not pool:
        raise InputError("no configuration brings the flange within the limits of the site; widen them", field="limits")
    total = np.zeros_like(pool[0][1])
    chosen: list[Array] = []
    promised = []
    while len(chosen) < most:
        stds = [_std_percent(total + information, robot.n) for _, information in pool]
        best = int(np.argmin([np.max(std) for std in stds]))
        chosen.append(pool[best][0])
        promised.append(stds[best])
        total = total + pool[best][1]
        if np.max(stds[best]) <= _ENOUGH:
            break
    return ChosenConfigurations(np.array(chosen), np.array(promised),
                                np.array([condition_number(robot, q) for q in chosen]))


def _within(robot: Robot, q: Array, limits: ClampLimits) -> bool:
    pose = robot.fk()(q)
    x, y, z = pose.translation
    reach_ok = limits.radius[0] <= np.hypot(x, y) <= limits.radius[1] and x > 0
    height_ok = limits.height[0] <= z <= limits.height[1]
    return bool(reach_ok and height_ok and condition_number(robot, q) <= limits.condition)


def _information(robot: Robot, q: Array, guess: Array, limits: ClampLimits) -> Array:
    """Information about gear, clamp and link compliances ``(2 n + 2, 2 n + 2)``, each relative to its guess.

    One motor after the other is shifted both ways until a limit is met. Per push, sensor noise becomes noise of the
    predicted motor angle, K⁻¹ Jᵀ σ.
    """
    n = robot.n
    jacobian = flange_jacobian(robot, q)
    sigma = np.repeat(limits.noise, 3)
    noise = np.linalg.norm(jacobian.T * sigma, axis=1) / guess
    shapes = compliance_shapes(robot, q)
    # Prior of clamp and links: a hundredth of the stiffest gear's compliance.
    scale = np.concatenate([1 / guess, np.full(len(shapes), 1e-2 / np.max(guess))])
    information = np.zeros((len(scale), len(scale)))
    for joint in range(n):
        wrench = np.linalg.solve(jacobian.T, np.eye(n)[joint])
        tau = min(limits.torque_share * robot.tau_max[joint], limits.force / np.linalg.norm(wrench[:3]),
                  limits.moment / np.linalg.norm(wrench[3:]))
        rows = np.zeros((n, len(scale)))
        rows[joint, joint] = tau
        for column, shape in enumerate(shapes):
            rows[:, n + column] = np.linalg.solve(jacobian, shape @ wrench) * tau
        rows = rows * scale / noise[:, None]
        information += rows.T @ rows
    return information


def _std_percent(information: Array, n: int) -> Array:
    # A weak prior (the guess is right within a factor of ten) keeps undetermined parameters of a single configuration
    # finite.
    return np.asarray(100 * np.sqrt(np.diag(np.linalg.inv(information + 1e-2 * np.eye(len(information)))))[:n])
