"""Gains that an industrial controller schedules by posture, with the inertia of its own arm model."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot
from sim.arm import kernel
from sim.arm.world import World


class GainSchedule:
    """Sets the velocity loop's gain K_p once a cycle to ``K_p (1 + g (J(q) / J(home) - 1))``.

    J is the joint's moment of inertia with its rotor, by the data sheet: the payload is not in it.

    Args:
        robot: the data sheet.
        world: says how far gains follow, g.
        p: parameter block ``(PARAMETERS, n)`` with the gains at home.
    """

    def __init__(self, robot: Robot, world: World, p: Array) -> None:
        self._model, self._data = robot.pinocchio, robot.pinocchio.createData()
        self._rotor, self._share = p[kernel.P_ROTOR].copy(), world.gain_schedule
        self._gains = p[[kernel.C_KP, kernel.C_KI]].copy()
        self._home = self._inertia(np.array(robot.home, dtype=float))

    @staticmethod
    def of(robot: Robot, world: World, p: Array) -> GainSchedule | None:
        """The schedule of a world; None where gains are constant.

        Args:
            robot, world, p: see the class.
        """
        return GainSchedule(robot, world, p) if world.gain_schedule else None

    def follow(self, p: Array, q: Array) -> None:
        """Sets the gains for motor angles ``q (n,)`` [rad] in the parameter block ``p``."""
        p[[kernel.C_KP, kernel.C_KI]] = self._gains * (1.0 + self._share * (self._inertia(q) / self._home - 1.0))

    def _inertia(self, q: Array) -> Array:
        return mass_matrix(self._model, self._data, q).diagonal() + self._rotor
