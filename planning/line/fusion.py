"""Fusion of asynchronous, late and unordered measurements of the deviation from the reference ([L] 4.3)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.special import chdtri

from ideal_robot.arrays import Array
from planning.line.deviation_model import DeviationModel, Stand
from planning.line.measurement import (
    Equation,
    Fused,
    Innovation,
    Measurement,
    check,
    extended,
    mean_and_variance,
    rows_along,
    widened,
    within,
)

DOUBT = 1e-2
"""Probability with which a measurement that has nothing wrong makes one think of a moved sensor."""
AT_ONCE = 3
"""Instants at which a sensor may have been moved that are weighed beside each other."""
LEAD = 6.0
"""Difference of the logarithms of likelihood at which one hypothesis is dropped for the other."""
WEIGHED = 15
"""Measurements after which two hypotheses that are still equally likely are one."""
LOOKED_BACK = 200
"""Travel steps that are kept for the smoother: 5 m of a line."""
MEMORY = 0.5
"""How late a measurement may be where their order matters [s]."""
AGREED = 3
"""Measurements with which the hypothesis of a moved sensor has to agree until it takes over."""


@dataclass
class _Track:
    """One hypothesis: a filter, how often it agreed with the sensor, and how much likelier it is than the map's."""

    kf: KalmanFilter
    agreed: int = 0
    weighed: int = 0
    lead: float = 0.0


@dataclass
class _Memory:
    """The state before a measurement or a travel step ``(F, Q)``, and which of them it was."""

    t: float
    stand: Stand
    x: Array
    P: Array
    then: Measurement | tuple[Array, Array] = field(repr=False)


class _Passed(NamedTuple):
    """The state before a travel step, where it stood, and the step."""

    stand: Stand
    x: Array
    P: Array
    F: Array
    Q: Array


def _inverse(P: Array) -> Array:
    """Of a covariance; the pseudo-inverse where a state is known exactly, such as an error that no sensor has."""
    try:
        return np.asarray(np.linalg.inv(P))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(P, hermitian=True))


class DeviationFilter:
    r"""Kalman filter over a deviation model.

    Measurement equation, for each value :math:`z_i` at arc length :math:`s_i` in direction :math:`g_i`:

    .. math:: z_i = g_i^T \left(\Delta x_r(s_i) \right) + b_i^T \beta + v_i

    or a linear combination of such values, with :math:`\Delta x_r` linear in the model's state, errors :math:`\beta`
    of the sensor itself (constant, e.g. a wrong mounting angle) and noise :math:`v` with the covariance stated by the
    measurement. A point of the path that is seen several times from different places separates :math:`\beta` from
    :math:`\Delta x_r`.

    A value is left out if its innovation is beyond ``gate`` standard deviations, a whole measurement if most of its
    values are, or if its normalised innovation squared is beyond the ``significance`` bound. Measurements left out feed
    a rival hypothesis that starts from the prior; after ``confirm`` of them in a row that agree with one another it
    takes over: then the map was wrong, not the sensor. A measurement that is only doubtful begins a hypothesis of its
    own that keeps the map and takes the sensor to have been moved: its errors begin anew, with the standard deviations
    ``moved``. It takes over once it has become clearly likelier, with ``AGREED`` measurements that agree.

    Args:
        model: what the deviation looks like.
        biases: for each sensor the standard deviations of its errors :math:`\beta`.
        gate: bound for single values, in standard deviations.
        significance: probability with which a good measurement is left out.
        confirm: measurements until a rival hypothesis takes over; 0 for never. Models that drift have none: of two
            sensors along one surface the one that agrees with itself would always outvote the other.
        moved: for each sensor that may be knocked, the standard deviations of its errors after that.
    """

    def __init__(self, model: DeviationModel, *, biases: Mapping[str, tuple[float, ...]] | None = None,
                 gate: float = 4.0, significance: float = 1e-4, confirm: int = 10,
                 moved: Mapping[str, tuple[float, ...]] | None = None) -> None:
        self.model, self._gate, self._confirm = model, gate, 0 if model.drifts else confirm
        self._bias_at: dict[str, slice] = {}
        size, variances = model.size, []
        for sensor, sigmas in (biases or {}).items():
            self._bias_at[sensor] = slice(size, size + len(sigmas))
            size += len(sigmas)
            variances += [sigma**2 for sigma in sigmas]
        self._size, self._bias_variances = size, variances
        self._bounds = np.concatenate([[0.0], chdtri(np.arange(1, 65), significance)]).tolist()
        # Written to in every step.
        self._F, self._Q = np.eye(size), np.zeros((size, size))
        self._way = self._F[: model.size, : model.size], self._Q[: model.size, : model.size]
        self._track = self._fresh()
        self._rival: _Track | None = None
        self._moved = dict(moved or {})
        self._shaken: list[_Track] = []
        self._stand = Stand(model.begin)
        self._memory: deque[_Memory] = deque()
        self._passed: deque[_Passed] = deque(maxlen=LOOKED_BACK)
        self.t = -np.inf
        """Latest instant that was measured at [s]."""

    def _fresh(self) -> _Track:
        x, P = self.model.prior()
        kf = _filter(np.concatenate([x, np.zeros(len(self._bias_variances))]), np.zeros((self._size, self._size)))
        kf.P[: len(x), : len(x)] = P
        kf.P[len(x) :, len(x) :] = np.diag(self._bias_variances)
        return _Track(kf)

    def travel(self, s: float) -> None:
        """Moves the state along with the arm, which is at arc length ``s`` [m]."""
        while (step := self.model.travel(s)) is not None:
            F, Q = np.eye(self._size), np.zeros((self._size, self._size))
            F[: self.model.size, : self.model.size], Q[: self.model.size, : self.model.size] = step
            self._passed.append(_Passed(self._stand, self._track.kf.x, self._track.kf.P, F, Q))
            if self.model.drifts:
                self._remember(self.t, (F, Q))
            self._step(F, Q, self.model.begin)

    def _step(self, F: Array, Q: Array, begin: float) -> None:
        for track in (self._track, self._rival, *self._shaken):
            if track is not None:
                track.kf.predict(F=F, Q=Q)
        self._stand = Stand(begin, self._stand.s)

    def _remember(self, t: float, then: Measurement | tuple[Array, Array]) -> None:
        kf = self._track.kf
        self._memory.append(_Memory(t, self._stand, kf.x, kf.P, then))

    def update(self, measurement: Measurement) -> Fused:
        """Fuses one measurement, which may be older than those before.

        Raises ``InputError`` where shapes do not fit each other or the model, or values are not finite.
        """
        check(measurement, self.model.directions)
        return self.take(measurement)

    def take(self, measurement: Measurement) -> Fused:
        """As ``update``, with a measurement that was checked."""
        t = measurement.t
        if not self.model.drifts:
            # Late and unordered measurements are as good as any.
            self.t = max(self.t, t)
            return self._fuse(measurement, measurement.covariance)
        if t < self.t and self.model.told(measurement.s, self._stand):
            t = self.t
        late = [past for past in self._memory if past.t > t] if t < self.t else []
        if late and t < self._memory[0].t and len(late) == len(self._memory):
            nothing = np.zeros(len(measurement.value))
            return Fused(nothing.astype(bool), nothing, 0.0, 0, "too late")
        if late:
            # Back to before the first one that is younger, then all again in the right order.
            for _ in late:
                self._memory.pop()
            self._track.kf.x, self._track.kf.P, self._stand = late[0].x, late[0].P, late[0].stand
            self.t = self._memory[-1].t if self._memory else t
        fused = self._in_time(measurement, t)
        for past, after in zip(late, [*(entry.stand.begin for entry in late[1:]), self.model.begin], strict=False):
            if isinstance(past.then, Measurement):
                self._in_time(past.then, past.t)
            else:
                self._remember(past.t, past.then)
                self._step(*past.then, after)
        return fused

    def deviation(self, s: Array) -> tuple[Array, Array]:
        """The deviation at arc lengths ``s (m,)`` [m], also ahead of what was seen: [L] (6) with how sure it is.

        ``(m, directions)`` [m] and its variance ``(m, directions)`` [m²].
        """
        H, size, kf = self.model.basis(s, self._stand), self.model.size, self._track.kf
        mean, variance = mean_and_variance(np.ascontiguousarray(H.reshape(-1, size)), kf.x[:size],
                                           np.ascontiguousarray(kf.P[:size, :size]))
        ahead = self.model.spread(s, self._stand)
        return mean.reshape(H.shape[:2]), variance.reshape(H.shape[:2]) + (0.0 if ahead is None else ahead)

    def looked_back(self, s: Array) -> tuple[Array, Array]:
        """The deviation as all measurements show it, those of other places as well: smoothed (Rauch, Tung, Striebel).

        At arc lengths ``s (m,)`` [m] of the last ``LOOKED_BACK`` steps, since the map was last replaced:
        ``(m, directions)`` [m] and its variance ``(m, directions)`` [m²]; NaN where nothing is kept.
        """
        kf, passed = self._track.kf, list(self._passed)
        stands = [step.stand for step in passed] + [self._stand]
        xs, Ps, *_ = kf.rts_smoother(
            np.array([step.x for step in passed] + [kf.x]), np.array([step.P for step in passed] + [kf.P]),
            [kf.F] + [step.F for step in passed], [kf.Q] + [step.Q for step in passed],  # of a step at its end
            inv=_inverse)
        mean, variance = np.full((2, len(s), self.model.directions), np.nan)
        which = np.searchsorted([stand.begin for stand in stands], s, side="right") - 1
        for k in np.unique(which[which >= 0]):
            H = self.model.basis(s[which == k], stands[k])
            mean[which == k] = H @ xs[k][: self.model.size]
            P = Ps[k][: self.model.size, : self.model.size]
            variance[which == k] = np.einsum("mdi,ij,mdj->md", H, P, H)
        return mean, variance

    @property
    def s(self) -> float:
        """Arc length at which the state stands [m]."""
        return self._stand.s

    @property
    def state(self) -> Array:
        """State of the deviation model ``(size,)``."""
        return np.asarray(self._track.kf.x[: self.model.size])

    def mean(self, s: Array) -> Array:
        """The deviation alone, ``(m, directions)`` [m]."""
        H = self.model.basis(s, self._stand)
        return np.asarray((H.reshape(-1, self.model.size) @ self.state).reshape(H.shape[:2]))

    def covariance(self, H: Array) -> Array:
        """Covariance ``(m, m)`` of linear functions ``H (m, size)`` of the state."""
        size = self.model.size
        return np.asarray(H @ self._track.kf.P[:size, :size] @ H.T)

    def bias(self, sensor: str) -> tuple[Array, Array]:
        """Estimated errors of a sensor ``(b,)`` and their standard deviations."""
        entries = self._bias_at[sensor]
        return self._track.kf.x[entries].copy(), np.sqrt(np.diag(self._track.kf.P)[entries])

    def _in_time(self, measurement: Measurement, t: float) -> Fused:
        self._remember(t, measurement)
        while self._memory[0].t < t - MEMORY:
            self._memory.popleft()
        way = 0.0 if measurement.at is None else max(measurement.at - self._stand.s, 0.0)
        if way > 0.0 and self.model.carry(way, self._way) is not None:
            self._track.kf.predict(F=self._F, Q=self._Q)
        self.t, self._stand = t, Stand(self._stand.begin, self._stand.s + way)
        ahead, R = self.model.spread(measurement.s, self._stand), measurement.covariance
        if ahead is not None and measurement.direction is not None:
            R = widened(R, measurement.direction, ahead)
        return self._fuse(measurement, R)

    def _fuse(self, measurement: Measurement, R: Array) -> Fused:
        equation = self._equation(measurement, R)
        innovation = equation.innovation(self._track.kf)
        moved = self._weighed(equation, innovation)
        fused = self._try(self._track, equation, innovation)
        if moved:
            return self._replaced(moved, fused, "sensor moved")
        if fused.dof or not self._confirm:
            self._rival = None if fused.dof else self._rival
            return fused
        if self._rival is None:
            self._rival = self._fresh()
        if not self._try(self._rival, equation, equation.innovation(self._rival.kf)).dof:
            self._rival = None
        elif self._rival.agreed >= self._confirm:
            return self._replaced(self._rival, fused, "map replaced")
        return fused

    def _replaced(self, by: _Track, fused: Fused, reason: str) -> Fused:
        """Another hypothesis takes over, for which all values count; what was passed is not its past."""
        self._track, self._rival, self._shaken = by, None, []
        self._passed.clear()
        count = len(fused.innovation)
        return Fused(np.ones(count, dtype=bool), fused.innovation, fused.nis, count, reason, sigma=fused.sigma)

    def _weighed(self, equation: Equation, seen: Innovation) -> _Track | None:
        """The hypothesis of a moved sensor, once measurements have become more likely under it than under the map's.

        One begins with each measurement that the map makes doubtful, and from then on it and the map take all of them.
        A knock that shows little at first is still there when more has come, and one that was thought of for nothing
        before is not in its way.
        """
        sigmas = self._moved.get(equation.sensor)
        if sigmas is None:
            return None
        likelihood = self._likelihood(seen)
        if seen.nis > float(chdtri(len(equation.z), DOUBT)) and len(self._shaken) < AT_ONCE:
            self._shaken.append(self._begun_anew(equation.sensor, sigmas))
        for shaken in self._shaken:
            seen_so = equation.innovation(shaken.kf)
            shaken.lead += self._likelihood(seen_so) - likelihood
            shaken.weighed += 1
            self._try(shaken, equation, seen_so)
        sure = [track for track in self._shaken if track.lead > LEAD and track.agreed >= AGREED]
        self._shaken = [track for track in self._shaken if track.lead >= -LEAD and track.weighed < WEIGHED]
        return max(sure, key=lambda track: track.lead, default=None)

    def _likelihood(self, seen: Innovation) -> float:
        """Logarithm of the likelihood, in which an outlier counts as one."""
        return -0.5 * (min(seen.nis, self._bounds[min(len(seen.value), 64)]) + seen.log_det)

    def _begun_anew(self, sensor: str, sigmas: tuple[float, ...]) -> _Track:
        """The map as it is, with errors of the sensor that have nothing to do with those before."""
        entries, kf = self._bias_at[sensor], _filter(self._track.kf.x.copy(), self._track.kf.P.copy())
        kf.P[entries, :] = kf.P[:, entries] = 0.0
        kf.P[entries, entries] = np.diag(np.square(sigmas))
        return _Track(kf)

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
            kf, ratio = self._track.kf, self._bias_at[measurement.sensor].start
            z, R = extended(H, z, R, kf.x, kf.P, measurement.origin, (self.model.size, ratio))
        return Equation(H, z, R, measurement.sensor, measurement.combination is not None)

    def _try(self, track: _Track, equation: Equation, seen: Innovation) -> Fused:
        """Gates a measurement against a hypothesis and fuses what is left of it."""
        (H, z, R, _, whole), (innovation, S, nis, _) = equation, seen
        likelihood, sigma = self._likelihood(seen), float(np.sqrt(S[0, 0]))
        used: Any
        used, dof = within(innovation, S, self._gate)
        if whole and dof < len(z):
            return Fused(np.zeros_like(used), innovation, float("nan"), 0, "beyond the gate", likelihood, sigma)
        if 2 * dof < len(z):
            # Among many wrong values a few pass by chance.
            return Fused(np.zeros_like(used), innovation, float("nan"), 0, "most values beyond the gate", likelihood,
                         sigma)
        reason = ""
        if dof < len(z):
            reason, accepted = "some values beyond the gate", innovation[used]
            H, z, R = H[used], z[used], R[np.ix_(used, used)]
            nis = float(accepted @ np.linalg.solve(S[np.ix_(used, used)], accepted))
        if nis > self._bounds[min(dof, 64)]:
            return Fused(np.zeros_like(used), innovation, nis, 0, "innovation beyond its bound", likelihood, sigma)
        track.kf.update(z, R=R, H=H)
        track.agreed += 1
        return Fused(used, innovation, nis, dof, reason, likelihood, sigma)


def _filter(x: Array, P: Array) -> KalmanFilter:
    kf = KalmanFilter(dim_x=len(x), dim_z=1)
    kf.x, kf.P = x, P
    return kf
