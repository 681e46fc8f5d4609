"""True settings of a clamped arm: compliances, noise, and errors of the clocks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, found_in
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import reach_at_home
from sim.arm.world import World, numbers

KR500_STIFFNESS = (6.93e6, 7.81e6, 6.2e6, 1.35e6, 1.15e6, 0.62e6)
"""Truth [N m/rad]: joints 1 and 2 as [J] tables 5 and 6, the others assumed in proportion."""

_RANGES = {
    "stiffness": (1.0, np.inf), "link_stiffness": (1.0, np.inf), "environment": (1.0, np.inf), "friction": (0.0, 1.0),
    "presliding": (1e-12, 0.1), "force_control": (0.0, 0.3), "drive_gain_std": (0.0, 0.3), "current_noise": (0.0, 1.0),
    "encoder": (0.0, 0.1), "wrench_noise": (0.0, 1e5), "wrench_bias": (0.0, 1e5), "clock_offset": (-1e3, 1e3),
    "clock_drift": (-0.1, 0.1), "rate_motor": (20.0, 1e4), "rate_wrench": (5.0, 1e4),
}
"""Least and largest value of each key of a table."""


@dataclass(frozen=True)
class ClampWorld:
    """True settings of a clamped arm; a zero switches an effect off (``np.inf`` for a stiffness).

    Attributes:
        stiffness: gear stiffness ``(n,)`` [N m/rad].
        link_stiffness: bending stiffness of each link, the same about both axes across its joint axis ``(n,)``
            [N m/rad].
        environment: translational [N/m] and rotational [N m/rad] stiffness of the environment that the flange is
            clamped to.
        friction: dry friction of the motors as a share of the torque limit.
        presliding: motor motion over which friction builds up, joint side [rad].
        force_control: relative error of each motor's shift under force control; wrench components that should be
            zero are then not quite.
        drive_gain_std: relative standard deviation of the true drive gains about the data sheet's.
        current_noise: as a share of the torque limit, sample to sample.
        encoder: resolution, joint side [rad].
        wrench_noise: standard deviation of forces [N] and moments [N m].
        wrench_bias: standard deviation of the constant bias, forces [N] and moments [N m].
        clock_offset, clock_drift: the sensor's clock reads ``(t − offset) / (1 + drift)`` at controller time ``t``.
        gaps: whether the wrench is missing for parts of the time, as in [J] 4.3.
        rate_motor, rate_wrench: sampling rates [Hz].
    """

    stiffness: Array
    link_stiffness: Array
    environment: tuple[float, float]
    friction: float = 0.008
    presliding: float = 2e-5
    force_control: float = 0.004
    drive_gain_std: float = 0.03
    current_noise: float = 0.004
    encoder: float = 2e-7
    wrench_noise: tuple[float, float] = (12.0, 4.0)
    wrench_bias: tuple[float, float] = (30.0, 10.0)
    clock_offset: float = 1.37
    clock_drift: float = 3e-5
    gaps: bool = True
    rate_motor: float = 500.0
    rate_wrench: float = 83.3

    @classmethod
    def default(cls, robot: Robot) -> ClampWorld:
        """The default for a shipped robot, with all effects; gears as in its simulated world, where there is one.

        Raises ``InputError`` where there is no simulated world for that robot.
        """
        if robot.name == "kr500":
            stiffness = np.array(KR500_STIFFNESS)
        else:
            stiffness = World.default(robot).per_joint("stiffness", robot.n)
        # Assumed: links are stiff; the long ones of joints 2 and 3 and the slim one of joint 4 are the softest.
        links = 40 * np.max(stiffness) * np.resize([1.5, 0.6, 1.0, 0.7, 1.5, 2.5], robot.n)
        # A bench built for the arm: its compliance is about 0.2 % of the whole arm's.
        hard = 500 * float(np.max(stiffness)) / reach_at_home(robot)**2
        return cls(stiffness, links, (hard, 0.4 * hard))

    @classmethod
    def from_table(cls, robot: Robot, table: dict[str, Any], file: str | None = None) -> ClampWorld:
        """The default world of ``robot`` changed by a table, one number for all joints; see ``World.from_table``."""
        default = cls.default(robot)
        known = tuple(field.name for field in fields(cls))
        with found_in(file):
            for key in table:
                if key not in known:
                    raise InputError(f"unknown key; allowed here are {', '.join(known)}", field=f"world.{key}")
            return replace(default, **{k: _checked(k, value, getattr(default, k)) for k, value in table.items()})


def _checked(key: str, value: Any, default: Any) -> Any:
    """A table's value in the type of the default's."""
    field = f"world.{key}"
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputError("expected true or false", field=field, value=value)
        return value
    array = numbers(field, value)
    low, high = _RANGES[key]
    if not np.all((array >= low) & (array <= high)):
        raise InputError(f"expected {f'at least {low:g}' if np.isinf(high) else f'{low:g} to {high:g}'}", field=field,
                         value=value)
    count = np.size(default)
    if isinstance(default, np.ndarray) and array.ndim == 0:
        return np.full(count, float(array))
    if array.shape != np.shape(default):
        expected = f"one number or {count}, one per joint" if isinstance(default, np.ndarray) else \
            f"{count} numbers" if count > 1 else "one number"
        raise InputError(f"expected {expected}", field=field, value=value)
    return array if isinstance(default, np.ndarray) else tuple(array.tolist()) if count > 1 else float(array)
