"""Which corrections the controller has in force: it is told what was sent and what of it came too late."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


class InForce:
    """The sum of corrections in force at the controller and what it changed by in the last cycle, in its degrees.

    Args:
        n: number of axes.
        repeats: what the controller does in a cycle without an answer: goes on as in the last one (increments that are
            held on), or stays where it was commanded.

    Attributes:
        position: sum of the corrections in force ``(n,)`` [deg].
        step: change in the last cycle ``(n,)`` [deg].
        repeats: see above.
    """

    def __init__(self, n: int, repeats: bool) -> None:
        self.position = self.step = np.zeros(n)
        self.repeats = repeats
        self._sent: Array | None = None

    def send(self, position: Array) -> None:
        """The answer to this cycle asks for ``position (n,)`` [deg]."""
        self._sent = position

    def advance(self, used: bool, missed: int) -> bool:
        """The next packet is there: whether the answer was used, and cycles behind it that had none.

        Returns whether anything is otherwise than the answer asked for.
        """
        if used and self._sent is not None:
            self.position, self.step = self._sent, self._sent - self.position
        else:
            missed += 1
        self._sent = None
        if missed and self.repeats:
            self.position = self.position + missed * self.step
        elif missed:
            self.step = np.zeros_like(self.step)
        return missed > 0

    def is_at(self, position: Array) -> None:
        """The controller turned out to be at rest at ``position (n,)`` [deg]."""
        self.position, self.step, self._sent = position, np.zeros_like(position), None
