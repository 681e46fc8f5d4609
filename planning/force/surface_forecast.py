"""The surface ahead of the tip, from waves that the surface behind it has shown."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver, ObserverState
from planning.line.deviation_model import matern

# Which waves a surface has: variances of cosines and sines that make what was felt likelier.

BETTER = 0.1
"""Gain of log likelihood from which on a change of a variance is taken."""
MOST_WAVES = 8
"""Variances that are changed at a time."""
ROUNDED = 1e-6
"""What is left of a wave that is known so well that rounding hides it; its variance is left as it is."""


def likelier_variances(gamma: Array, waves: Array, inverse: Array, weights: Array, largest: float) -> Array:
    r"""Changes one variance after another to its best value, always the one that gains most.

    That is Tipping and Faul's *fast marginal likelihood* (2003), with the cosine and the sine of a wavelength as a pair
    that shares a variance. With the covariance C of all but the wave U (m, 2), its gain of log likelihood is

    .. math:: \tfrac12 \left( -\ln|I + \gamma S| + \gamma\, q^T (I + \gamma S)^{-1} q \right),
              \quad S = U^T C^{-1} U,\ q = U^T C^{-1} y

    A change is one of rank two in the covariance, so S and q of all waves follow without inverting it again.

    Args:
        gamma: variances ``(n,)`` [m²].
        waves: cosines, then sines, at the places that were felt ``(m, 2 n)``.
        inverse: of the covariance of what was felt, with these variances in it ``(m, m)`` [1/m²].
        weights: ``inverse`` times what was felt ``(m,)`` [1/m].
        largest: bound of a variance [m²].
    """
    n, gamma = len(gamma), gamma.copy()
    solved = inverse @ waves
    # Of all waves, as with the present variances: S by its elements, and q.
    S = np.stack([_columns(waves[:, :n], solved[:, :n]), _columns(waves[:, :n], solved[:, n:]),
                  _columns(waves[:, n:], solved[:, n:])])
    q = (waves.T @ weights).reshape(2, n)
    for _ in range(MOST_WAVES):
        # As if the wave were not in the covariance.
        left = np.stack([1.0 - gamma * S[0], -gamma * S[1], 1.0 - gamma * S[2]])
        size = left[0] * left[2] - left[1] ** 2
        sure = (left[0] > ROUNDED) & (size > ROUNDED**2)
        without = np.stack([left[2], -left[1], left[0]]) / np.where(sure, size, 1.0)
        alone = _times(without, S)
        seen = np.stack([without[0] * q[0] + without[1] * q[1], without[1] * q[0] + without[2] * q[1]])
        # The best variance of a pair whose S is a multiple of the identity, which it nearly is.
        spread, fit = 0.5 * (alone[0] + alone[2]), 0.5 * (seen**2).sum(axis=0)
        best = np.minimum(np.where(fit > spread, (fit - spread) / spread**2, 0.0), largest)
        best = np.where(sure, best, gamma)
        gain = np.where(sure, _gain(best, alone, seen) - _gain(gamma, alone, seen), 0.0)
        most = int(np.argmax(gain))
        if gain[most] <= BETTER:
            break
        change, gamma[most] = best[most] - gamma[most], best[most]
        pair = [most, n + most]
        core = np.linalg.inv(np.eye(2) / change + np.array([[S[0, most], S[1, most]], [S[1, most], S[2, most]]]))
        with_pair = waves.T @ solved[:, pair]
        gone = with_pair @ core
        q -= (gone @ q[:, most]).reshape(2, n)
        S -= np.stack([(gone[:n] * with_pair[:n]).sum(axis=1), (gone[:n] * with_pair[n:]).sum(axis=1),
                       (gone[n:] * with_pair[n:]).sum(axis=1)])
        solved -= solved[:, pair] @ gone.T
    return gamma


def _columns(a: Array, b: Array) -> Array:
    """Products of the columns of two matrices ``(n,)``."""
    return np.einsum("ij,ij->j", a, b)


def _times(left: Array, right: Array) -> Array:
    """Products ``(3, n)`` of symmetric matrices that commute."""
    return np.stack([left[0] * right[0] + left[1] * right[1], left[0] * right[1] + left[1] * right[2],
                     left[1] * right[1] + left[2] * right[2]])


def _gain(gamma: Array, S: Array, q: Array) -> Array:
    """Log likelihood that waves of these variances add, each for itself ``(n,)``."""
    a, b, c = 1.0 + gamma * S[0], gamma * S[1], 1.0 + gamma * S[2]
    size = np.maximum(a * c - b * b, ROUNDED**2)
    fit = gamma * (c * q[0] ** 2 - 2.0 * b * q[0] * q[1] + a * q[1] ** 2) / size
    return np.asarray(0.5 * (fit - np.log(size)))


SPACING = 0.008
"""Way over which older measurements are one [m]."""
LEARNS = 0.004
"""Way after which the kernel is learned anew [m]."""
RECENT = 8
"""Newest measurements, which are kept as they are: a mean would be late where the tip is slow."""
WINDOW = 70
"""Places that are remembered: half a metre, two of the longer waves."""
MOST = 10
"""Measurements that count of a place where the tip stands."""
DISPLACEMENT, ROTATION = 0.02, 0.05
"""Standard deviations of the surface's height [m] and slope against the nominal plane."""
SHAPE, ROUGHEST, SMOOTHEST = 1e-4, 6e-3, 5e-6
"""Standard deviation of the shape that is no wave, at first, and its bounds [m]."""
LENGTH = 0.08
"""Distance over which that shape becomes another [m]."""
WAVELENGTHS = 1.0 / np.linspace(1.0 / 0.8, 1.0 / 0.08, 60)
"""Waves that a surface may have [m]."""
WAVES = (4e-3 * WAVELENGTHS**2 / 0.09) ** 2 / len(WAVELENGTHS)
"""Variances of the waves before any is known: the longer, the larger [m²]."""
LARGEST_WAVE = 1e-4
"""Bound of a wave's variance [m²]."""
ALIKE = 3.0
"""Standard deviations of the noise by which the sensor's errors may differ between measurements of one place."""
BEGIN = 8
"""Places from which on waves are learned."""


class SurfaceForecast:
    r"""Height along the path as a Gaussian process whose kernel is learned from what was felt.

    .. math:: k(s, s') = \sigma_0^2 + \sigma_1^2 s s' + \sigma^2\, m(s - s')
              + \sum_i \gamma_i \cos \frac{2 \pi (s - s')}{\lambda_i}

    with Matérn's correlation m. A force shows the surface under the tip and nothing ahead, so the height is continued
    over all that delays an answer, some 15 mm at 0.2 m/s. A prior of smoothness alone is poor there;
    surfaces that were milled, bent or cast have waves, and one that was felt once goes on. The
    variances γ are those that make what was felt likelier (``wave_variances``), and σ changes by factors of two for the
    same reason. Errors of the sensor itself are part of the same regression.

    Args:
        errors: standard deviations of the sensor's errors ``(b,)``, as in ``planning.line.fusion.DeviationFilter``.
    """

    def __init__(self, errors: tuple[float, ...]) -> None:
        self._errors = np.square(errors)
        # Of each place: arc length, value, variance, effects of the sensor's errors; and the measurements in it.
        self._places = np.zeros((0, 3 + len(errors)))
        self._counts: list[int] = []
        self._learned_at = -np.inf
        self._gamma, self._sigma = WAVES.copy(), SHAPE
        self._turn = 0
        self._weights: Array | None = None

    def add(self, s: float, value: float, variance: float, wrong: Array) -> None:
        """Takes one measurement.

        Args:
            s: arc length that was felt [m].
            value: height there [m].
            variance: of the value [m²].
            wrong: how much each error of the sensor adds to the value ``(b,)``.
        """
        self._places = np.vstack([self._places[-WINDOW:], np.concatenate([[s, value, variance], wrong])])
        self._counts = [*self._counts[-WINDOW:], 1]
        self._weights = None
        old = len(self._places) - RECENT - 1
        if old > 0 and self._alike(old):
            self._counts[old - 1] = min(self._counts[old - 1] + 1, MOST)
            self._places[old - 1] += (self._places[old] - self._places[old - 1]) / self._counts[old - 1]
            self._places = np.delete(self._places, old, axis=0)
            del self._counts[old]
        if s - self._learned_at >= LEARNS and len(self._places) > BEGIN:
            self._learned_at = s
            self._learn()

    def _alike(self, old: int) -> bool:
        """Whether a place is near the one before and the sensor's errors count there as much, but for the noise."""
        apart = np.abs(self._places[old] - self._places[old - 1])
        return bool(apart[0] < 0.5 * SPACING
                    and np.all(self._errors * apart[3:] ** 2 < ALIKE**2 * self._places[old, 2]))

    def height(self, s: Array) -> Array:
        """Height expected at arc lengths ``(m,)`` [m]; zero before anything was felt."""
        if not len(self._places):
            return np.zeros(len(s))
        at, origin = self._places[:, 0], self._places[-1, 0]
        if self._weights is None:
            K = self._covariance(self._sigma, self._gamma)
            self._weights = np.asarray(np.linalg.solve(K, self._places[:, 1]), dtype=np.float64)
        apart = s[:, None] - at
        cross = DISPLACEMENT**2 + ROTATION**2 * np.outer(s - origin, at - origin)
        cross += self._sigma**2 * matern(np.abs(apart), LENGTH)
        cross += (_waves(s) * np.tile(self._gamma, 2)) @ _waves(at).T
        return np.asarray(cross @ self._weights, dtype=np.float64)

    def _covariance(self, sigma: float, gamma: Array) -> Array:
        at, wrong = self._places[:, 0], self._places[:, 3:]
        away, apart = at - at[-1], at[:, None] - at
        K = DISPLACEMENT**2 + ROTATION**2 * np.outer(away, away) + sigma**2 * matern(np.abs(apart), LENGTH)
        waves = _waves(at)
        K += (waves * np.tile(gamma, 2)) @ waves.T
        return np.asarray(K + (wrong * self._errors) @ wrong.T + np.diag(self._places[:, 2]))

    def _likelihood(self, sigma: float, gamma: Array) -> tuple[float, Array, Array]:
        """Log likelihood of what was felt but for a constant, the covariance's inverse, and the latter times values."""
        K, value = self._covariance(sigma, gamma), self._places[:, 1]
        inverse = np.asarray(np.linalg.inv(K), dtype=float)
        weights = inverse @ value
        size = float(np.linalg.slogdet(K)[1])
        return -0.5 * (float(value @ weights) + size), inverse, weights

    def _learn(self) -> None:
        """One step: another size of the shape that is no wave, and other variances of some waves."""
        best, inverse, weights = self._likelihood(self._sigma, self._gamma)
        self._turn += 1
        sigma = float(np.clip(self._sigma * (0.5 if self._turn % 2 else 2.0), SMOOTHEST, ROUGHEST))
        if sigma != self._sigma:
            likelihood, other, others = self._likelihood(sigma, self._gamma)
            if likelihood > best:
                self._sigma, inverse, weights = sigma, other, others
        self._gamma = likelier_variances(self._gamma, _waves(self._places[:, 0]), inverse, weights, LARGEST_WAVE)


def _waves(s: Array) -> Array:
    """Cosines and sines of all waves at arc lengths ``(m,)`` [m], ``(m, 2 waves)``."""
    phase = 2 * np.pi / WAVELENGTHS * s[:, None]
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)


# Where the arm was while it was in contact: the observer behind the gears, run again once the force is known.

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
