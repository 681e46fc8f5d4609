"""Where the arm was while it was in contact: the observer behind the gears, run again once the force is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver, ObserverState

KEPT = 0.2
"""Time for which a cycle waits for its force; after that the expected one has to do [s]."""


@dataclass
class _Cycle:
    """A cycle: its end, the motor angles there, the torque expected of the contact, those sensed, the arm then."""

    t: float
    q: Array
    expected: Array
    felt: list[Array]
    state: ObserverState


class FeltArm:
    r"""Arm angles from motor angles and contact forces, of which the sensed ones come late.

    A force that is not the expected one bends the gears and swings the arm on them. An observer that is told the
    expected one takes that swing for a shape of the surface, and the stiffer the contact, the more force answers it. So
    each cycle is first estimated with the torques that are expected, and again when its forces have arrived:

    .. math:: \tau_{ext} = J(q_a)^T F, \qquad F = \text{the mean of the cycle's samples}

    Args:
        observer: of the arm behind its gears.
        q_start: motor angles at rest before the first cycle ``(n,)`` [rad].
        torque: joint torques ``(n,)`` [N m] of a force at the tool ``(3,)`` [N, base frame] at arm angles ``(n,)``.
    """

    def __init__(self, observer: ArmObserver, q_start: Array, torque: Callable[[Array, Array], Array]) -> None:
        self._observer, self._torque = observer, torque
        self._settled = observer.init(q_start)
        self._cycles: deque[_Cycle] = deque()

    def step(self, t: float, q: Array, expected: Array) -> Array:
        """The arm angles ``(n,)`` [rad] at ``t`` as far as is known now.

        Args:
            t: end of the cycle [s].
            q: motor angles then ``(n,)`` [rad].
            expected: joint torques of the contact during it ``(n,)`` [N m].
        """
        before = self._cycles[-1].state if self._cycles else self._settled
        self._cycles.append(_Cycle(t, q, expected, [], self._observer.step(before, q, expected)))
        while self._cycles[0].t < t - KEPT:
            self._settled = self._cycles.popleft().state
        return self._cycles[-1].state.q_a

    def feel(self, t: Array, force: Array) -> list[tuple[float, Array]]:
        """Takes contact forces ``(m, 3)`` [N, base frame] of the instants ``t (m,)`` [s].

        Returns:
            instants [s] and arm angles ``(n,)`` [rad] of all cycles that look different now.
        """
        first = len(self._cycles)
        for at, one in zip(t, force, strict=True):
            index = next((i for i, cycle in enumerate(self._cycles) if at <= cycle.t), len(self._cycles))
            if index == len(self._cycles):
                continue
            cycle = self._cycles[index]
            cycle.felt.append(self._torque(cycle.state.q_a, one))
            first = min(first, index)
        state = self._cycles[first - 1].state if first else self._settled
        changed = []
        for cycle in list(self._cycles)[first:]:
            torque = np.mean(cycle.felt, axis=0) if cycle.felt else cycle.expected
            state = cycle.state = self._observer.step(state, cycle.q, torque)
            changed.append((cycle.t, state.q_a))
        # Older cycles get no more forces.
        while len(self._cycles) > 1 and self._cycles[1].felt and self._cycles[0].t < float(np.min(t)) - 0.05:
            self._settled = self._cycles.popleft().state
        return changed
