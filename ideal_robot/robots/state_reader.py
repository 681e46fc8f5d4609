"""Reads the states that an arm's controller reports, without commanding the arm."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot

BEYOND = 0.1
"""How far beyond its limits a joint may be reported [rad]: limits of URDFs and of controllers differ a little."""


@dataclass(frozen=True)
class ReportedState:
    """Joint angles of an arm at a time.

    Attributes:
        t: by the controller's clock [s].
        arrived: time at which it was read, by ``time.perf_counter`` [s].
        q: joint angles ``(n,)`` [rad], in the order of the URDF.
    """

    t: float
    arrived: float
    q: Array


class StateReader(ABC):
    """Reads the states of an arm that another program commands, until the end of a ``with`` block."""

    @abstractmethod
    def read(self, timeout: float) -> list[ReportedState]:
        """States since the last call; waits up to ``timeout`` [s] where there are none.

        Raises IdealRobotError where the connection has ended.
        """

    @abstractmethod
    def close(self) -> None:
        """Ends reading."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def no_radians(robot: Robot, names: Sequence[str], q: Array, source: str) -> str | None:
    """Why reported angles cannot be radians of the arm, with the likely unit; None where they can.

    Args:
        robot: limits.
        names: of its joints.
        q: reported ``(n,)`` [rad].
        source: source of the angles, for the message.
    """
    turning = ~robot.prismatic
    beyond = turning & ~((q >= robot.q_min - BEYOND) & (q <= robot.q_max + BEYOND))
    if not beyond.any():
        return None
    j, in_radians = int(np.argmax(beyond)), np.radians(q)
    fits = ((in_radians >= robot.q_min) & (in_radians <= robot.q_max))[turning].all()
    return (f"{names[j]} is at {q[j]:.4g} on {source}, beyond its limits"
            + ("; positions have to be radians, these look like degrees" if fits else ""))
