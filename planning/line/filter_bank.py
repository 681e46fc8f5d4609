"""A bank of filters with different models on the same measurements, weighted by their likelihoods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from planning.line.deviation_model import DeviationModel
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement, check

FORGETS = 0.1
"""s_f: way over which what was likely before counts for less [m]: a surface changes its shape."""


class FilterBank:
    r"""A filter bank (multiple models, Magill 1965): filters of the same directions and sensors.

    What ``filterpy``'s ``MMAEFilterBank`` does, with gates, late measurements and forgetting.

    .. math:: p_i \propto \exp \sum_k e^{-(s - s_k) / s_f} \ln p(z_k \mid i), \qquad
              \Delta x_r = \sum_i p_i\, \Delta x_{r,i}
    """

    def __init__(self, members: Sequence[DeviationFilter]) -> None:
        self.members = list(members)
        self._log, self._s = np.zeros(len(self.members)), 0.0
        self._weights = np.full(len(self.members), 1.0 / len(self.members))

    @property
    def likeliest(self) -> DeviationFilter:
        """The member with the largest probability."""
        return self.members[int(np.argmax(self._log))]

    @property
    def model(self) -> DeviationModel:
        """Model of the likeliest member."""
        return self.likeliest.model

    @property
    def s(self) -> float:
        """Arc length of the present state [m]."""
        return self.members[0].s

    def travel(self, s: float) -> None:
        """Moves all states along with the arm, which is at arc length ``s`` [m]."""
        for member in self.members:
            member.travel(s)

    def update(self, measurement: Measurement) -> Fused:
        """Fuses one measurement in every member; returns the result of the likeliest."""
        check(measurement, self.model.directions)
        every = [member.take(measurement) for member in self.members]
        if measurement.at is not None and measurement.at > self._s:
            self._log *= np.exp((self._s - measurement.at) / FORGETS)
            self._s = measurement.at
        self._log += [fused.likelihood for fused in every]
        self._log -= self._log.max()
        weights = np.exp(self._log)
        self._weights = weights / weights.sum()
        return every[int(np.argmax(self._log))]

    def deviation(self, s: Array) -> tuple[Array, Array]:
        """Estimated deviation at ``s (m,)`` [m] and its variance, with the differences between the members."""
        every = [member.deviation(s) for member in self.members]
        means, variances = np.array([estimate[0] for estimate in every]), np.array([estimate[1] for estimate in every])
        mean = self._mixed(means)
        return mean, self._mixed(variances + (means - mean) ** 2)

    def mean(self, s: Array) -> Array:
        """The estimated deviation at ``s (m,)`` without its variance, ``(m, directions)`` [m]."""
        return self._mixed(np.array([member.mean(s) for member in self.members]))

    def _mixed(self, every: Array) -> Array:
        """The mean of the members' values ``(members, m, directions)``, weighted by their probabilities."""
        return np.asarray((self._weights @ every.reshape(len(every), -1)).reshape(every.shape[1:]))
