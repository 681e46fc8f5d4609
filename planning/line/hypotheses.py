"""Hypotheses of a changed map or sensor: filters on the same measurements, compared by their likelihood.

The map is kept while it explains the measurements. The alternatives are a new map, where measurements contradict the
old one but agree with one another, and maps with a moved sensor. The covariance alone decides what agrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.special import chdtri

from ideal_robot.arrays import Array
from planning.line.measurement import Equation, Fused, Innovation, within

DOUBT = 1e-2
"""Probability with which a measurement that has nothing wrong makes one think of a moved sensor."""
AT_ONCE = 3
"""Instants at which a sensor may have been moved that are weighed beside each other."""
LEAD = 6.0
"""Difference of the logarithms of likelihood at which one hypothesis is dropped for the other."""
WEIGHED = 15
"""Measurements after which two hypotheses that are still equally likely are one."""
AGREED = 3
"""Measurements with which the hypothesis of a moved sensor has to agree until it takes over."""
_MOST = 64
"""Values of a measurement from which on the bound of its normalised innovation squared stays."""


@dataclass
class Hypothesis:
    """A filter, how often it agreed with the sensors, and its likelihood relative to the map.

    Attributes:
        kf: state and covariance.
        agreed: measurements that were fused.
        weighed: measurements for which it was compared with the map.
        lead: difference of the logarithms of likelihood meanwhile.
    """

    kf: KalmanFilter
    agreed: int = 0
    weighed: int = 0
    lead: float = 0.0

    @classmethod
    def of(cls, x: Array, P: Array) -> Hypothesis:
        """A new hypothesis with state ``x (n,)`` and covariance ``P (n, n)``."""
        kf = KalmanFilter(dim_x=len(x), dim_z=1)
        kf.x, kf.P = x, P
        return cls(kf)

    def moved(self, entries: slice, sigmas: tuple[float, ...]) -> Hypothesis:
        """The same map with new sensor errors that are independent of the old ones.

        Args:
            entries: of the state that are that sensor's errors.
            sigmas: their standard deviations now.
        """
        x, P = self.kf.x.copy(), self.kf.P.copy()
        P[entries, :] = P[:, entries] = 0.0
        P[entries, entries] = np.diag(np.square(sigmas))
        return Hypothesis.of(x, P)


class Gates:
    """Gates that decide which values a filter accepts, by their covariance.

    Args:
        gate: bound for single values, in standard deviations.
        significance: probability that a valid measurement is rejected.
    """

    def __init__(self, gate: float, significance: float) -> None:
        self._gate = gate
        self._bounds = np.concatenate([[0.0], chdtri(np.arange(1, _MOST + 1), significance)]).tolist()

    def likelihood(self, seen: Innovation) -> float:
        """Logarithm of the likelihood of a measurement; an outlier has a fixed likelihood."""
        return -0.5 * (min(seen.nis, self._bounds[min(len(seen.value), _MOST)]) + seen.log_det)

    def fuse(self, hypothesis: Hypothesis, equation: Equation, seen: Innovation) -> Fused:
        """Fuses the values of a measurement that pass the gate.

        Args:
            hypothesis: takes it.
            equation: of the measurement.
            seen: its innovation under the hypothesis.
        """
        (H, z, R, _, whole), (innovation, S, nis, _) = equation, seen
        likelihood, sigma = self.likelihood(seen), float(np.sqrt(S[0, 0]))
        used: Any
        used, dof = within(innovation, S, self._gate)
        if whole and dof < len(z):
            return Fused(np.zeros_like(used), innovation, float("nan"), 0, "beyond the gate", likelihood, sigma)
        if 2 * dof < len(z):
            # With many wrong values a few pass the gate by chance, so the measurement is rejected as a whole.
            return Fused(np.zeros_like(used), innovation, float("nan"), 0, "most values beyond the gate", likelihood,
                         sigma)
        reason = ""
        if dof < len(z):
            reason, accepted = "some values beyond the gate", innovation[used]
            H, z, R = H[used], z[used], R[np.ix_(used, used)]
            nis = float(accepted @ np.linalg.solve(S[np.ix_(used, used)], accepted))
        if nis > self._bounds[min(dof, _MOST)]:
            return Fused(np.zeros_like(used), innovation, nis, 0, "innovation beyond its bound", likelihood, sigma)
        hypothesis.kf.update(z, R=R, H=H)
        hypothesis.agreed += 1
        return Fused(used, innovation, nis, dof, reason, likelihood, sigma)


class Hypotheses:
    """The map and the alternative hypotheses.

    Args:
        fresh: creates a hypothesis from the prior alone.
        gates: which measured values a hypothesis accepts.
        confirm: measurements in a row that agree with one another until a map that begins anew takes over; 0 for never.
        moved: for each sensor that may be knocked, its entries of the state, and their standard deviations after that.

    Attributes:
        map: the hypothesis in use.
        shaken: hypotheses of a moved sensor that are compared with the map.
    """

    def __init__(self, fresh: Callable[[], Hypothesis], gates: Gates, confirm: int,
                 moved: Mapping[str, tuple[slice, tuple[float, ...]]]) -> None:
        self._fresh, self._gates, self._confirm, self.moved = fresh, gates, confirm, dict(moved)
        self.begin()

    def begin(self) -> None:
        """Restarts from the prior."""
        self.map, self._rival = self._fresh(), None
        self.shaken: list[Hypothesis] = []

    _rival: Hypothesis | None

    def predict(self, F: Array, Q: Array) -> None:
        """Advances the state of every hypothesis by the transition ``F``, ``Q`` ``(n, n)``."""
        for one in (self.map, self._rival, *self.shaken):
            if one is not None:
                one.kf.predict(F=F, Q=Q)

    def fuse(self, equation: Equation) -> Fused:
        """Fuses a measurement in all hypotheses; another one may be the map afterwards."""
        innovation = equation.innovation(self.map.kf)
        moved = self._weighed(equation, innovation)
        fused = self._gates.fuse(self.map, equation, innovation)
        if moved:
            return self._replaced(moved, fused, "sensor moved")
        if fused.dof or not self._confirm:
            self._rival = None if fused.dof else self._rival
            return fused
        if self._rival is None:
            self._rival = self._fresh()
        if not self._gates.fuse(self._rival, equation, equation.innovation(self._rival.kf)).dof:
            self._rival = None
        elif self._rival.agreed >= self._confirm:
            return self._replaced(self._rival, fused, "map replaced")
        return fused

    def _replaced(self, by: Hypothesis, fused: Fused, reason: str) -> Fused:
        """Makes another hypothesis the present one; all values of the measurement are used by it."""
        self.map, self._rival, self.shaken = by, None, []
        count = len(fused.innovation)
        return Fused(np.ones(count, dtype=bool), fused.innovation, fused.nis, count, reason, sigma=fused.sigma)

    def _weighed(self, equation: Equation, seen: Innovation) -> Hypothesis | None:
        """The hypothesis of a moved sensor, once measurements have become more likely under it than under the map.

        One begins with each measurement that the map makes doubtful, and from then on it and the map take all of them.
        A knock that shows little at first is still there when more has come, and one that was thought of for nothing
        before is not in its way.
        """
        moved = self.moved.get(equation.sensor)
        if moved is None:
            return None
        likelihood = self._gates.likelihood(seen)
        if seen.nis > float(chdtri(len(equation.z), DOUBT)) and len(self.shaken) < AT_ONCE:
            self.shaken.append(self.map.moved(*moved))
        for shaken in self.shaken:
            seen_so = equation.innovation(shaken.kf)
            shaken.lead += self._gates.likelihood(seen_so) - likelihood
            shaken.weighed += 1
            self._gates.fuse(shaken, equation, seen_so)
        sure = [one for one in self.shaken if one.lead > LEAD and one.agreed >= AGREED]
        self.shaken = [one for one in self.shaken if one.lead >= -LEAD and one.weighed < WEIGHED]
        return max(sure, key=lambda one: one.lead, default=None)
