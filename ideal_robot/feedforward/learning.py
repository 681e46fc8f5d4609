"""Learning: the commands of one path improve with each repetition, [G] (10), (11).

    q_c^(p+1) = q_c^p + Δq_c^(p+1) ,   G Δq_c^(p+1) = q_d - q^p

``G`` is the matrix of the linear closed loop. It is inverted by regularised least squares, in information form.

[G] finds that convergence cannot be guaranteed. Therefore the best commands so far are kept, a step that increases the
error is halved and repeated from the best, and learning stops when halving does not help.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import CommandLimits, Feedforward
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.results import Summarised
from ideal_robot.tolerances import SMALLEST_GAIN

SMOOTHNESS, SMOOTHNESS_ON_MODEL = 0.3, 0.05
"""Weight of a correction's second differences against an error of the same size: on the arm, where it keeps noise out
of the commands, and on the identified loop, which has none. There 0.3 leaves a third to five sixths of the loop's
error, but not of the arm's, whose last errors at reversals are others: what it leaves there is by chance, on ``edge``
0.031 mm in the place of 0.045, on four other paths more."""


class LearningLaw:
    """Computes the correction for the next run from the errors of the last, [G] (11).

    Args:
        loop: linear closed loops of the joints.
        length: number of cycles of the path.
        smoothness: weight of the correction's second differences.
    """

    def __init__(self, loop: LinearLoop, length: int, *, smoothness: float = SMOOTHNESS) -> None:
        self.length = length
        second = np.diff(np.eye(length), 2, axis=0)
        penalty = smoothness**2 * second.T @ second + 1e-8 * np.eye(length)
        self._G = [loop.matrix(i, length, length) for i in range(loop.n)]
        self._factors = [cho_factor(G.T @ G + penalty) for G in self._G]

    def correction(self, error: Array) -> Array:
        """Correction ``Δq_c (N, n)`` [rad] for the errors ``q_d - q (N, n)`` of the last run."""
        steps = [cho_solve(factor, G.T @ error[:, i])
                 for i, (G, factor) in enumerate(zip(self._G, self._factors, strict=True))]
        return np.column_stack(steps)


@dataclass(frozen=True, repr=False)
class Learned(Summarised):
    """The result of learning one path.

    Attributes:
        q_c: best commands ``(N, n)`` [rad].
        criterion: error criterion of every run, the first before any learning.
        kept: best commands after 0, 1, … learning steps, so ``kept[p]`` are the commands of ``learned-p``.
        stopped: why learning ended before its last step, or None.
    """

    q_c: Array
    criterion: tuple[float, ...]
    kept: tuple[Array, ...]
    stopped: str | None

    def summary(self) -> list[tuple[str, str]]:
        """Reduction of the criterion as rows of label and value."""
        return [("plays", f"{len(self.criterion)} runs, {self.stopped or 'learned to the last step'}"),
                ("criterion", f"{self.criterion[0]:.3g} → {self.best:.3g}")]

    @property
    def best(self) -> float:
        """Smallest criterion reached; never above the first."""
        return min(self.criterion)


def learn(play: Callable[[Array], Array], q_c: Array, law: LearningLaw, *, iterations: int = 4,
          limits: CommandLimits | None = None) -> Learned:
    """Learns the commands of a path by repeated runs; raises InputError where path and law differ in length.

    Args:
        play: runs commands ``(N, n)`` and returns the errors ``q_d - q (N, n)`` [rad] at the same instants.
        q_c: commands to start from ``(N, n)`` [rad].
        law, iterations: makes corrections out of errors; number of learning steps.
        limits: of commands; None for none.
    """
    if len(q_c) != law.length:
        raise InputError(f"expected commands of {law.length} cycles, for which the learning law is made", field="q_c",
                         value=len(q_c))

    def criterion(error: Array) -> float:
        return float(np.sqrt(np.mean(error**2)))

    def safe(commands: Array) -> Array:
        return commands if limits is None else _slew(limits.within(commands), limits.step)

    best = np.array(q_c)
    error = play(best)
    history, paths = [criterion(error)], [best]
    lowest, gain, stopped = history[0], 1.0, None
    if not np.isfinite(lowest):
        return Learned(best, (float("inf"),), (best,), "the first play has no finite error")
    for _ in range(iterations):
        trial = safe(best + gain * law.correction(error))
        played = play(trial)
        value = criterion(played) if np.isfinite(played).all() else float("inf")
        history.append(value)
        if value < lowest:
            best, error, lowest = trial, played, value
            gain = min(1.0, 1.5 * gain)
        else:
            gain *= 0.5
        paths.append(best)
        if gain < SMALLEST_GAIN:
            stopped = "smaller steps do not help any more; the best commands are kept"
            break
    return Learned(best, tuple(history), tuple(paths), stopped)


def learn_on_model(loop: Loop, q_d: Array, q_c: Array | None = None) -> Learned:
    """Learns a path on the identified closed loop, before the arm moves.

    Args:
        loop: the identified closed loop.
        q_d: desired arm positions at the instants ``t_k`` ``(N, n)`` [rad].
        q_c: commands to start from; the desired positions if not given.
    """
    start = q_d if q_c is None else q_c
    law = LearningLaw(LinearLoop.of(loop, q_d[len(q_d) // 2]), len(q_d),
                      smoothness=SMOOTHNESS_ON_MODEL)
    return learn(lambda commands: np.asarray(q_d - simulate(loop, commands).q_a[:-1]), start, law,
                 iterations=8, limits=CommandLimits.of(loop.path))


def _slew(commands: Array, step: Array) -> Array:
    """Commands whose steps are at most ``step``; unchanged where they are."""
    if np.all(np.abs(np.diff(commands, axis=0)) <= step):
        return commands
    limited = commands.copy()
    for k in range(1, len(limited)):
        limited[k] = np.clip(limited[k], limited[k - 1] - step, limited[k - 1] + step)
    return limited


class Playback(Feedforward):
    """Replays learned commands ``(N, n)`` [rad] for a cycle [s]; repeats the last one after their end.

    The desired positions are ignored, as learned commands belong to one path.
    """

    n_d = 1

    def __init__(self, q_c: Array, t_ipo: float) -> None:
        self.t_ipo = t_ipo
        self._q_c = np.array(q_c, dtype=float)
        self._q_c.setflags(write=False)

    def init(self, q0: Array) -> int:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        return 0

    def step(self, state: int, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, int]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        return self._q_c[min(state, len(self._q_c) - 1)], state + 1
