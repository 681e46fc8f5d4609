"""The surface's height as a Gaussian process along the path, and the arm angles while it was measured."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver, ObserverState
from ideal_robot.jit import jit
from planning.line.deviation_model import DeviationModel, PathDeviation, Stand

ORDER = 8
"""Derivatives of the height that are states: Matérn's ν is this and a half, so the process is smooth."""
LENGTHS = (0.03, 0.045, 0.065, 0.1, 0.15)
"""Length scales that are weighed beside each other [m]."""
SLOPE = 0.12
"""Standard deviation of the process's slope, whatever its length scale: a short shape is a flat one."""
DISPLACEMENT, TILT = 0.02, 0.05
"""Standard deviations of the surface's height [m] and slope against the nominal plane."""


class SmoothSurface(DeviationModel):
    r"""Height along the path: displacement, tilt and a smooth random process in state-space form.

    .. math:: h(s) = c + d\, s + f(s), \qquad
              \left( \frac{1}{\lambda} \frac{d}{ds} + 1 \right)^{p+1} f = w, \quad \lambda = \sqrt{2 p + 1} / l

    with white w: the Gaussian process with Matérn's kernel of ν = p + 1/2 and length scale l (Hartikainen and Särkkä
    2010). Its states are f and its p derivatives, in units of 1/λ, where the tip is. The height ahead follows from them
    by F(Δs), with a variance that grows with Δs. The kernel says that a surface is smooth and nothing else of its
    shape.

    Args:
        length: l [m].
        across: model of the deviation across the path, where a camera shows it; without one there is none.
        rows: of ``across``, shared with other length scales.
    """

    directions = 2
    drifts = True

    def __init__(self, length: float, across: PathDeviation | None = None, rows: RowsAcross | None = None) -> None:
        self._across, n = across, ORDER + 1
        self._rows_across = rows or RowsAcross(across)
        self._rate = math.sqrt(2.0 * ORDER + 1.0) / length
        # Of the companion matrix N of (D + 1)^n, N + I is nilpotent: F(u) is a polynomial times exp(-u).
        companion = np.eye(n, k=1)
        companion[-1] = [-math.comb(n, i) for i in range(n)]
        power, powers = np.eye(n), []
        for k in range(n):
            powers.append(power)
            power = power @ (companion + np.eye(n)) / (k + 1)
        self._powers = np.array(powers)
        self._first_rows = np.ascontiguousarray(self._powers[:, 0])
        spread = solve_continuous_lyapunov(companion, -np.diag(np.eye(n)[-1]))
        # Stationary covariance of the states, scaled so that the slope has the standard deviation SLOPE.
        self._stationary = spread * (SLOPE / self._rate) ** 2 / spread[1, 1]
        self._first = 0 if across is None else across.size
        self.size = self._first + 2 + n
        self._height = slice(self._first + 2, self.size)

    def prior(self) -> tuple[Array, Array]:
        """Mean and covariance of the state before any measurement: no deviation, the expected variances."""
        P = np.zeros((self.size, self.size))
        if self._across is not None:
            P[: self._first, : self._first] = self._across.prior()[1]
        P[self._first, self._first], P[self._first + 1, self._first + 1] = DISPLACEMENT**2, TILT**2
        P[self._height, self._height] = self._stationary
        return np.zeros(self.size), P

    @property
    def begin(self) -> float:
        """Arc length from which on the map across the path holds places [m]."""
        return -np.inf if self._across is None else self._across.begin

    def basis(self, s: Array, stand: Stand | None = None) -> Array:
        """Deviation per state ``(m, directions, size)``: the map's across the path, the derivatives' in height."""
        s = np.asarray(s, dtype=float)
        stand = stand or Stand(self.begin, 0.0)
        return np.asarray(_basis(s, self._rate * (s - stand.s), self._rows_across(s, stand), self._first_rows))

    def travel(self, s: float) -> tuple[Array, Array] | None:
        """Transition ``(F, Q)`` of the map across the path when the arm has reached ``s``; None if there is none."""
        step = None if self._across is None else self._across.travel(s)
        if step is None:
            return None
        F, Q = np.eye(self.size), np.zeros((self.size, self.size))
        F[: self._first, : self._first], Q[: self._first, : self._first] = step
        return F, Q

    def carry(self, way: float, out: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
        """Transition ``(F, Q)`` of the state over a distance ``way`` [m]; only its own block of ``out`` is written."""
        F, Q = (np.eye(self.size), np.zeros((self.size, self.size))) if out is None else out
        _carry(self._rate * way, self._powers, self._stationary, F[self._height, self._height],
               Q[self._height, self._height])
        return F, Q

    def told(self, s: Array, stand: Stand) -> bool:
        """Whether earlier measurements bear on the deviation at ``s (m,)`` [m] through the state alone."""
        return bool(s.min() >= stand.s)

    def spread(self, s: Array, stand: Stand) -> Array:
        """Variance that the height gains between the state's place and ``s``, ``(m, 2)`` [m²]."""
        return np.asarray(_left(self._rate * (s - stand.s), self._first_rows, self._stationary))


class RowsAcross:
    """Caches the rows of the map across the path for the last places, which all length scales share."""

    def __init__(self, model: PathDeviation | None) -> None:
        self._model = model
        self._asked: tuple[bytes, float] | None = None
        self._rows = np.zeros((0, 0))

    def __call__(self, s: Array, stand: Stand) -> Array:
        """``(m, size)`` at arc lengths ``(m,)`` [m]."""
        if self._model is None:
            return np.zeros((len(s), 0))
        if (key := (s.tobytes(), stand.begin)) != self._asked:
            self._asked, self._rows = key, np.ascontiguousarray(self._model.basis(s, stand)[:, 0])
        return self._rows


@jit()
def _basis(s: Array, u: Array, across: Array, first_rows: Array) -> Array:  # pragma: no cover
    """Rows ``(m, 2, size)`` at arc lengths ``s (m,)`` [m], ways ``u (m,)`` [1/rate] ahead; ``across (m, n)``."""
    m, n = across.shape
    rows, H = _rows(u, first_rows), np.zeros((m, 2, n + 2 + first_rows.shape[1]))
    for i in range(m):
        H[i, 0, :n] = across[i]
        H[i, 1, n], H[i, 1, n + 1] = 1.0, s[i]
        H[i, 1, n + 2 :] = rows[i]
    return H


@jit()
def _rows(u: Array, first_rows: Array) -> Array:  # pragma: no cover
    """First rows of F at ways ``u (m,)`` [1/rate] ahead, by the states: ``(m, p + 1)``."""
    rows = np.zeros((u.size, first_rows.shape[1]))
    for i in range(u.size):
        factor = np.exp(-u[i])
        for k in range(first_rows.shape[0]):
            for j in range(first_rows.shape[1]):
                rows[i, j] += factor * first_rows[k, j]
            factor *= u[i]
    return rows


@jit()
def _left(u: Array, first_rows: Array, stationary: Array) -> Array:  # pragma: no cover
    """What comes to the height on ways ``u (m,)`` [1/rate] ahead: variance across and along ``up``, ``(m, 2)`` [m²]."""
    rows, variance = _rows(np.maximum(u, 0.0), first_rows), np.zeros((u.size, 2))
    for i in range(u.size):
        if u[i] > 0.0:
            variance[i, 1] = max(stationary[0, 0] - rows[i] @ stationary @ rows[i], 0.0)
    return variance


@jit()
def _carry(u: float, powers: Array, stationary: Array, F: Array, Q: Array) -> None:  # pragma: no cover
    """Writes F of a way ``u`` [1/rate], and into Q the covariance of what comes to the states on it."""
    step, factor = np.zeros_like(stationary), np.exp(-u)
    for k in range(powers.shape[0]):
        for i in range(step.shape[0]):
            for j in range(step.shape[1]):
                step[i, j] += factor * powers[k, i, j]
        factor *= u
    F[:] = step
    Q[:] = stationary - step @ stationary @ step.T


def surfaces(across: Callable[[], PathDeviation] | None = None,
             lengths: Sequence[float] = LENGTHS) -> list[DeviationModel]:
    """Models of all length scales, each with a map across the path of its own."""
    maps = [None if across is None else across() for _ in lengths]
    rows = RowsAcross(maps[0] if maps else None)
    return [SmoothSurface(length, lateral, rows) for length, lateral in zip(lengths, maps, strict=True)]


# The arm angles while in contact: the observer behind the gears, repeated once the forces are known.

KEPT = 0.2
"""Time for which a cycle waits for its force; after that the expected one has to do [s]."""


@dataclass
class _Cycle:
    """A cycle: its end, motor angles there, contact torques expected and sensed, the arm then, the steps it took."""

    t: float
    q: Array
    expected: Array
    felt: list[Array]
    state: ObserverState
    steps: int


class FeltArm:
    r"""Estimates arm angles from motor angles and from contact forces, which arrive late.

    A force that is not the expected one bends the gears and swings the arm on them. An observer with the expected force
    mistakes that oscillation for a shape of the surface, and a stiff contact turns it into force. So each cycle is
    first estimated with the torques that are expected, and again when its forces have arrived:

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

    def step(self, t: float, q: Array, expected: Array, steps: int = 1) -> Array:
        """The arm angles ``(n,)`` [rad] at ``t``, with the forces received so far.

        Args:
            t: end of the cycle [s].
            q: motor angles then ``(n,)`` [rad].
            expected: joint torques of the contact during it ``(n,)`` [N m].
            steps: number of controller cycles since the last call; more than one if cycles were missed.
        """
        before = self._cycles[-1].state if self._cycles else self._settled
        self._cycles.append(_Cycle(t, q, expected, [], self._went_on(before, q, expected, steps), steps))
        while self._cycles[0].t < t - KEPT:
            self._settled = self._cycles.popleft().state
        return self._cycles[-1].state.q_a

    def feel(self, t: Array, force: Array) -> list[tuple[float, Array]]:
        """Adds contact forces ``(m, 3)`` [N, base frame] of the instants ``t (m,)`` [s].

        Returns instants [s] and arm angles ``(n,)`` [rad] of all cycles whose estimate has changed.
        """
        first = len(self._cycles)
        for instant, sample in zip(t, force, strict=True):
            index = next((i for i, cycle in enumerate(self._cycles) if instant <= cycle.t), len(self._cycles))
            if index == len(self._cycles):
                continue
            cycle = self._cycles[index]
            cycle.felt.append(self._torque(cycle.state.q_a, sample))
            first = min(first, index)
        state = self._cycles[first - 1].state if first else self._settled
        changed = []
        for cycle in list(self._cycles)[first:]:
            torque = np.mean(cycle.felt, axis=0) if cycle.felt else cycle.expected
            state = cycle.state = self._went_on(state, cycle.q, torque, cycle.steps)
            changed.append((cycle.t, state.q_a))
        # No more forces arrive for older cycles.
        while len(self._cycles) > 1 and self._cycles[1].felt and self._cycles[0].t < float(np.min(t)) - 0.05:
            self._settled = self._cycles.popleft().state
        return changed

    def _went_on(self, state: ObserverState, q: Array, torque: Array, steps: int) -> ObserverState:
        """The arm some cycles later, the motors evenly on their way to ``q (n,)`` [rad]."""
        for remaining in range(steps, 0, -1):
            state = self._observer.step(state, state.q + (q - state.q) / remaining, torque)
        return state
