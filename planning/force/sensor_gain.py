r"""The gain of a force sensor, measured against another source: a stated weight, or the motors.

A sensor of gain γ shows γ times the force. A tool of known mass m that it weighs as :math:`\hat m` says :math:`\gamma =
\hat m / m`. While the tip is pressed slowly and evenly, the motors' torque beyond the model's balances the external
force, so with the force :math:`F_s` that the sensor shows

.. math:: r_j = \tau_j - \tau_{M,j} = b_j + \delta_{jk} + \epsilon_{jk}\, e^{-x_j / d_j} - \kappa\, (J^T F_s)_j
              + \nu_j, \qquad \kappa = 1/\gamma

Friction beside the model's, b, stays while the joints slide on. At each other speed k it differs by δ, which it reaches
over the presliding distance d, with x the distance since that speed was reached; δ and ε are no larger than dry
friction itself, as slow as that is. ν is what the torques scatter by from cycle to cycle, and in blocks of some tenths
of a second by as much more as their mean leaves there; it may be alike in neighbouring blocks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ideal_robot.arrays import Array, G
from ideal_robot.estimate.gaussian import posterior
from ideal_robot.tolerances import ROUNDING
from sensing.force.force_calibration import UNEXPLAINED, ToolLoad

BY_CHANCE = 1e-5
"""Probability with which a sound sensor is refused at one look; the motors' are some ten looks at what is nearly the
same, so that it is at most once in 10⁴ runs."""
LOSSES = 0.05
"""What a drive's constant and its gear's losses, which grow with the load, may make of a torque, standard deviation:
data sheets give torque constants to some per cent, and gears lose 5 to 10 % of what they transmit."""
BLOCK = 0.2
"""Time over which torques are averaged [s]."""
_BLOCKS = 120
"""Blocks into which a way through air is divided that takes long: more cost time, and tell no more."""
ALIKE = 0.05
"""Share by which speeds may differ at which friction is the same."""
FEWEST = 12
"""Blocks from which a gain is told; fewer say nothing of how they scatter."""
SLIDES = 5.0
"""Presliding distances behind which a joint that has turned round slides: 1 % of its friction has not turned then."""
_SILENT, _ANY = 1e-9, 1e6
"""Least variance of a torque, of a motor without noise, and that of friction beside the model's [N² m²]."""
PRIOR = 0.5
"""Standard deviation of κ before any witness has said anything: gains of 0.5 are within two of them. Beyond are units
and ranges that were mistaken, of which pressing feels too little, or leaps."""
_TWO_SIGMA = 2.0
"""Standard deviations of κ up to which a surface is spared: one gain in 44 lies beyond, in the direction that presses
harder."""


@dataclass(frozen=True)
class SensorGain:
    """A sensor's gain with its standard deviation, as one source measured it.

    Attributes:
        inverse: κ = 1/γ, the true force over the one that is shown; 1 is right.
        sigma: standard deviation of that with a sound sensor.
        witness: what it was measured against, in words.
    """

    inverse: float
    sigma: float
    witness: str

    @property
    def value(self) -> float:
        """The estimated gain γ."""
        return 1.0 / self.inverse if self.inverse > 0.0 else np.inf

    @property
    def shown(self) -> str:
        """The gain with its standard deviation and its source, in words."""
        return f"{self.value:.2f} ± {self.sigma * min(self.value, 9.0) ** 2:.2f} by {self.witness}"

    @property
    def wrong(self) -> bool:
        """Whether the gain deviates from 1 so far that a correct sensor would show it once in 10⁵ times."""
        return not ((self.inverse - 1.0) / self.sigma) ** 2 <= chdtri(1, BY_CHANCE)

    @property
    def at_most(self) -> float:
        """Upper bound of the true force over the shown one: two standard deviations above the estimate."""
        return self.inverse + _TWO_SIGMA * self.sigma

    @property
    def ratio(self) -> tuple[float, float]:
        """The ratio κ = 1/γ of the true force to the shown one, and its standard deviation."""
        return self.inverse, self.sigma

    @property
    def passes(self) -> tuple[float, float]:
        """The least and the largest gain that this test would accept in half of the cases."""
        far = float(np.sqrt(chdtri(1, BY_CHANCE))) * self.sigma
        return 1.0 / (1.0 + far), 1.0 / (1.0 - far) if far < 1.0 else np.inf

    @property
    def text(self) -> str:
        """The test's result in words, with the gains that it would accept."""
        least, largest = self.passes
        return f"{self.shown}; one from {least:.2f} to {largest:.2f} would pass"

    def json(self) -> dict[str, float | str]:
        """Plain values for JSON."""
        least, largest = self.passes
        return {"value": self.value, "sigma_of_inverse": self.sigma, "witness": self.witness, "passes_from": least,
                "passes_to": largest, "text": self.text}


UNKNOWN = SensorGain(1.0, PRIOR, "nobody")
"""A gain that nobody has measured."""


def best_known(gains: Iterable[SensorGain]) -> SensorGain:
    """The gain of the source with the smallest standard deviation; ``UNKNOWN`` without one."""
    return min(gains, key=lambda gain: gain.sigma, default=UNKNOWN)


NOT_MEASURED = ("not measured: whatever it is, the surface bears as much more than is shown; tell what hangs on the "
                "sensor (--tool-mass), or let the controller tell its torques")
"""What is said where no witness is."""


def wrong_gain(gain: SensorGain) -> str:
    """The error message for a wrong gain."""
    return (f"the force sensor's gain is {gain.shown}, where a sound sensor's is 1; have it calibrated, and check its "
            "range, its counts per newton and what was stated")


def gain_by_weight(tool: ToolLoad, mass: float) -> SensorGain:
    """The gain from a tool of stated mass and the mass by which the sensor weighed it.

    Args:
        tool: as it was weighed.
        mass: of all that hangs on the sensor [kg].
    """
    sigma = float(np.hypot(UNEXPLAINED, tool.residual[0] / (mass * G)))
    return SensorGain(mass / tool.mass, sigma, f"the stated {mass:g} kg")


def block_cycles(T: float, lasts: float) -> int:
    """Cycles per block, for cycles of T [s] and a distance through air that lasts ``lasts`` [s]."""
    return round(max(BLOCK, lasts / _BLOCKS) / T)


class GainByMotors:
    """Estimates a force sensor's gain from the motor torques, in cycles in which the tip moves evenly.

    Args:
        beside: standard deviation of the unmodelled change of a torque with the speed ``(n,)`` [N m].
        distance: presliding distance of the joints ``(n,)`` [rad].
        cycles: of a block.
    """

    def __init__(self, beside: Array, distance: Array, cycles: int) -> None:
        self._beside, self._cycles = np.asarray(beside, dtype=float), cycles
        self._distance = np.maximum(distance, ROUNDING)
        self._from: Array | None = None
        self._now: list[tuple[Array, Array, Array]] = []
        self._blocks: list[tuple[int, Array, Array, Array, Array, Array]] = []
        self._speeds = list[float]()
        self._speed: float | None = None
        self._told: tuple[int, SensorGain | None] = 0, None

    def add(self, rest: Array, arm: Array, way: Array, speed: float) -> None:
        """Adds a cycle of even motion.

        Args:
            rest: torques beyond the model's ``(n,)`` [N m]; not finite where the controller reports none.
            arm: torques of the force that the sensor shows, Jᵀ F ``(n,)`` [N m].
            way: since each joint turned round ``(n,)`` [rad].
            speed: of the tip [m/s].
        """
        if not np.isfinite(rest).all():
            self.uneven()
            return
        if self._speed is None or abs(speed - self._speed) > ALIKE * self._speed:
            self.uneven()
            self._speed = next((known for known in self._speeds if abs(speed - known) <= ALIKE * known), speed)
            if self._speed not in self._speeds:
                self._speeds.append(self._speed)
        self._from = way if self._from is None else self._from
        self._now.append((rest, arm, way))
        if len(self._now) == self._cycles:
            rests, arms, ways = (np.array(part) for part in zip(*self._now, strict=True))
            slides = ways[0] > SLIDES * self._distance
            changes = np.exp(-(ways.mean(axis=0) - self._from) / self._distance)
            # Differences of neighbours remove slow drift.
            white = np.mean(np.diff(rests, axis=0) ** 2, axis=0) / 2.0
            self._blocks.append((self._speeds.index(self._speed), rests.mean(axis=0), arms.mean(axis=0), white, slides,
                                 changes))
            self._now.clear()

    @property
    def told(self) -> SensorGain | None:
        """The gain as estimated so far; None while it is not determined."""
        if self._told[0] != len(self._blocks):
            self._told = len(self._blocks), self._gain()
        return self._told[1]

    @property
    def scatter(self) -> Array | None:
        """Standard deviation of the torques from cycle to cycle ``(n,)`` [N m]; None before the first block."""
        return np.sqrt(np.mean([block[3] for block in self._blocks], axis=0)) if self._blocks else None

    def uneven(self) -> None:
        """Notes that the motion changes its speed, so that friction changes from now on."""
        self._now.clear()
        self._from = None
        self._speed = None

    def _gain(self) -> SensorGain | None:
        """What is known by now; None while it is nothing."""
        if len(self._blocks) < FEWEST:
            return None
        speed = np.array([block[0] for block in self._blocks])
        rest, arm, white, slides, changes = (np.array(part) for part in zip(*(block[1:] for block in self._blocks),
                                                                            strict=True))
        noise = np.sqrt(np.maximum(white.mean(axis=0), _SILENT) / self._cycles)
        joints = np.flatnonzero(slides.sum(axis=0) >= FEWEST)
        # Unknowns: κ, and for each joint b, and δ and ε at each speed.
        S = len(self._speeds)
        rows, precision = list[Array](), [0.0]
        for i, j in enumerate(joints):
            heard = slides[:, j]
            at = np.equal.outer(speed[heard], np.arange(S)).astype(float)
            own = np.zeros((len(at), len(joints), 1 + 2 * S))
            own[:, i] = np.column_stack([np.ones(len(at)), at, at * changes[heard, j][:, None]])
            rows.append(np.column_stack([-arm[heard, j], own.reshape(len(at), -1), rest[heard, j]]) / noise[j])
            precision += [1.0 / _ANY, *np.full(2 * S, self._beside[j] ** -2.0)]
        if not rows:
            return None
        columns = np.vstack(rows)
        known = posterior(columns.T @ columns, np.diag(precision))
        variance = float(known.covariance[0, 0])
        if variance > PRIOR**2:
            return None
        # Where blocks scatter more than noise explains, their own scatter is used.
        variance *= max(known.squares / max(len(columns) - len(joints) - 1, 1), 1.0)
        drifting = sum(_drifting(one[:, :-1] @ known.covariance[0], one[:, -1] - one[:, :-1] @ known.mean)
                       for one in rows)
        return SensorGain(float(known.mean[0]), float(np.hypot(np.sqrt(max(variance, drifting)), LOSSES)),
                          "the motors")


def _drifting(weights: Array, left: Array) -> float:
    r"""Variance of a weighted sum of residuals that are alike in neighbouring blocks (Newey and West 1987).

    .. math:: \sum_{|l| \le m} \Big(1 - \frac{|l|}{m + 1}\Big)\, \gamma_l \sum_k w_k w_{k+l}

    γ is their autocovariance. With the weights w of an estimate that rises with the force, what drifts meanwhile counts
    for more than as much scatter; so m is the number of blocks that have half of the weight.

    Args:
        weights: w ``(n,)``.
        left: residuals ``(n,)``.
    """
    size = np.sort(np.abs(weights))[::-1]
    m = min(1 + int(np.searchsorted(np.cumsum(size), 0.5 * size.sum())), len(left) - 1)
    lags = np.arange(-m, m + 1)
    middle = len(left) - 1
    alike, both = (np.correlate(one, one, "full")[middle + lags] for one in (left, weights))
    return float((1.0 - np.abs(lags) / (m + 1)) @ (alike / len(left) * both))
