"""Fusion of asynchronous, late and unordered measurements of the deviation from the reference ([L] 4.3)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
from filterpy.kalman import KalmanFilter

from ideal_robot.arrays import Array
from planning.line.deviation_model import DeviationModel, Stand
from planning.line.hypotheses import Gates, Hypotheses, Hypothesis
from planning.line.late import Before, Buffer
from planning.line.measurement import (
    Equation,
    Fused,
    Measurement,
    check,
    extended,
    mean_and_variance,
    rows_along,
    widened,
)
from planning.line.smoother import LOOKED_BACK, Passed, smoothed


class DeviationFilter:
    r"""Kalman filter over a deviation model.

    Measurement equation, for each value :math:`z_i` at arc length :math:`s_i` in direction :math:`g_i`:

    .. math:: z_i = g_i^T \left(\Delta x_r(s_i) \right) + b_i^T \beta + v_i

    or a linear combination of such values, with :math:`\Delta x_r` linear in the model's state, errors :math:`\beta` of
    the sensor itself (constant, e.g. a wrong mounting angle) and noise :math:`v` with the covariance stated by the
    measurement. Repeated observations of a point from different places separate :math:`\beta` from :math:`\Delta x_r`.

    A value is left out if its innovation is beyond ``gate`` standard deviations, a whole measurement if most of its
    values are, or if its normalised innovation squared is beyond the ``significance`` bound. Measurements left out feed
    a rival hypothesis that starts from the prior; after ``confirm`` of them in a row that agree with one another it
    takes over: then the map was wrong, not the sensor. A measurement that is only doubtful begins a hypothesis of its
    own that keeps the map and takes the sensor to have been moved: its errors begin anew, with the standard deviations
    ``moved``. It takes over once it has become clearly likelier, with ``AGREED`` measurements that agree; see
    ``Hypotheses``.

    Args:
        model: prior and dynamics of the deviation.
        biases: for each sensor the standard deviations of its errors :math:`\beta`.
        gate: bound for single values, in standard deviations.
        significance: probability that a valid measurement is rejected.
        confirm: measurements until a rival hypothesis takes over; 0 for never. Models that drift have none: of two
            sensors along one surface the one that agrees with itself would always outvote the other.
        moved: for each sensor that may be knocked, the standard deviations of its errors after that.
    """

    def __init__(self, model: DeviationModel, *, biases: Mapping[str, tuple[float, ...]] | None = None,
                 gate: float = 4.0, significance: float = 1e-4, confirm: int = 10,
                 moved: Mapping[str, tuple[float, ...]] | None = None) -> None:
        self.model = model
        self._bias_at: dict[str, slice] = {}
        size, variances = model.size, []
        for sensor, sigmas in (biases or {}).items():
            self._bias_at[sensor] = slice(size, size + len(sigmas))
            size += len(sigmas)
            variances += [sigma**2 for sigma in sigmas]
        self._size, self._bias_variances = size, variances
        # These matrices are overwritten in every step.
        self._F, self._Q = np.eye(size), np.zeros((size, size))
        self._way = self._F[: model.size, : model.size], self._Q[: model.size, : model.size]
        self.hypotheses = Hypotheses(self._fresh, Gates(gate, significance), 0 if model.drifts else confirm,
                                     {sensor: (self._bias_at[sensor], errors)
                                      for sensor, errors in (moved or {}).items()})
        self._stand = Stand(model.begin)
        self._buffer = Buffer()
        self._passed: deque[Passed] = deque(maxlen=LOOKED_BACK)
        self.t = -np.inf
        """Latest instant that was measured at [s]."""

    @property
    def kf(self) -> KalmanFilter:
        """State and covariance: of the model, then of the sensors' errors."""
        return self.hypotheses.map.kf

    def _fresh(self) -> Hypothesis:
        x, prior = self.model.prior()
        P = np.zeros((self._size, self._size))
        P[: len(x), : len(x)] = prior
        P[len(x) :, len(x) :] = np.diag(self._bias_variances)
        return Hypothesis.of(np.concatenate([x, np.zeros(len(self._bias_variances))]), P)

    def travel(self, s: float) -> None:
        """Moves the state along with the arm, which is at arc length ``s`` [m]."""
        while (step := self.model.travel(s)) is not None:
            F, Q = np.eye(self._size), np.zeros((self._size, self._size))
            F[: self.model.size, : self.model.size], Q[: self.model.size, : self.model.size] = step
            self._passed.append(Passed(self._stand, self.kf.x, self.kf.P, F, Q))
            if self.model.drifts:
                self._remember(self.t, (F, Q))
            self._step(F, Q, self.model.begin)

    def _step(self, F: Array, Q: Array, begin: float) -> None:
        self.hypotheses.predict(F, Q)
        self._stand = Stand(begin, self._stand.s)

    def _remember(self, t: float, then: Measurement | tuple[Array, Array]) -> None:
        self._buffer.add(Before(t, self._stand, self.kf.x, self.kf.P, then))

    def update(self, measurement: Measurement) -> Fused:
        """Fuses one measurement, which may be older than those before.

        Raises ``InputError`` where shapes do not fit each other or the model, or values are not finite.
        """
        check(measurement, self.model.directions)
        return self.take(measurement)

    def take(self, measurement: Measurement) -> Fused:
        """Fuses a measurement whose shapes and values are already checked, see ``update``."""
        t = measurement.t
        if not self.model.drifts:
            # Without drift the order and the delay of measurements do not matter.
            self.t = max(self.t, t)
            return self._fuse(measurement, measurement.covariance)
        if t < self.t and self.model.told(measurement.s, self._stand):
            t = self.t
        late = self._buffer.taken_back(t) if t < self.t else []
        if late is None:
            nothing = np.zeros(len(measurement.value))
            return Fused(nothing.astype(bool), nothing, 0.0, 0, "too late")
        if late:
            # Goes back to the state before the first younger one, then fuses all in the right order.
            self.kf.x, self.kf.P, self._stand = late[0].x, late[0].P, late[0].stand
            self.t = t if self._buffer.newest is None else self._buffer.newest
        fused = self._in_time(measurement, t)
        for past, after in zip(late, [*(entry.stand.begin for entry in late[1:]), self.model.begin], strict=False):
            if isinstance(past.then, Measurement):
                self._in_time(past.then, past.t)
            else:
                self._remember(past.t, past.then)
                self._step(*past.then, after)
        return fused

    def _in_time(self, measurement: Measurement, t: float) -> Fused:
        self._remember(t, measurement)
        self._buffer.forget(t)
        way = 0.0 if measurement.at is None else max(measurement.at - self._stand.s, 0.0)
        if way > 0.0 and self.model.carry(way, self._way) is not None:
            self.kf.predict(F=self._F, Q=self._Q)
        self.t, self._stand = t, Stand(self._stand.begin, self._stand.s + way)
        ahead, R = self.model.spread(measurement.s, self._stand), measurement.covariance
        if ahead is not None and measurement.direction is not None:
            R = widened(R, measurement.direction, ahead)
        return self._fuse(measurement, R)

    def _fuse(self, measurement: Measurement, R: Array) -> Fused:
        before = self.hypotheses.map
        fused = self.hypotheses.fuse(self._equation(measurement, R))
        if self.hypotheses.map is not before:
            # The stored past does not belong to the new hypothesis.
            self._passed.clear()
        return fused

    def _rows(self, measurement: Measurement) -> Array:
        basis, size = self.model.basis(measurement.s, self._stand), self.model.size
        rows = basis[:, 0] if measurement.direction is None else rows_along(measurement.direction, basis)
        H = np.zeros((len(measurement.value), self._size))
        H[:, :size] = rows if measurement.combination is None else measurement.combination @ rows
        if measurement.bias is not None and measurement.sensor in self._bias_at:
            H[:, self._bias_at[measurement.sensor]] = measurement.bias
        return H

    def _equation(self, measurement: Measurement, R: Array) -> Equation:
        H, z = self._rows(measurement), measurement.value
        if measurement.origin is not None:
            kf, ratio = self.kf, self._bias_at[measurement.sensor].start
            z, R = extended(H, z, R, kf.x, kf.P, measurement.origin, (self.model.size, ratio))
        return Equation(H, z, R, measurement.sensor, measurement.combination is not None)

    def deviation(self, s: Array) -> tuple[Array, Array]:
        """Estimated deviation and variance at arc lengths ``s (m,)`` [m], also ahead of all measurements: [L] (6).

        ``(m, directions)`` [m] and its variance ``(m, directions)`` [m²].
        """
        H, size, kf = self.model.basis(s, self._stand), self.model.size, self.kf
        mean, variance = mean_and_variance(np.ascontiguousarray(H.reshape(-1, size)), kf.x[:size],
                                           np.ascontiguousarray(kf.P[:size, :size]))
        ahead = self.model.spread(s, self._stand)
        return mean.reshape(H.shape[:2]), variance.reshape(H.shape[:2]) + (0.0 if ahead is None else ahead)

    def looked_back(self, s: Array) -> tuple[Array, Array]:
        """The deviation smoothed by all measurements, also those after a place was passed.

        At arc lengths ``s (m,)`` [m] of the last ``LOOKED_BACK`` steps, since the map was last replaced: ``(m,
        directions)`` [m] and its variance ``(m, directions)`` [m²]; NaN beyond these steps.
        """
        return smoothed(self.model, self._passed, self.kf, self._stand, s)

    @property
    def s(self) -> float:
        """Arc length of the present state [m]."""
        return self._stand.s

    @property
    def state(self) -> Array:
        """State of the deviation model ``(size,)``."""
        return np.asarray(self.kf.x[: self.model.size])

    def mean(self, s: Array) -> Array:
        """The estimated deviation at ``s (m,)`` without its variance, ``(m, directions)`` [m]."""
        H = self.model.basis(s, self._stand)
        return np.asarray((H.reshape(-1, self.model.size) @ self.state).reshape(H.shape[:2]))

    def covariance(self, H: Array) -> Array:
        """Covariance ``(m, m)`` of linear functions ``H (m, size)`` of the state."""
        size = self.model.size
        return np.asarray(H @ self.kf.P[:size, :size] @ H.T)

    def bias(self, sensor: str) -> tuple[Array, Array]:
        """Estimated errors of a sensor ``(b,)`` and their standard deviations."""
        entries = self._bias_at[sensor]
        return self.kf.x[entries].copy(), np.sqrt(np.diag(self.kf.P)[entries])
