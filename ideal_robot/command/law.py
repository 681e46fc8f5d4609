"""The command law of a joint controller: which command makes a joint move as desired, for any controller.

    r = F q_c(t - late)                 the controller's input: delay and smoothing of commands
    A(s) (r - q) = Σ c_k x_k(motion)    the law (``ideal_robot.command.terms``), with
    A = 1 + a_1 s + a_2 s² + a_i s H    where the command itself is fed forward or derived, and
    x_k behind the integrator:          s / (s + 1/T), T the reset time
    and c_k m(q_i)                      where gains follow the posture

Along a recording it is fitted (``ideal_robot.command.fit``); evaluated ahead it is the feedforward
(``ideal_robot.feedforward.command_inverse``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.command.filters import bilinear, from_rest
from ideal_robot.command.motion import Motion
from ideal_robot.command.servo import Servo
from ideal_robot.command.smoothing import SMOOTHINGS, Smoothing
from ideal_robot.command.terms import TERMS, Term
from ideal_robot.errors import InputError
from ideal_robot.results import plain

_FINER = 0.75
"""Share of the interpolation cycle below which commands are logged more finely than they are handed over."""
_LONGEST = 2.0
"""Lateness, smoothing, and times of the command's poles, at most [s]: no joint controller is slower."""
_DAMPED = 0.25
"""Least damping of the command's own poles that is accepted: below it the inverse rings."""


@dataclass(frozen=True, order=True)
class Column:
    """A term of the law, with the posture that scales its gain.

    Attributes:
        term: key of ``TERMS``.
        posture: joint whose position its coefficient is multiplied by, from 1; 0 for none.
        power: of that position about the middle of the identified range.
    """

    term: str
    posture: int = 0
    power: int = 0

    @property
    def of(self) -> Term:
        """The entry of ``TERMS`` that this column is made from."""
        return TERMS[self.term]

    @property
    def name(self) -> str:
        """Key of the column in a model file: the term, with the joint angle and power it is multiplied by."""
        return self.term if not self.posture else f"{self.term}*q_{self.posture}^{self.power}"

    @classmethod
    def named(cls, name: str) -> Column:
        """The column of a key; raises ValueError or KeyError for none."""
        term, _, posture = name.partition("*q_")
        joint, _, power = posture.partition("^")
        TERMS[term]
        return cls(term, int(joint), int(power)) if posture else cls(term)


@dataclass(frozen=True)
class Shape:
    """Nonlinear parameters of a law.

    Attributes:
        reset: reset time of the integrator [s]; None where there is none.
        late: by how much commands act later than they are handed over [s].
        smoothing: key of ``SMOOTHINGS``.
        time: of it [s].
        a_1, a_2, a_i: of the command's own poles [s, s², s]: a share ``k_ff`` of the velocity that is fed forward
            makes ``a_1 = k_ff / k_v``, a PID controller's derivative ``a_i = D/K``, inverse dynamics a_1 and a_2.
    """

    reset: float | None = None
    late: float = 0.0
    smoothing: str = "none"
    time: float = 0.0
    a_1: float = 0.0
    a_2: float = 0.0
    a_i: float = 0.0

    @property
    def filter(self) -> Smoothing:
        """The filter of commands."""
        return SMOOTHINGS[self.smoothing]

    @property
    def ahead(self) -> float:
        """Lead time of the commands before the motion [s]."""
        return self.late + self.filter.late * self.time

    @property
    def longest(self) -> float:
        """The longest of its times [s]."""
        return max(self.reset or 0.0, self.late, self.time, self.a_1, float(np.sqrt(self.a_2)), self.a_i)

    @property
    def members(self) -> int:
        """Number of parts: integrator, smoothing and own poles."""
        return sum(bool(value) for value in (self.reset, self.time, self.a_1, self.a_2, self.a_i))

    @property
    def poles(self) -> tuple[Array, Array]:
        """Numerators and denominator from highest power on: from the direct and the integrated sum to ``e``.

        ``e (1 + a_1 s + a_2 s² + a_i s H) = S + H I`` with ``H = sT/(1 + sT)``: ``(2, k)`` and ``(k,)``.
        """
        own, T = np.array([self.a_2, self.a_1, 1.0]), self.reset
        if T is None:
            return np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]), own + np.array([0.0, self.a_i, 0.0])
        whole = np.convolve(own, [T, 1.0])
        whole[1] += self.a_i * T
        return np.array([[0.0, 0.0, T, 1.0], [0.0, 0.0, T, 0.0]]), whole

    @property
    def stable(self) -> bool:
        """Whether the command's own poles are stable and well damped."""
        den = np.trim_zeros(self.poles[1], "f")
        if np.any(den < 0.0):
            return False
        roots = np.roots(den)
        return bool(np.all(-roots.real >= _DAMPED * np.abs(roots))) if len(roots) else True

    def discrete(self, dt: float) -> tuple[Array, Array]:
        """``poles`` as filters of lines from row to row, ``dt`` [s] apart ``(2, k)``, ``(k,)``."""
        return _discrete(self, dt)


# Cached: every term of a law asks for the same filters, for each sampling rate of its recordings.
@lru_cache
def _discrete(shape: Shape, dt: float) -> tuple[Array, Array]:
    num, den = shape.poles
    lead = len(den) - len(np.trim_zeros(den, "f"))
    num, den = num[:, lead:], den[lead:]
    if len(den) == 1:
        return num / den[0], np.ones(1)
    return bilinear(num, den, dt)


_SHAPE = tuple(f.name for f in fields(Shape))


@dataclass(frozen=True)
class Rival:
    """A law of another controller kind that the recording does not exclude.

    Attributes:
        shape, columns, coefficients: see ``JointLaw``.
        probability: probability that it is the joint's law.
    """

    shape: Shape
    columns: tuple[Column, ...]
    coefficients: Array
    probability: float


@dataclass(frozen=True)
class JointLaw:
    """The law of one joint.

    Attributes:
        shape: delay, smoothing and reset time.
        columns: terms of the law.
        coefficients: of the columns ``(m,)``.
        covariance: of the coefficients ``(m, m)``.
        error: variances of the position error with the law's commands on held-out motion ``(6,)`` by the parts of
            ``error_parts``.
        deviation: root mean square of ``q_c - q`` about its mean on the held-out motion [rad].
        residual: root mean square residual of the law there [rad].
        kind: of controller, in the field's words.
        servo: the joint as PD control, where it is one; None elsewhere, and where no torque was measured.
        noise: standard deviation of a measured position, encoder steps included [rad].
        rivals: laws of other kinds that may be the joint's as well.
    """

    shape: Shape
    columns: tuple[Column, ...]
    coefficients: Array
    covariance: Array = field(repr=False)
    error: Array
    deviation: float = float("nan")
    residual: float = float("nan")
    kind: str = ""
    servo: Servo | None = None
    noise: float = 0.0
    rivals: tuple[Rival, ...] = ()

    def coefficient(self, name: str) -> float:
        """Coefficient of a column by its name; 0 where the law has none."""
        return next((float(c) for column, c in zip(self.columns, self.coefficients, strict=True)
                     if column.name == name), 0.0)


@dataclass(frozen=True)
class CommandLaw:
    """The laws of all joints.

    Attributes:
        joints: law of each joint ``(n,)``.
        t_cycle: from command to command [s].
        still: speed below which a joint is treated as reversing ``(n,)`` [rad/s].
        middle, width: of the range in which each joint was moved ``(n,)`` [rad], which postures are measured by.
        torque: source of the torque in the law's terms: ``model`` for the identified model's, ``none``.
        cascade: residual of [G]'s identified loop on the same recordings ``(n,)`` [rad]; None where there is none.
        cascade_error: its variances by the parts of ``error_parts`` ``(n, 6)``; None where there is none.
        doubt: probability that the law is the joint's, and not that loop ``(n,)``; None where there is none.
        leads: whether the law predicts them better than that loop.
    """

    joints: tuple[JointLaw, ...]
    t_cycle: float
    still: Array
    middle: Array
    width: Array
    torque: str = "none"
    cascade: Array | None = None
    cascade_error: Array | None = None
    leads: bool = True
    doubt: Array | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def ahead(self) -> float:
        """Longest lead time of the commands before the motion [s]."""
        return max(law.shape.ahead for law in self.joints)

    def reached_after(self, t_ipo: float) -> float:
        """Time after which a sent command appears in a log like the one of this law's fit [s].

        Logs of commands as sent have them at once. Finer logs have interpolated set points, which reach each command at
        the end of its cycle.

        Args:
            t_ipo: from command to command, as they are handed over [s].
        """
        return t_ipo if logged_finely(self.t_cycle, t_ipo) else 0.0

    @property
    def deviation(self) -> Array:
        """Deviation of commands from positions of all joints ``(n,)`` [rad], see ``JointLaw``."""
        return np.array([law.deviation for law in self.joints])

    @property
    def residual(self) -> Array:
        """Residuals of the laws of all joints ``(n,)`` [rad], see ``JointLaw``."""
        return np.array([law.residual for law in self.joints])

    def posture(self, q: Array, column: Column) -> Array:
        """Factor of a column's coefficient by the posture at positions ``q (N, n)``: ``(N,)``."""
        i = column.posture - 1
        return np.asarray(((q[:, i] - self.middle[i]) / self.width[i]) ** column.power)

    def sums(self, motion: Motion, j: int, factors: Array | None = None) -> Array:
        """Direct and integrated sum of the terms of joint ``j`` (from 0) along a motion ``(2, N)``.

        Args:
            motion, j: along which, and of which joint.
            factors: on its coefficients ``(m,)``; 1 if None.
        """
        law, sums = self.joints[j], np.zeros((2, len(motion.q)))
        coefficients = law.coefficients if factors is None else factors * law.coefficients
        for column, c in zip(law.columns, coefficients, strict=True):
            if c == 0.0:
                continue
            sums[int(column.of.integrated)] += c * self.values(motion, column, j)
        return sums

    def values(self, motion: Motion, column: Column, j: int) -> Array:
        """Values of a column along a motion, by which its coefficient is multiplied ``(N,)``.

        Args:
            motion, column, j: along which, of which joint's law, and the joint, from 0.
        """
        values = column.of.of(motion)[:, j]
        return self.posture(motion.q, column) * values if column.posture else values

    def error(self, motion: Motion, j: int) -> Array:
        """Required difference of command and position for joint ``j`` (from 0) along a motion from rest ``(N,)``."""
        law, dt = self.joints[j], motion.dt
        num, den = law.shape.discrete(dt)
        sums = self.sums(motion, j)
        return np.sum([from_rest(b, den, x) for b, x in zip(num, sums, strict=True)], axis=0)

    def early(self, motion: Motion, j: int, error: Array, t: Array, ahead: float, first: int = 0) -> Array:
        """The command of joint ``j`` (from 0) at instants ``t (M,)`` [s] of a motion.

        Args:
            motion, j: the motion, used from row ``first`` on, and the joint.
            error: required difference of command and position ``(N,)``.
            t, ahead: instants, and how much earlier commands are given [s].
            first: row.
        """
        shape = self.joints[j].shape
        r = (motion.q[:, j] + error)[first:, None]
        early = shape.filter.before(r, motion.dt, shape.time)[:, 0]
        row = np.clip((t + ahead) / motion.dt - first, 0.0, len(early) - 1.0)
        if len(row) == 1:
            return np.asarray(_weights(len(early), float(row[0])) @ early)[None]
        return np.asarray(CubicSpline(np.arange(float(len(early))), early)(row))

    def commands(self, motion: Motion, rows: int, ahead: Array) -> Array:
        """Commands ``(rows, n)`` [rad] of the first rows of a motion.

        Args:
            motion, rows: longer than the rows by as much as commands are early.
            ahead: how much earlier each joint's commands are given ``(n,)`` [s].
        """
        t = motion.dt * np.arange(float(rows))
        return np.stack([self.early(motion, j, self.error(motion, j), t, ahead[j]) for j in range(self.n)], axis=1)

    def held_out(self, motion: Motion) -> Array:
        """Expected residual of the laws on held-out motion, as a standard deviation ``(N, n)`` [rad].

        Args:
            motion: along which.
        """
        return np.sqrt(_by_parts(motion, np.stack([law.error for law in self.joints])))

    def variance(self, motion: Motion) -> Array:
        """Variance of the measured position's error with the commands for a motion ``(N, n)`` [rad²].

        It contains the laws' error on held-out motion, and the noise of measured positions.

        Args:
            motion: along which.
        """
        return self.held_out(motion) ** 2 + np.array([law.noise**2 for law in self.joints])

    def apart(self, motion: Motion, j: int) -> list[tuple[float, Array]]:
        """Probability of each rival of a joint, and the difference of its commands from the law's ``(N,)`` [rad].

        Args:
            motion, j: along which, and the joint, from 0.
        """
        t, own = motion.dt * np.arange(float(len(motion.q))), self.joints[j]

        def command(law: CommandLaw, shape: Shape) -> Array:
            return law.early(motion, j, law.error(motion, j), t, shape.ahead)

        usual, result = command(self, own.shape), []
        for rival in own.rivals:
            other = replace(own, shape=rival.shape, columns=rival.columns, coefficients=rival.coefficients)
            instead = replace(self, joints=(*self.joints[:j], other, *self.joints[j + 1 :]))
            result.append((rival.probability, command(instead, rival.shape) - usual))
        return result

    def cascade_variance(self, motion: Motion) -> Array:
        """Variance of the position error with commands by [G]'s identified loop ``(N, n)`` [rad²].

        Args:
            motion: along which.
        """
        if self.cascade_error is None:
            return np.zeros_like(motion.q)
        return _by_parts(motion, self.cascade_error)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in the model file."""
        return plain({
            "t_cycle": self.t_cycle, "still": self.still, "middle": self.middle, "width": self.width,
            "torque": self.torque, "cascade": self.cascade, "cascade_error": self.cascade_error, "leads": self.leads,
            "doubt": self.doubt,
            "joints": [{"kind": law.kind, **_terms(law), "covariance": law.covariance, "error": law.error,
                        "noise": law.noise, "deviation": law.deviation, "residual": law.residual,
                        "servo": None if law.servo is None else asdict(law.servo),
                        "rivals": [{**_terms(rival), "probability": rival.probability} for rival in law.rivals]}
                       for law in self.joints]}, digits=12)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CommandLaw:
        """Reads what ``to_dict`` wrote; raises KeyError, TypeError or ValueError for anything else."""
        def array(entry: Any) -> Array:
            return np.array(entry, dtype=float)

        joints = []
        for own in values["joints"]:
            deviation, residual = (float("nan") if own[key] is None else float(own[key])
                                   for key in ("deviation", "residual"))
            error = array(own["error"])
            if error.shape == (4,):  # before jerk and slowness were among the parts
                error = np.insert(error, 3, [0.0, 0.0])
            rivals = tuple(Rival(*_read_terms(rival), float(rival["probability"])) for rival in own.get("rivals", ()))
            joints.append(JointLaw(*_read_terms(own), array(own["covariance"]), error, deviation, residual,
                                   str(own["kind"]), Servo.from_dict(own.get("servo")), float(own.get("noise", 0.0)),
                                   rivals))
        cascade, missed, doubt = (None if values.get(key) is None else array(values[key])
                                  for key in ("cascade", "cascade_error", "doubt"))
        return cls(tuple(joints), float(values["t_cycle"]), array(values["still"]), array(values["middle"]),
                   array(values["width"]), str(values["torque"]), cascade, missed, bool(values["leads"]), doubt)


def logged_finely(t_cycle: float, t_ipo: float) -> bool:
    """Whether a log has interpolated set points, at a finer sampling than the commands.

    Args:
        t_cycle, t_ipo: from command to command in the log, and as they are handed over [s].
    """
    return t_cycle < _FINER * t_ipo


def _terms(law: JointLaw | Rival) -> dict[str, Any]:
    return {**{key: getattr(law.shape, key) for key in _SHAPE}, "columns": [column.name for column in law.columns],
            "coefficients": law.coefficients}


def _read_terms(values: Mapping[str, Any]) -> tuple[Shape, tuple[Column, ...], Array]:
    times: dict[str, Any] = {key: values[key] if values[key] is None or key == "smoothing" else float(values[key])
                             for key in _SHAPE}
    shape = Shape(**times)
    SMOOTHINGS[shape.smoothing]
    return (shape, tuple(Column.named(name) for name in values["columns"]),
            np.array(values["coefficients"], dtype=float))


def _weights(count: int, row: float) -> Array:
    """Weights ``(count,)`` of rows in the cubic spline through them at a broken row."""
    i = min(int(row), count - 2)
    a, b, c, d = _cubics(count)[:, i]
    x = row - i
    return np.asarray(((a * x + b) * x + c) * x + d)


@lru_cache(maxsize=32)
def _cubics(count: int) -> Array:
    """Of the cubic spline through as many rows: coefficients of each stretch for each row ``(4, count - 1, count)``."""
    return np.asarray(CubicSpline(np.arange(float(count)), np.eye(count)).c)


def require_law(law: CommandLaw, n: int, file: Any = None) -> None:
    """Raises InputError for impossible numbers of a law; names the key and the expected range.

    Args:
        law, n: as read, and how many joints there are.
        file: the file that it comes from.
    """
    def refuse(key: str, expected: str, value: Any = None) -> None:
        raise InputError(f"expected {expected}", file=file, field=f"command.{key}", value=value)

    if law.n != n:
        refuse("joints", f"{n} entries", law.n)
    if not 1e-5 <= law.t_cycle <= 1.0:
        refuse("t_cycle", "seconds from 1e-05 to 1", law.t_cycle)
    for key in ("still", "middle", "width"):
        array = getattr(law, key)
        if array.shape != (n,) or not np.all(np.isfinite(array)) or (key != "middle" and np.any(array <= 0.0)):
            refuse(key, f"{n} finite numbers" + ("" if key == "middle" else " above 0"))
    if law.doubt is not None and (law.doubt.shape != (n,) or not np.all((law.doubt >= 0.0) & (law.doubt <= 1.0))):
        refuse("doubt", f"{n} probabilities from 0 to 1")
    if law.torque not in ("model", "none"):
        refuse("torque", "model or none", law.torque)
    for j, own in enumerate(law.joints):
        m = len(own.columns)
        for key, shape in (("coefficients", (m,)), ("covariance", (m, m)), ("error", (PARTS,))):
            array = getattr(own, key)
            if array.shape != shape or not np.all(np.isfinite(array)):
                refuse(f"joints.{j}.{key}", f"{' × '.join(map(str, shape))} finite numbers")
        if np.any(own.error < 0.0):
            refuse(f"joints.{j}.error", "variances that are not negative")
        for key in ("late", "time", "a_1", "a_2", "a_i"):
            if not 0.0 <= getattr(own.shape, key) <= _LONGEST:
                refuse(f"joints.{j}.{key}", f"a number from 0 to {_LONGEST:g}", getattr(own.shape, key))
        if own.shape.reset is not None and not 1e-4 <= own.shape.reset <= 100.0:
            refuse(f"joints.{j}.reset", "seconds from 0.0001 to 100, or nothing", own.shape.reset)
        if any(column.posture > n for column in own.columns):
            refuse(f"joints.{j}.columns", f"postures of joints 1 to {n}")
        if not own.shape.stable:
            refuse(f"joints.{j}.coefficients", "a command whose own poles decay")
        for rival in own.rivals:
            if len(rival.coefficients) != len(rival.columns) or not np.all(np.isfinite(rival.coefficients)):
                refuse(f"joints.{j}.rivals", "a finite coefficient for each column")
            if any(column.posture > n for column in rival.columns) or not rival.shape.stable:
                refuse(f"joints.{j}.rivals", f"postures of joints 1 to {n}, and poles that decay")
            if not 0.0 <= rival.probability <= 1.0:
                refuse(f"joints.{j}.rivals", "probabilities from 0 to 1", rival.probability)


PARTS = 6
"""Of a law's error, see ``error_parts``."""


def _by_parts(motion: Motion, variances: Array) -> Array:
    """Variance ``(N, n)`` of an error along a motion, from those ``(n, PARTS)`` of its parts."""
    return np.einsum("kpn,np->kn", error_parts(motion), variances)


def error_parts(motion: Motion) -> Array:
    """Regressors of the error variance of a law along a motion ``(N, PARTS, n)``.

    They are 1, the squares of speed, acceleration and jerk, and two for reversals: slow motion, where friction differs,
    and the rate of the change of direction, relative to a reversal of 0.1 s.
    """
    turning = 0.1 * np.gradient(motion.direction, motion.dt, axis=0)
    return np.stack([np.ones_like(motion.q), motion.qd**2, motion.qdd**2, motion.qddd**2, 1.0 - motion.direction**2,
                     turning**2], axis=1)
