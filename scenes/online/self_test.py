r"""Tests, before anything moves, whether this computer keeps up with the controller's cycle.

The arm is commanded to rest while the task is computed as in the run, with simulated sensors: each cycle is planned
after the last command, or before the answer, as the task does it, and the controller reports late answers. m late ones
of N are more than the share p that may be late where

.. math:: P(X \ge m \mid X \sim B(N, p)) < \alpha

so a computer that is just fast enough is refused once in :math:`1 / \alpha` tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from scenes.online.live_arm import LiveArm
from scenes.scene_files.scene import SceneError

LASTS = 2.0
"""Time of the test [s]."""
LATE = 0.04
"""Share of the answers that may be late: with 2 % lost and 2 % late jobs were played (docs/security.md), and a
controller that takes absolute corrections stopped the arm by itself with some three times its acceleration limit."""
BY_CHANCE = 1e-6
"""Probability with which a computer that has ``LATE`` late answers is refused."""


@dataclass(frozen=True)
class SelfTest:
    """The result of the self-test.

    Attributes:
        cycles, late: answers, and those that came too late.
        t_ipo: the controller's cycle [s].
        computing: usual and longest time of computing a cycle of the job [s].
        jitter: standard deviation of the time from packet to answer [s].
    """

    cycles: int
    late: int
    t_ipo: float
    computing: tuple[float, float]
    jitter: float

    @property
    def by_chance(self) -> float:
        """Probability that a computer that is just fast enough has at least so many late answers."""
        return 1.0 if not self.late else float(bdtrc(self.late - 1, self.cycles, LATE))

    @property
    def too_slow(self) -> bool:
        """Whether this computer is too slow for the cycle."""
        return self.by_chance < BY_CHANCE

    @property
    def text(self) -> str:
        """The result in words."""
        usual, longest, jitter = (1e3 * value for value in (*self.computing, self.jitter))
        return (f"{self.late} of {self.cycles} answers late at rest, a cycle of {1e3 * self.t_ipo:g} ms computed in "
                f"{usual:.1f} ms, at most {longest:.1f} ms; answers jitter by {jitter:.2f} ms")

    def json(self) -> dict[str, float | int | str]:
        """Plain values for JSON."""
        return {"cycles": self.cycles, "late": self.late, "computing_ms": 1e3 * self.computing[0],
                "longest_ms": 1e3 * self.computing[1], "jitter_ms": 1e3 * self.jitter, "text": self.text}


def self_test(arm: LiveArm, cycles: Iterator[float], ahead: bool) -> SelfTest:
    """Commands the arm to rest for a while and computes the task meanwhile; returns the late answers.

    Args:
        arm: connected, at rest.
        cycles: computes one cycle of the task per iteration and yields the time that it took [s].
        ahead: whether the job computes a cycle behind the command before, or else before its answer.

    Raises:
        SceneError: this computer does not hold the cycle.
        FollowStoppedError: the arm is gone, or hardly any answer came in time.
    """
    took, late, answers = list[float](), 0, len(arm.link.answer_times)
    count = round(LASTS / arm.t_ipo)

    def compute() -> None:
        if (seconds := next(cycles, None)) is not None:
            took.append(seconds)

    for _ in range(count):
        arm.check(arm.t)
        if ahead:
            with arm.doing(compute):
                arm.cycle(arm.q_d)
        else:
            compute()
            arm.cycle(arm.q_d)
        late += arm.link.missed
    times = np.array(arm.link.answer_times[answers:])
    result = SelfTest(count, late, arm.t_ipo, (float(np.median(took)), max(took)) if took else (0.0, 0.0),
                    float(times.std()) if len(times) else 0.0)
    if result.too_slow:
        raise SceneError(f"this computer is too slow for the cycle: {result.text}; {100.0 * LATE:.0f} % may be late. "
                         "Take a longer cycle (--cycle), a computer with less to do, or a core of its own (--core)")
    return result
