r"""Largest speed on a surface of unknown shape: errors of the forecast height are forces on a stiff contact.

A force is answered ``NOTICED`` later, and by then the tip is :math:`d = v\, t` further on. So over the distance d only
the map's forecast follows the surface. The filter gives the forecast's standard deviation before anything has moved:

.. math:: \sigma_F(v) = E\, \sqrt{\sigma_h^2(v\, t) + \sigma_x^2}

with the arm's own deviation from its path, :math:`\sigma_x`: where a travel begins the joints reverse, and with them
the friction that the model does not have, which is as large as the model's residual :math:`\sigma_j`. Behind gears of
stiffness :math:`k_j` and with the torque :math:`g_j = (J^T d)_j` of one newton it moves the tip by twice of what it
bends them,

.. math:: \sigma_x^2 = \sum_j (2\, g_j\, \sigma_j / k_j)^2

which is 0.026 to 0.030 mm on the simulated KR 6. A sensor's gain is known as well as somebody has
measured it: with the ratio κ of the true force to the shown one and its standard deviation the surface bears no more
than

.. math:: \hat\kappa F_r + 4\, \sqrt{F_r^2 \sigma_\kappa^2 + \hat\kappa^2 \sigma_F^2}

but for once in 16,000 times. The arm's joints break away as a travel begins, however
slow that is. On the wave of ``force_wave`` at 0.2 m/s the error's RMS was 0.75, 1.4, 2.1 and 3.1 N at elasticities of
4, 19, 44 and 79 N/mm; this says 0.66, 1.2, 2.1 and 3.3 N.
"""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.contact import NOTICED, ContactSettings, most_force
from planning.force.force_follower import Errors, surface_filter
from planning.line.measurement import Measurement
from planning.path.kinematics import InverseKinematics

SPACING, STRETCH = 2.4e-3, 0.25
"""Distance of the places at which the surface is felt, and the way after which it is forecast [m]."""
TIMES = 4.0
"""Standard deviations that the force may go wrong by: one in 16,000 is beyond, and a path has some hundred places."""
STEPS = 1.3
"""Ratio of the speeds that are tried."""
SLOWEST = 0.01
"""Speed below which none is tried [m/s]."""


def left_beside(model: Model, robot: Robot, q: Array, direction: Array) -> float:
    """Standard deviation σ_x of the tip along a direction that unmodelled friction causes at a reversal [m].

    Args:
        model: of the arm; gears of unknown stiffness are taken as rigid.
        robot: its kinematics.
        q: joint angles ``(n,)`` [rad].
        direction: unit vector ``(3,)`` in the base frame.
    """
    if model.gears is None:
        return 0.0
    bent = 2.0 * model.noise_std / model.gears.rigid_if_unknown
    return float(np.linalg.norm(InverseKinematics(robot).torque(q, direction) * bent))


def forecast_error(settings: ContactSettings, errors: Errors, speed: float, T: float, left: float,
                   answered: float = NOTICED) -> float:
    """Standard deviation of the force on a surface of unknown shape, after a part of the surface was measured [N].

    Args:
        settings: elasticity and noise of the contact.
        errors: of the force, that are estimated as well.
        speed: along the surface [m/s].
        T: cycle [s].
        left: see ``left_beside`` [m].
        answered: time until a force is answered [s].
    """
    fusion, step, E = surface_filter(errors), max(speed * T, SPACING), settings.elasticity
    # Cycles nearer to each other than one step are treated as one measurement with less noise.
    variance = np.array([[((settings.noise / E) ** 2 + settings.position_noise**2) * speed * T / step]])
    s = step * np.arange(math.ceil(STRETCH / step))
    for place in s.tolist():
        fusion.travel(place)
        fusion.update(Measurement(place / speed, np.array([place]), np.zeros(1), variance, np.array([[0.0, 1.0]]),
                                  "force", np.zeros((1, 3)), origin=np.zeros(1), at=place))
    return E * float(np.sqrt(fusion.deviation(np.array([s[-1] + speed * answered]))[1][0, 1] + left**2))


def worst_force(force: float, ratio: tuple[float, float], error: float) -> float:
    """The force on the surface that is exceeded with a probability of one in 16,000 [N].

    Args:
        force: force that is controlled, as the sensor shows it [N].
        ratio: of the true force to the shown one, κ, and its standard deviation.
        error: standard deviation of the shown force [N].
    """
    kappa, sigma = ratio
    return kappa * force + TIMES * math.hypot(sigma * force, kappa * error)


def bearable_speed(settings: ContactSettings, errors: Errors, most: float, T: float, left: float,
                   answered: float = NOTICED, ratio: tuple[float, float] = (1.0, 0.0)) -> float:
    """Largest speed up to ``most`` [m/s] at which the force stays below what the surface bears; 0 if there is none.

    Args:
        settings: wanted force, elasticity and noise of the contact.
        errors: of the force, that are estimated as well.
        most: largest speed to be tried [m/s].
        T: cycle [s].
        left: see ``left_beside`` [m].
        answered: time until a force is answered [s].
        ratio: of the true force to the shown one, and its standard deviation.
    """
    speeds = most / STEPS ** np.arange(1 + max(0, math.floor(math.log(most / SLOWEST, STEPS))))
    allowed = most_force(settings.force)

    def bears(k: int) -> bool:
        error = forecast_error(settings, errors, float(speeds[k]), T, left, answered)
        return worst_force(settings.force, ratio, error) <= allowed

    # The error grows with the speed: no faster one would do.
    k = bisect_left(range(len(speeds)), True, key=bears)
    return float(speeds[k]) if k < len(speeds) else 0.0
