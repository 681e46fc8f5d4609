"""Compares a recording with the URDF: signs, units and order of the torques, and the direction of gravity.

Before anything is identified the measured torques are explained by the rigid body of the URDF and by friction that
brakes, and the explanations of the recording are compared by one number, the evidence

    ln p(τ | H) = -½ r'(I + X P X')⁻¹ r - ½ ln|I + X P X'| ,   r = τ - X μ,

of rows in units of the channel's coloured noise. P is wide: masses are known within a factor, friction and rotor
inertia only in their sign. So a URDF with guessed masses accuses nobody, while what the joints share, a body that two
of them carry, tells an exchanged, turned or rescaled torque from a true one.

The size of the noise is the one with which the hypothesis explains the channel best, but not smaller than the part of
a torque that no rigid-body model explains on any arm. The residual of a fit with free parameters is not used: a motion
of three seconds has fewer rows than there are parameters, some of which fit every row.

A hypothesis H says of each joint which column is its torque, with which sign and in which unit (N m per unit), and in
which direction gravity acts in the base's frame, or that the controller has taken it out. The search begins with the
recording as it claims to be and takes the change that raises evidence and prior most, until none does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from scipy import linalg, special

from ideal_robot.arrays import Array
from ideal_robot.dynamics import regressor
from ideal_robot.dynamics.regressor import link_parameters
from ideal_robot.dynamics.tool_force import felt_at_tool, torques_of_tool_force
from ideal_robot.estimate.noise import ORDER, ColouredNoise
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import dead_share, lattice
from ideal_robot.signals.preprocess import FilteredSignals, evenly_sampled
from ideal_robot.signals.recording import Recording
from ideal_robot.tolerances import PRODUCTS

WRONG_SIGN, WRONG_SCALE, EXCHANGED, NO_GRAVITY, TURNED = ("wrong-sign", "wrong-scale", "exchanged", "no-gravity",
                                                         "gravity-turned")
G = 9.81
"""Gravity [m/s²]."""
_MASSES = 0.35
"""Standard deviation of a link's mass over the URDF's, beside a factor that all links share."""
_CENTRES, _GYRATION = 0.3, 0.5
"""Spread of a link's centre of mass, and its radius of gyration, over its length."""
_LEAST_MASS, _LEAST_LENGTH = 0.02, 0.05
"""Of a link over the arm's, so that a link without a mass or a length has a spread."""
_GAIN = 0.15
"""Spread of ln(N m per unit) of a torque that is in N m: drive gains of data sheets are right to 10 to 15 %."""
_COMMON = 0.8
"""Spread of ln of a factor that all joints share: masses of a URDF that were guessed for the arm as a whole."""
_UNITS = np.log(1e6)
"""Range of ln of the units that a torque may be in: from a motor's to a thousandth of a rated torque."""
_WEIGHED = 0.1
"""The same of a URDF whose masses are believed, by which the factor of a torque in another unit is said."""
_APART = 0.5 * np.log(10.0)
"""Of units that are tried, in ln; what is found is improved to half of that to either side."""
_FACTORS = tuple(np.exp(_APART * np.arange(-6, 7)).tolist())
"""Units that are tried."""
_CHANGE = np.log(100.0)
"""Nats that a change of the recording costs before it is seen: one recording in a hundred has it."""
_LEVEL = np.radians(5.0)
"""Tilt of the base within which an arm stands as its URDF says."""
_ACCEPTED = 10.0
"""Nats over the recording as it claims to be from which a change is said: odds of 20,000 to 1."""
_OFF = np.log(2.0)
"""A joint's factor over the median joint's from which on it is off: less is what masses of a URDF are off by."""
_SHARE_OFF = np.log(3.0)
"""The same of one joint, where all torques come in the round steps of a share of a rated torque."""
_MOST = 2.0 / 3.0
"""Share of the joints that are off, at least, where the recording has another unit: one alone is a drive gain."""
_SEEN, _FELL = np.log(1.5), 2.0
"""A joint's factor is determined by the URDF's masses where the evidence falls by so many nats within this range to
either side."""
_COMMON_OFF = np.log(4.0)
"""A factor that all joints share is said from here on: masses guessed for a measured arm are 3.2 times off."""
_CUTOFF, _BAND = 10.0, 5.0
"""Of the position filter and of the rows [Hz]: an arm's motion; a share of the sampling rate where that is low."""
_FORCE_ZERO = 2.0
"""What the zero of a force sensor is off by along each of its axes [N]."""
_ROWS = 1500
"""Rows that are compared at most; they are spread over the recording."""
_MISFIT = 0.02
"""Of a torque's deviation: what a rigid body with this friction cannot say of any arm, beside the noise."""
_STEPS = 4
"""Of the noise's sizes: four give the evidence within 3 nats of where 16 end, where it is near the best at all."""
_TURNS = (0.03, 0.1, 0.3)
"""Dry friction turns over within such shares of a joint's top speed: at once on a quick motion, late on a slow one."""
_DRY = 0.08
"""Dry friction over the torque that is allowed, at most: gears of arms have 3 to 8 %, and as much again at speed."""
_BEYOND = np.log(1.5)
"""Spread of ln of the largest torque beyond what is allowed: drives give more than a data sheet's for a moment."""
_OWN = 3 + len(_TURNS)
"""Columns that a joint has for itself: acceleration, dry friction, viscous friction, a constant."""
_SLIPS = 30.0
"""Degrees between the directions of gravity that are tried first."""


@dataclass(frozen=True)
class Finding:
    """One property of a recording that differs from its description.

    Attributes:
        kind: ``wrong-sign``, ``wrong-scale``, ``exchanged``, ``no-gravity`` or ``gravity-turned``.
        joints: from 1.
        text: the finding and its remedy in one line.
        nats: gain in log evidence over the recording's own description.
    """

    kind: str
    joints: tuple[int, ...]
    text: str
    nats: float

    @property
    def warning(self) -> str:
        """The finding as a named warning."""
        return f"{self.kind}: {self.text}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"kind": self.kind, "joints": list(self.joints), "text": self.text, "nats": self.nats}


@dataclass(frozen=True)
class Reading:
    """A hypothesis about signs, units and order of a recording's torques.

    Attributes:
        column: of each joint the column that is its torque ``(n,)``, from 0.
        sign: of each joint ``(n,)``.
        unit: units of the column per N m ``(n,)``.
        gravity: in the base's frame ``(3,)`` [m/s²]; zero where the controller has taken it out.
    """

    column: tuple[int, ...]
    sign: tuple[int, ...]
    unit: tuple[float, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, -G)

    @classmethod
    def claimed(cls, n: int) -> Reading:
        """The hypothesis that a recording agrees with the format in docs/files.md."""
        return cls(tuple(range(n)), (1,) * n, (1.0,) * n)


def findings(recording: Recording, robot: Robot, *, amperes: bool = False) -> tuple[Finding, ...]:
    """Properties of a recording that differ from its description; empty where it agrees.

    Args:
        recording: cleaned, with ``tau_i``.
        robot: the URDF that it is compared with.
        amperes: whether ``tau_i`` are in a unit of each joint's own: then nothing is compared.
    """
    # Currents of unknown gain and sign cannot be compared with the URDF's masses.
    rows = None if amperes else _Rows.of(recording, robot)
    return () if rows is None else _said(*_searched(rows), rows, robot)


def contradicting(recordings: Sequence[Recording], robot: Robot, *, amperes: bool = False
                  ) -> tuple[tuple[Finding, ...], list[str]]:
    """The findings of each recording, and a warning for each finding with its recording.

    Args:
        recordings, robot, amperes: see ``findings``.
    """
    found = [(finding, recording.source) for recording in recordings
             for finding in findings(recording, robot, amperes=amperes)]
    return tuple(finding for finding, _ in found), [f"{finding.warning} [{source}]" for finding, source in found]


@dataclass(frozen=True)
class _Rows:
    """Products of the whitened columns of each joint's torque, for each column that might hold it.

    Attributes:
        products: ``[β of inertia, β of gravity along x, y, z, own, means, τ]`` with themselves ``(n, n, C, C)``: of
            joint i's equation and column j; directions β of the links' parameters in units of their spread.
        n, links: joints, and directions of the links' parameters that the rows show.
        live: which columns of torque hold anything ``(n,)``.
        count: rows.
        least: size of each column's noise at least ``(n,)``, over the one that its products are whitened with.
        rubs: spread of each joint's friction [N m or N] over that of each column's torque ``(n, n)``.
        peaks: ln of each column's largest torque over what each joint is allowed ``(n, n)``.
        shares: whether all torques come in the same round steps, as shares of a rated torque do.
        sure: the links' spread over the usual one.
    """

    products: Array
    n: int
    links: int
    live: np.ndarray
    count: int
    least: Array
    rubs: Array
    peaks: Array
    shares: bool = False
    sure: float = 1.0
    cache: dict[tuple[Any, ...], Array] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, recording: Recording, robot: Robot) -> _Rows | None:
        """The products of a recording; None where no torque holds anything."""
        s, n = _filtered(recording), robot.n
        stride = max(1, -(-int(s.keep.sum()) // _ROWS))
        y = s.decimate(s.tau)[::stride]
        scale = np.std(y, axis=0)
        live = scale > 1e-9 * max(float(scale.max(initial=0.0)), 1e-12)
        live &= np.mean(recording.joints("tau") == 0.0, axis=0) <= dead_share()
        if not live.any() or len(y) < 20:
            return None
        mean, root = link_prior(robot)
        bodies = [_bodies(s, robot, gravity)[::stride] for gravity in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]
        bodies = [bodies[0], *(one - bodies[0] for one in bodies[1:])]
        root = root @ _shown([one / np.where(live, scale, scale.max())[:, None] for one in bodies], root)
        top = np.maximum(np.quantile(np.abs(s.qd), 0.99, axis=0), 1e-9)
        shapes = (s.qdd, *(np.tanh(s.qd / (turns * top)) for turns in _TURNS), s.qd)
        own = [_in_units(s.decimate(column)[::stride]) for column in shapes]
        dry = own[1]
        # Viscous friction, or another shape of reversals, may change dry friction of the same size in either direction.
        for column in own[2:]:
            column -= dry * np.sum(column * dry, axis=0) / np.maximum(np.sum(dry * dry, axis=0), 1e-12)
        pushed = _pushed(recording, robot, s, stride)
        # In a joint that hardly moves dry friction acts as a constant torque.
        size = np.hypot(scale, _DRY * robot.tau_max)
        # The acceleration's own column and friction have half of the torque's standard deviation as a prior; only their
        # sign is known.
        X = [np.column_stack([*(np.hstack([one[:, i] @ root, pushed[:, i] * (k == 0)]) for k, one in enumerate(bodies)),
                              *(scale[i] * column[:, i] for column in own),
                              np.full(len(y), size[i]), *(one[:, i] @ mean for one in bodies)]) for i in range(n)]
        P, least = root.shape[1] + pushed.shape[2], np.maximum(_MISFIT * scale, 1e-300)
        rubs = 2.0 * _DRY * robot.tau_max[:, None] / np.maximum(scale, 1e-300)
        largest = np.quantile(np.abs(recording.joints("tau")), 0.99, axis=0)
        peaks = np.log(np.maximum(largest, 1e-300) / robot.tau_max[:, None])
        shares = _in_round_steps(recording.joints("tau")[:, live])
        white = [ColouredNoise.of_autocovariance(np.r_[one**2, np.zeros(ORDER)]) for one in least]
        own_torque = np.eye(n, dtype=bool) & live
        first = cls(products=_products(X, y, white, P, own_torque), n=n, links=P, live=live, count=len(y),
                    least=np.ones(n), rubs=rubs, peaks=peaks, shares=shares)
        left = first.left(X, y)
        # The colour of the noise is that of the residual under the recording's own description; its size is fitted for
        # each hypothesis.
        noise = [ColouredNoise.fit(left[:, j], np.ones(len(y), dtype=bool)) for j in range(n)]
        return replace(first, products=_products(X, y, noise, P, np.ones((n, n), dtype=bool) & live),
                       least=least / np.array([one.std for one in noise]), cache={})

    def under(self, i: int, j: int, gravity: tuple[float, float, float]) -> Array:
        """Products of joint i's equation and column j under a gravity: ``[β, own, mean, τ]``, P + _OWN + 2 each way."""
        key = (i, j, gravity)
        if key not in self.cache:
            P, weight, products = self.links, np.array([1.0, *gravity]), self.products[i, j]
            means = 4 * P + _OWN
            # Columns of inertia, and of gravity along each axis, are added.
            half = np.empty((P + _OWN + 2, products.shape[1]))
            half[:P] = np.tensordot(weight, products[: 4 * P].reshape(4, P, -1), 1)
            half[P : P + _OWN] = products[4 * P : means]
            half[-2] = weight @ products[means : means + 4]
            half[-1] = products[-1]
            whole = np.empty((P + _OWN + 2, P + _OWN + 2))
            whole[:, :P] = np.tensordot(half[:, : 4 * P].reshape(-1, 4, P), weight, (1, 0))
            whole[:, P : P + _OWN] = half[:, 4 * P : means]
            whole[:, -2] = half[:, means : means + 4] @ weight
            whole[:, -1] = half[:, -1]
            self.cache[key] = whole
        return self.cache[key]

    def evidence(self, reading: Reading, steps: int = _STEPS) -> float:
        """The evidence ln p(τ | H) with the noise that explains most, up to what is the same for all hypotheses.

        With one step the noise is that of the recording as it claims to be: a lower bound, in a third of the time.
        """
        fitted = self._fitted(reading, steps)
        # Friction brakes and inertia is positive: the score uses the share of the posterior with these signs, the
        # prior's being one half.
        sure = (fitted.own / fitted.deviation)[:, :2]
        return fitted.value + float(np.sum(special.log_ndtr(sure) + np.log(2.0)))

    def left(self, X: list[Array], y: Array) -> Array:
        """What the recording leaves of its torques ``(N, n)``, in their unit, as it claims to be."""
        P, claimed = self.links, Reading.claimed(self.n)
        weight, fitted = np.array([1.0, *claimed.gravity]), self._fitted(claimed)
        left = y.copy()
        for i, columns in enumerate(X):
            bodies = np.tensordot(columns[:, : 4 * P].reshape(len(y), 4, P), weight, (1, 0))
            left[:, i] -= (columns[:, 4 * P + _OWN :] @ weight + bodies @ fitted.links
                           + columns[:, 4 * P : 4 * P + _OWN] @ fitted.own[i])
        return left

    def _fitted(self, reading: Reading, steps: int = _STEPS) -> _Fitted:
        """The evidence of normal priors and the posterior of the parameters, with the sizes of the noise.

        Expectation and maximisation: a size is what the parameters leave on average over their posterior. A joint's
        own parameters meet the others' through the links' alone: they are eliminated joint by joint (Schur).
        """
        n, P = self.n, self.links
        blocks, unit = self._blocks(reading.column, reading.gravity), np.array(reading.unit)[:, None]
        if self.sure != 1.0:
            blocks = blocks.copy()
            blocks[:, :P] *= self.sure
            blocks[:, :, :P] *= self.sure
        column = list(reading.column)
        least = np.where(self.live[column], self.least[column], 1.0)
        # Friction is bounded by a gear's typical size in that unit; acceleration and constant are not.
        own_size = np.ones((n, _OWN))
        own_size[:, 1:-1] = np.minimum(1.0, unit * self.rubs[np.arange(n), column][:, None])
        # The residual about the URDF's own torque, ± τ - unit · X μ, and the columns of the parameters in it.
        torque = np.column_stack([-unit, np.array(reading.sign, dtype=float)])
        aim = np.einsum("ijk,ik->ij", blocks[:, :, -2:], torque)
        squares = np.einsum("ik,ik->i", aim[:, -2:], torque)
        of_links, aim_links = blocks[:, :P, :P].reshape(n, P * P), unit * aim[:, :P]
        to_links = (unit * own_size)[:, :, None] * blocks[:, P:-2, :P]
        of_own, aim_own = own_size[:, :, None] * blocks[:, P:-2, P:-2] * own_size[:, None, :], own_size * aim[:, P:-2]
        size, ones = np.maximum(1.0, least), np.eye(_OWN)
        for step in range(steps):
            weight = 1.0 / size**2
            # Scaled to a unit diagonal, as units a thousand times off exceed double precision.
            H = weight[:, None, None] * of_own + ones
            scale = 1.0 / np.sqrt(np.einsum("ikk->ik", H))
            lower = np.linalg.cholesky(scale[:, :, None] * H * scale[:, None, :] + PRODUCTS * ones)
            inverse = np.linalg.inv(lower) * scale[:, None, :]
            pulled = (inverse @ (weight[:, None, None] * to_links)).reshape(-1, P)
            z_own = np.einsum("ikl,il->ik", inverse, weight[:, None] * aim_own)
            H = ((weight * unit[:, 0] ** 2) @ of_links).reshape(P, P)
            np.einsum("pp->p", H)[:] = (np.einsum("pp->p", H) + 1.0) * (1.0 + PRODUCTS)
            root = np.linalg.cholesky(H - pulled.T @ pulled)
            back, _ = linalg.lapack.dtrtri(root, lower=1)
            z = back @ (weight @ aim_links - z_own.ravel() @ pulled)
            links = z @ back
            own = np.einsum("ilk,il->ik", inverse, z_own - (pulled @ links).reshape(n, _OWN))
            # Blocks of the posterior covariance: of the links, between links and a joint's own parameters, of those.
            seen = (pulled @ back.T).reshape(n, _OWN, P)
            of_joint = inverse.transpose(0, 2, 1) @ (seen @ seen.transpose(0, 2, 1) + ones) @ inverse
            if step == steps - 1:
                break
            covariance = back.T @ back
            between = -inverse.transpose(0, 2, 1) @ (seen @ back)
            about = np.concatenate([-unit * links, -own_size * own, torque], axis=1)
            left = (np.einsum("ij,ij->i", about, (blocks @ about[:, :, None])[:, :, 0])
                    + unit[:, 0] ** 2 * (of_links @ covariance.ravel())
                    + np.einsum("ikp,ikp->i", 2.0 * to_links, between) + np.einsum("ikl,ikl->i", of_own, of_joint))
            size = np.maximum(np.sqrt(np.maximum(left, 0.0) / self.count), least)
        value = -0.5 * float(squares @ weight - z @ z - np.sum(z_own**2))
        value -= float(np.log(np.diag(root)).sum() + np.log(np.einsum("ikk->ik", lower) / scale).sum())
        deviation = np.sqrt(np.einsum("ikk->ik", of_joint))
        return _Fitted(value - self.count * float(np.log(size).sum()), links, own, deviation)

    def _blocks(self, column: tuple[int, ...], gravity: tuple[float, float, float]) -> Array:
        """Products of all joints' equations ``(n, P + _OWN + 2, P + _OWN + 2)``; zero of a torque that is dead."""
        key = (column, gravity)
        if key not in self.cache:
            self.cache[key] = np.stack([self.under(i, j, gravity) * self.live[j] for i, j in enumerate(column)])
        return self.cache[key]


@dataclass(frozen=True)
class _Fitted:
    """What a hypothesis makes of the recording.

    Attributes:
        value: the evidence of normal priors [nats].
        links: mean of the links' parameters ``(P,)``, in units of their spread.
        own, deviation: mean and standard deviation of each joint's own ``(n, _OWN)``.
    """

    value: float
    links: Array
    own: Array
    deviation: Array


def _products(X: list[Array], y: Array, noise: list[ColouredNoise], links: int, pairs: np.ndarray) -> Array:
    """Products of the whitened columns of joint i's equation and column j ``(n, n, C, C)``, of the pairs ``(n, n)``."""
    n, C, use = len(X), X[0].shape[1] + 1, np.ones(len(y), dtype=bool)
    scale, products = np.std(y, axis=0), np.zeros((n, n, C, C))
    for i, j in np.argwhere(pairs):
        # A joint's own columns have the standard deviation of the column that is assumed to be its torque.
        own_scale = np.ones(C - 1)
        own_scale[4 * links : 4 * links + _OWN] = scale[j] / scale[i] if scale[i] > 0.0 else 1.0
        white = noise[j].whiten(np.column_stack([X[i] * own_scale, y[:, j]]), use)
        products[i, j] = white.T @ white
    return products


def _in_round_steps(tau: Array) -> bool:
    """Whether all torques ``(N, m)`` come in the same steps of a power of ten, as 1 ‰ of a rated torque."""
    steps = np.array([lattice(values) for values in tau.T])
    if np.any(steps <= 0.0) or tau.shape[1] < 2:
        return False
    power = np.log10(steps)
    return bool(np.all(np.abs(power - np.round(power)) < 1e-3) and np.ptp(power) < 1e-3)


def _filtered(recording: Recording) -> FilteredSignals:
    even = evenly_sampled(recording, columns=False)
    rate = 1.0 / float(even.t[1] - even.t[0])
    length = float(even.t[-1] - even.t[0])
    return even.filtered(max(min(_CUTOFF, 0.2 * rate), 4.0 / length), max(min(_BAND, 0.1 * rate), 2.0 / length))


def _pushed(recording: Recording, robot: Robot, s: FilteredSignals, stride: int) -> Array:
    """Torques of what pushes the tool, in units of their spread ``(M, n, k)``; none without a force sensor.

    The force that the sensor shows, whichever way it counts, and what its zero is off by along each axis.
    """
    force = felt_at_tool(recording, s.t)
    if force is None:
        return np.empty((len(s.decimate(s.tau)[::stride]), robot.n, 0))
    by_axis = torques_of_tool_force(robot, s.q)
    columns = np.concatenate([np.einsum("nlj,nl->nj", by_axis, force)[:, None], _FORCE_ZERO * by_axis], axis=1)
    return s.decimate(np.moveaxis(columns, 1, 2))[::stride]


def _shown(bodies: list[Array], root: Array) -> Array:
    """Orthonormal directions of the links' parameters that the rows ``(M, n, 10 n)`` show at all ``(10 n, P)``.

    Of the others, a third for most arms, the posterior is the prior.
    """
    flat = np.concatenate([one.reshape(-1, len(root)) for one in bodies]) @ root
    squares, directions = linalg.eigh(flat.T @ flat)
    return np.asarray(directions[:, squares > PRODUCTS * squares[-1]])


def _in_units(column: Array) -> Array:
    return column / np.maximum(np.std(column, axis=0), 1e-9)


def _bodies(s: FilteredSignals, robot: Robot, gravity: tuple[float, float, float]) -> Array:
    """The regressor of the links' parameters under another gravity [m/s²], decimated ``(M, n, 10 n)``."""
    model = robot.pinocchio.copy()
    model.gravity.linear = np.array(gravity, dtype=float)
    return s.decimate_motion(lambda some: regressor(model, s.q[some], s.qd[some], s.qdd[some]))


def link_prior(robot: Robot) -> tuple[Array, Array]:
    """Mean of the links' parameters ``(10 b,)`` by the URDF, and a root of their covariance ``(10 b, 10 b)``."""
    model = robot.pinocchio
    b, mean, data = model.njoints - 1, link_parameters(model), model.createData()
    pin.forwardKinematics(model, data, robot.home)
    places = [data.oMi[j + 1].translation for j in range(b)] + [np.asarray(robot.fk()(robot.home).translation)]
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    lengths = np.maximum(lengths, _LEAST_LENGTH * max(float(lengths.sum()), 1.0))
    least = _LEAST_MASS * max(float(mean[::10].sum()), 1e-3)
    root = np.zeros((10 * b, 10 * b))
    for j, length in enumerate(lengths):
        own = slice(10 * j, 10 * j + 10)
        mass = max(float(mean[10 * j]), least)
        spread = np.concatenate([[0.5 * _MASSES * mass], np.full(3, mass * _CENTRES * length),
                                 np.full(6, mass * (_GYRATION * length) ** 2)])
        root[own, own] = linalg.cholesky(np.diag(spread**2) + _MASSES**2 * np.outer(mean[own], mean[own]), lower=True)
    return mean, root


# Search over hypotheses.

Score = Callable[[Reading], float]
"""Evidence and prior of a supposition [nats]."""


def _prior(reading: Reading, rows: _Rows) -> float:
    """Logarithm of the prior of what is supposed of a recording, up to a constant."""
    n = len(reading.column)
    value = 0.0
    moved = sum(i != j for i, j in enumerate(reading.column))
    if moved:
        value -= _CHANGE + 0.5 * moved * np.log(max(0.5 * n * (n - 1), 1.0))
    turned = reading.sign.count(-1)
    if turned:
        value -= _CHANGE + (0.0 if turned == n else turned * np.log(n))
    logs = np.log(reading.unit)
    common = float(np.median(logs))
    wide = float(np.log(_GAIN * np.sqrt(2.0 * np.pi) / _UNITS))
    each = np.maximum(-0.5 * ((logs - common) / _GAIN) ** 2, wide)
    value += float(each.sum()) + max(-0.5 * (common / _COMMON) ** 2, -_CHANGE)
    value -= _CHANGE * bool(np.any(each <= wide))
    beyond = np.maximum(rows.peaks[np.arange(n), list(reading.column)] - logs, 0.0)
    value -= 0.5 * float(np.sum((beyond / _BEYOND) ** 2))
    size = float(np.linalg.norm(reading.gravity))
    if size == 0.0:
        value -= _CHANGE
    elif (tilt := float(np.arccos(np.clip(-reading.gravity[2] / size, -1.0, 1.0)))) > _LEVEL:
        # A uniform prior over directions of the sphere; those of a floor-mounted arm are a small cap of it.
        value -= _CHANGE + float(np.log(2.0 / (1.0 - np.cos(_LEVEL))))
    else:
        value -= 0.5 * (2.0 * tilt / _LEVEL) ** 2
    return value


def _searched(rows: _Rows) -> tuple[Reading, dict[str, float]]:
    """The best supposition, and by how many nats each kind of change explains more than those before it."""

    @cache
    def score(reading: Reading) -> float:
        return rows.evidence(reading) + _prior(reading, rows)

    @cache
    def rough(reading: Reading) -> float:
        return rows.evidence(reading, 1) + _prior(reading, rows)

    reading, best = _tuned(Reading.claimed(rows.n), score)
    gained: dict[str, float] = {}
    for _ in range(3 * rows.n):
        leading: dict[str, Reading] = {}
        for kind, change in _changes(reading, rows):
            if kind not in leading or rough(change) > rough(leading[kind]):
                leading[kind] = change
        # If torques are shares of rated torques, one joint alone gains little, so all units are changed at once.
        each = _tuned(_units_of_its_own(reading, score), score)[0]
        leading[WRONG_SCALE] = max(leading[WRONG_SCALE], each, key=score)
        # A direction is refined to a few degrees before the comparison.
        leading[TURNED] = _directed(leading[TURNED], rough)
        kind, change = max(leading.items(), key=lambda pair: score(pair[1]))
        if score(change) < best + _ACCEPTED:
            break
        change, value = _tuned(change, score)
        gained[kind] = gained.get(kind, 0.0) + value - best
        reading, best = change, value
    if WRONG_SCALE in gained:
        # A joint in another unit biases the units of others that carry the same bodies.
        other, value = _tuned(_units_of_its_own(replace(reading, unit=(1.0,) * rows.n), score), score)
        reading = other if value > best - _ACCEPTED else reading
    return reading, gained


def _changes(reading: Reading, rows: _Rows) -> Iterator[tuple[str, Reading]]:
    """Suppositions one change away."""
    n, live = rows.n, [i for i in range(rows.n) if rows.live[reading.column[i]]]
    for i in live:
        yield WRONG_SIGN, replace(reading, sign=_with(reading.sign, i, -reading.sign[i]))
    yield WRONG_SIGN, replace(reading, sign=tuple(-sign for sign in reading.sign))
    for i in range(n):
        for j in range(i):
            column = _with(_with(reading.column, i, reading.column[j]), j, reading.column[i])
            yield EXCHANGED, replace(reading, column=column)
    for factor in _FACTORS:
        if factor != 1.0:
            yield WRONG_SCALE, replace(reading, unit=tuple(unit * factor for unit in reading.unit))
        for i in live:
            yield WRONG_SCALE, replace(reading, unit=_with(reading.unit, i, factor))
    yield NO_GRAVITY, replace(reading, gravity=(0.0, 0.0, 0.0))
    for direction in _sphere():
        yield TURNED, replace(reading, gravity=direction)


def _with(values: tuple[Any, ...], i: int, value: Any) -> tuple[Any, ...]:
    return (*values[:i], value, *values[i + 1 :])


def _sphere() -> list[tuple[float, float, float]]:
    """Directions of gravity all over the sphere, that of an arm that stands first [m/s²]."""
    step = np.radians(_SLIPS)
    directions = []
    for polar in np.arange(0.0, np.pi + 1e-9, step):
        count = max(1, round(2.0 * np.pi * np.sin(polar) / step))
        directions += [(float(G * np.sin(polar) * np.cos(a)), float(G * np.sin(polar) * np.sin(a)),
                        float(-G * np.cos(polar))) for a in 2.0 * np.pi * np.arange(count) / count]
    return directions


def _tuned(reading: Reading, score: Score) -> tuple[Reading, float]:
    """The supposition with units improved joint by joint, within what lies between two that are tried."""
    best, start = score(reading), reading.unit
    for _ in range(2):
        before = best
        for i, first in enumerate(start):
            for factor in (0.74, 0.86, 0.93, 1.07, 1.16, 1.35):
                unit = reading.unit[i] * factor
                if abs(np.log(unit / first)) > 0.5 * _APART:
                    continue
                other = replace(reading, unit=_with(reading.unit, i, unit))
                if (value := score(other)) > best:
                    reading, best = other, value
        if best < before + 0.1:
            break
    return reading, best


def _units_of_its_own(reading: Reading, score: Score) -> Reading:
    """The supposition with the unit of each joint by itself that explains it best."""
    for _ in range(2):
        for i in range(len(reading.unit)):
            reading = max((replace(reading, unit=_with(reading.unit, i, factor)) for factor in _FACTORS), key=score)
    return reading


def _directed(reading: Reading, score: Score) -> Reading:
    """The supposition with gravity turned further, as long as that explains more."""
    best = score(reading)
    for step in np.radians([_SLIPS / 2.0, _SLIPS / 4.0, 3.0, 1.0]):
        for _ in range(4):
            g = np.array(reading.gravity)
            across = np.linalg.svd(g[None])[2][1:]
            turned = [replace(reading, gravity=tuple((np.cos(step) * g + sign * np.sin(step) * G * axis).tolist()))
                      for axis in across for sign in (1.0, -1.0)]
            other = max(turned, key=score)
            value = score(other)
            if value <= best:
                break
            reading, best = other, value
    return reading


# Sentences about the findings.

def _said(reading: Reading, gained: dict[str, float], rows: _Rows, robot: Robot) -> tuple[Finding, ...]:
    """What the best supposition says that the recording does not, each with its remedy."""
    said = []
    n = rows.n
    if moved := [i for i in range(n) if reading.column[i] != i]:
        pairs = ", ".join(f"joint {i + 1} by tau_{reading.column[i] + 1}" for i in moved)
        said.append(Finding(EXCHANGED, tuple(i + 1 for i in moved),
                            f"the rigid body of the URDF explains {pairs}; exchange the columns, or give the joints in "
                            "the URDF's order (--joints, --columns)", gained.get(EXCHANGED, 0.0)))
    turned = [i for i in range(n) if reading.sign[i] < 0]
    if turned:
        which = "all joints" if len(turned) == n else f"joint{'s' * (len(turned) > 1)} {_listed(turned)}"
        said.append(Finding(WRONG_SIGN, tuple(i + 1 for i in turned),
                            f"the torque of {which} has the other sign: -tau fits the URDF's rigid body and friction; "
                            f"multiply {_columns(turned)} by -1", gained.get(WRONG_SIGN, 0.0)))
    if WRONG_SCALE in gained and (scale := _scale(reading, rows, robot, gained[WRONG_SCALE])):
        said.append(scale)
    everyone = tuple(range(1, n + 1))
    if np.linalg.norm(reading.gravity) == 0.0:
        said.append(Finding(NO_GRAVITY, everyone, "these torques hold no gravity (the controller has taken it out, as "
                            "UR's does); masses and first moments cannot be identified from them: log torques with "
                            "gravity, or add g(q) of the controller's own model", gained.get(NO_GRAVITY, 0.0)))
    elif (angle := np.degrees(np.arccos(np.clip(-reading.gravity[2] / G, -1.0, 1.0)))) > np.degrees(_LEVEL):
        d = np.array(reading.gravity) / G
        how = ("the arm hangs" if angle > 170.0 else "the arm is on a wall" if 80.0 < angle < 100.0 else
               "the base is tilted")
        said.append(Finding(TURNED, everyone, f"gravity acts {angle:.0f}° from the URDF's, along ({d[0]:.2f}, "
                            f"{d[1]:.2f}, {d[2]:.2f}) of its base: {how}; mount the URDF so (a fixed joint from the "
                            "world to the base)", gained.get(TURNED, 0.0)))
    return tuple(said)


def _scale(reading: Reading, rows: _Rows, robot: Robot, nats: float) -> Finding | None:
    """What is to be said of units; None where they are no farther off than guessed masses are."""
    live = [i for i in range(rows.n) if rows.live[reading.column[i]]]
    logs = np.log(reading.unit)
    common = float(np.median(logs[live]))
    apart = [i for i in live if abs(logs[i] - common) > _OFF]
    # If torques are quantised in shares one joint is enough evidence, as the others' bodies may be that heavy.
    told = rows.shares and any(abs(logs[i]) > _SHARE_OFF for i in live)
    if not told and abs(common) <= _COMMON_OFF and len(apart) < _MOST * len(live):
        return None
    # Shares of a rated torque apply to every joint, even if one is near a newton metre by chance.
    weighed, surer = _by_the_urdf(reading, rows, live)
    units = np.array(weighed.unit)
    off = live if told else [i for i in live if max(abs(logs[i]), abs(np.log(units[i]))) > _OFF]
    known = [i for i in off if _determined(weighed, surer, i)]
    ratio = np.asarray(robot.gear_ratio)
    logs = np.log(units)
    motor = bool(known) and np.all(np.abs(logs[known] + np.log(np.maximum(ratio[known], 1e-9))) < _OFF) and np.all(
        ratio[off] > 1.0)
    why = ("they are at the motor's side of the gear: multiply by the gear ratio" if motor else
           "another unit (per cent or per mille of the rated torque, the motor's side of the gear), or masses that are "
           "not the arm's")
    friction = [i for i in off if i not in known]
    fits = ["what fits them is about " + ", ".join(f"tau_{i + 1} × {float(f'{1.0 / units[i]:.2g}'):g}" for i in known)
            if known else "", f"of {_columns(friction)}, mostly friction, no factor can be seen" if friction else ""]
    return Finding(WRONG_SCALE, tuple(i + 1 for i in off), f"the torques are not in N m by the URDF's masses: {why}; "
                   f"{'; '.join(filter(None, fits))} (--columns map.toml with factor)", nats)


def _by_the_urdf(reading: Reading, rows: _Rows, joints: Sequence[int]) -> tuple[Reading, _Rows]:
    """Units of some joints' torques that the URDF's masses explain best, were they as sure as ``_WEIGHED``; such rows.

    The search for what a recording is doubts the masses, and leaves a unit and masses that are off by the same factor
    as likely: that is no factor to multiply by.
    """
    surer = replace(rows, sure=_WEIGHED / _MASSES)
    for step in (_APART, 0.25 * _APART, 0.0625 * _APART):
        # Joints that carry the same bodies bias each other's units.
        for _ in range(2 * len(joints)):
            before = reading
            for i in joints:
                tried = [replace(reading, unit=_with(reading.unit, i, reading.unit[i] * factor))
                         for factor in np.exp(step * np.array([0.0, -2.0, -1.0, 1.0, 2.0])).tolist()]
                reading = max(tried, key=surer.evidence)
            if reading == before:
                break
    return reading, surer


def _determined(reading: Reading, rows: _Rows, joint: int) -> bool:
    """Whether the rigid body, not the prior, says of a joint what the unit of its torque is."""
    best = rows.evidence(reading)
    return all(max(rows.evidence(replace(reading, unit=_with(reading.unit, joint, reading.unit[joint] * factor)))
                   for factor in np.exp(side * _SEEN * np.array([1.0, 2.0, 4.0])).tolist()) < best - _FELL
               for side in (-1.0, 1.0))


def _listed(joints: list[int]) -> str:
    return ", ".join(str(j + 1) for j in joints)


def _columns(joints: list[int]) -> str:
    return ", ".join(f"tau_{j + 1}" for j in joints)
