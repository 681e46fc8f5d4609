"""Rigid body, rotors, offsets and friction of all joints in one weighted least-squares fit ([J] 3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, full_regressor, torques, with_link_parameters
from ideal_robot.dynamics.consistent_inertias import Consistency, consistent_parameters
from ideal_robot.effects import EffectParameter, FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.friction import LAWS, FrictionModel, PerJointFriction, law_of
from ideal_robot.identification.friction_choice import FrictionChoice, brakes, candidates, with_coefficients
from ideal_robot.identification.weighted_least_squares import (
    Prior,
    Solution,
    rotors_of,
    weighted_least_squares,
)
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import coefficient_columns, shape_columns
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.error_budget import ErrorBudget
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import resampled


def regions_of_motion(q: Array, qd: Array) -> list[np.ndarray]:
    """Row indices of eight regions of a motion ``(M, n)``, equal in size.

    Every region is halved at the median of the angle or velocity that varies most in it, relative to its variation in
    the whole motion. Repeated parts of a motion are in the same region.
    """
    state = np.hstack([q, qd])
    state = state / np.maximum(np.std(state, axis=0), 1e-12)
    regions = [np.arange(len(state))]
    for _ in range(3):
        halves = []
        for rows in regions:
            widest = int(np.argmax(np.std(state[rows], axis=0))) if len(rows) else 0
            order = rows[np.argsort(state[rows, widest], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        regions = halves
    return regions


_ATTEMPTS = 3
"""Choices of laws: each may bar joints whose load was a guess."""
_LAG = 0.01
"""Standard deviation of the time by which torques may be logged late [s]."""
_OTHER_LOAD = 0.1
"""A load that changes by this share of its size once the arm is known was a guess, and friction cannot follow it."""


@dataclass(frozen=True)
class JointFit:
    """Result of the fit.

    Attributes:
        solution: base parameters, friction coefficients, friction shapes, with their statistics.
        friction: the laws with their coefficients.
        consistency: physically possible parameters.
        scores: per joint, held-out residual of each friction law tried.
        counted: per joint, final sum of the samples' weights, as a share of all samples ``(n,)``.
        springs: effects of hoses and cables that pull a joint.
    """

    solution: Solution
    friction: PerJointFriction
    consistency: Consistency
    scores: tuple[dict[str, float], ...]
    counted: Array
    springs: tuple[FittedEffect, ...] = ()


class JointProblem:
    """The least-squares problem of all recordings' decimated data.

    Args:
        robot: kinematics.
        base: grouping of its parameters.
        prior: prior of the parameters.
        signals, budgets: one per recording; a dead channel's torque is NaN.
    """

    def __init__(self, robot: Robot, base: BaseParameters, prior: Prior, signals: Sequence[FilteredSignals],
                 budgets: Sequence[ErrorBudget]) -> None:
        self._robot, self._base, self._prior, self._signals = robot, base, prior, signals
        self._W = np.concatenate([s.decimate_motion(lambda rows, s=s: full_regressor(  # type: ignore[misc]
            robot.pinocchio, s.q[rows], s.qd[rows], s.qdd[rows], base.independent)) for s in signals])
        self._y = np.concatenate([s.decimate(s.tau) for s in signals])
        self._segments = np.concatenate([np.full(s.keep.sum(), i) for i, s in enumerate(signals)])
        self._velocity, self._sigma_v, self._sigma_a = (np.concatenate(parts) for parts in (
            [s.qd[:: s.factor][s.keep] for s in signals], [b.velocity for b in budgets],
            [b.acceleration for b in budgets]))
        self._rate = np.nan_to_num(np.concatenate([s.decimate(np.gradient(s.tau, s.dt, axis=0)) for s in signals]))
        # Joints that a hose or cable pulls, from 0, and the torque of its spring of 1 N m/rad (M, n, k).
        self._pulled, self._springs = np.zeros(0, dtype=int), np.zeros((*self._y.shape, 0))
        self._regions = regions_of_motion(np.concatenate([s.q[:: s.factor][s.keep] for s in signals]), self._velocity)

    def fit(self, wanted: str) -> JointFit:
        """Fits with a friction law for all joints, or with ``auto`` the best one for each."""
        rough = self._rough()
        values = rough.value[: self._base.count]
        # The load is only needed for a choice among laws: a given law does not depend on it.
        load = ([np.zeros_like(s.q) for s in self._signals] if wanted != "auto"
                else self._load(self._base.nearest_full(values, self._prior.nominal)))
        variance = self._variance(rough)
        barred: set[int] = set()
        if wanted == "auto":
            self._pull(FrictionChoice(self._signals, self._W, self._y - self._W @ self._prior.start, load,
                                      rough.noise_std, self._prior.information))
        for _ in range(_ATTEMPTS):
            laws, scores = self._laws(wanted, load, rough.noise_std, frozenset(barred))
            solution, friction, springs = self._final(laws, load, variance)
            base_values = solution.value[: self._base.count]
            b = self._base.count
            consistency = consistent_parameters(self._base, base_values, solution.covariance[:b, :b],
                                                self._prior.nominal, self._prior.rotors)
            if not any(law.loaded for law in laws):
                break
            known = self._load(self._base.nearest_full(base_values, consistency.full))
            vague = self._follows_a_guess(laws, load, known)
            load = known
            if not vague:
                break
            barred |= vague
        noise = np.maximum(solution.noise_std, 1e-12)
        weight = np.mean(noise**2 / (noise**2 + variance), axis=0)
        share = len(self._y) / sum(len(s.keep) for s in self._signals)
        live = ~np.isnan(self._y).all(axis=0)
        return JointFit(solution, friction, consistency, tuple(scores), np.where(live, share * weight, 0.0), springs)

    def _pull(self, choice: FrictionChoice) -> None:
        """Finds the joints that a spring pulls, and keeps their columns."""
        q = np.concatenate([s.decimate(s.q) for s in self._signals])
        self._pulled = np.flatnonzero(choice.pulled(q))
        self._springs = np.zeros((*q.shape, len(self._pulled)))
        for column, j in enumerate(self._pulled):
            self._springs[:, j, column] = q[:, j]

    def _rough(self, *, correlated: bool = False) -> Solution:
        """Fit of dry and viscous friction; of its covariance only wrong signs ask for more than that of white noise."""
        laws = [candidates([law_of("viscous_coulomb")], refine=False)[0].make(()) for _ in range(self._robot.n)]
        none = [np.zeros_like(s.q) for s in self._signals]
        W = np.concatenate([self._W, self._columns(coefficient_columns, laws, none)], axis=2)
        return self._solved(W, None, None, correlated=correlated)

    def _solved(self, W: Array, nonnegative: np.ndarray | None, variance: Array | None, *,
                correlated: bool = True) -> Solution:
        start = np.concatenate([self._prior.start, np.zeros(W.shape[2] - self._base.count)])
        return weighted_least_squares(W, self._y, start, self._prior.padded(W.shape[2]), nonnegative=nonnegative,
                                      segments=self._segments if correlated else None, variance=variance,
                                      regions=self._regions)

    def _beside(self, W: Array, nonnegative: np.ndarray, variance: Array, held: np.ndarray, values: Array) -> Array:
        """All parameters ``(P,)`` where some of them are held at values.

        Args:
            W, nonnegative, variance: as of the fit.
            held, values: places of those parameters ``(k,)``, and what they are.
        """
        others = W.copy()
        others[:, :, held] = 0.0
        start = np.concatenate([self._prior.start, np.zeros(W.shape[2] - self._base.count)])
        value = weighted_least_squares(others, self._y - W[:, :, held] @ values, start, self._prior.padded(W.shape[2]),
                                       nonnegative=nonnegative, variance=variance).value.copy()
        value[held] = values
        return value

    def _laws(self, wanted: str, load: Sequence[Array], noise: Array, barred: frozenset[int],
              ) -> tuple[list[FrictionModel], list[dict[str, float]]]:
        automatic = [law for law in map(law_of, LAWS.names()) if law.automatic]
        options = candidates(automatic, refine=True) if wanted == "auto" else candidates([law_of(wanted)], refine=False)
        if len(options) == 1 and not options[0].bounds:
            return [options[0].make(()) for _ in range(self._robot.n)], [{} for _ in range(self._robot.n)]
        rigid = np.concatenate([self._W, self._springs], axis=2)
        choice = FrictionChoice(self._signals, rigid, self._y - self._W @ self._prior.start, load, noise,
                                self._prior.padded(rigid.shape[2]), barred)
        return choice.choose(options)

    def _final(self, laws: Sequence[FrictionModel], load: Sequence[Array],
               variance: Array) -> tuple[Solution, PerJointFriction, tuple[FittedEffect, ...]]:
        rigid = self._W.copy()
        for j, law in enumerate(laws):
            if law.holds_offset:
                # The law contains the difference of the two dry frictions, so the offset is no parameter itself.
                rigid[:, :, self._base.names.index(f"offset_{j + 1}")] = 0.0
        W = np.concatenate([rigid, self._columns(coefficient_columns, laws, load), self._springs], axis=2)
        places = np.arange(W.shape[2] - len(self._pulled), W.shape[2])
        nonnegative = np.concatenate([np.zeros(self._base.count, dtype=bool), *[law.nonnegative for law in laws],
                                      np.ones(len(places), dtype=bool)])
        coefficients = slice(self._base.count, W.shape[2] - len(places))
        solution = self._solved(W, nonnegative, variance)
        whole = self._with_shape(solution, W, with_coefficients(laws, solution.value[coefficients]), load)
        rotors, values, covariance = rotors_of(whole, self._base, self._prior)
        if len(rotors):
            # All other parameters are fitted again.
            value = self._beside(W, nonnegative, variance, rotors, values)
            whole = replace(whole, value=np.concatenate([value, whole.value[W.shape[2] :]]), covariance=covariance,
                            residual=self._y - W @ value)
        friction = with_coefficients(laws, whole.value[coefficients])
        fastest = np.max(np.abs(self._velocity), axis=0)
        wrong = [j for j, law in enumerate(friction.laws) if not brakes(law, fastest[j])]
        if wrong:
            # Only the sum of a degressive law's terms has to brake, which bounds of single coefficients cannot ensure.
            plain = candidates([law_of("viscous_coulomb")], refine=False)[0].make(())
            return self._final([plain if j in wrong else law for j, law in enumerate(laws)], load, variance)
        springs = tuple(self._spring(int(j), float(whole.value[k]), float(np.sqrt(whole.covariance[k, k])))
                        for j, k in zip(self._pulled, places, strict=True))
        return _without(whole, places), friction, springs

    def _spring(self, j: int, stiffness: float, std: float) -> FittedEffect:
        """A hose or cable that pulls joint ``j`` (from 0) by its stiffness [N m/rad]; its rest is in the offset."""
        unit = f"{self._robot.units('N m')[j]}/{self._robot.units('rad')[j]}"
        return FittedEffect("cable_spring", j + 1, f"tau_{j + 1}", (stiffness,), (std,),
                            parameters=(EffectParameter("stiffness", stiffness, std, unit),))

    def _columns(self, of_law: Callable[[FrictionModel, Array, Array, Array], Array], laws: Sequence[FrictionModel],
                 load: Sequence[Array]) -> Array:
        """Decimated columns of all joints' laws ``(M, n, Σm)``, each law's in the rows of its joint."""
        parts = []
        for s, load_s in zip(self._signals, load, strict=True):
            blocks = []
            for j, law in enumerate(laws):
                own = s.decimate(of_law(law, s.qd[:, [j]], load_s[:, [j]], s.q[:, [j]]))
                blocks.append(np.zeros((len(own), len(laws), own.shape[1])))
                blocks[-1][:, j] = own
            parts.append(np.concatenate(blocks, axis=2))
        return np.concatenate(parts)

    def _with_shape(self, solution: Solution, W: Array, friction: PerJointFriction,
                    load: Sequence[Array]) -> Solution:
        """The solution with the covariance of all parameters, by linearisation about the optimum.

        Shape parameters have their share of it. Torques that are logged late bend parameters, by what they change when
        a lag of all of them is fitted as well.
        """
        shape = np.concatenate([law.shape[:, 0] for law in friction.laws])
        bends, late = self._columns(shape_columns, friction.laws, load), -self._rate[:, :, None]
        joined = np.concatenate([W * ~solution.at_bound, bends, late], axis=2)
        information = self._prior.padded(joined.shape[2])
        information[-1, -1] = 1.0 / _LAG**2
        # At the optimum the linearised problem has the residual as its measurement and a zero step.
        linear = weighted_least_squares(joined, solution.residual, np.zeros(joined.shape[2]), information,
                                        segments=self._segments, regions=self._regions)
        bent = linear.value[:-1]
        none = np.zeros(len(shape), dtype=bool)
        return replace(solution, value=np.concatenate([solution.value, shape]),
                       covariance=linear.covariance[:-1, :-1] + np.outer(bent, bent),
                       std_white=linear.std_white[:-1], unexcited=np.concatenate([solution.unexcited, none]),
                       at_bound=np.concatenate([solution.at_bound, none]))

    def _load(self, full: Array) -> list[Array]:
        """Torque of the links alone, which the gears transmit, per recording ``(N, n)``."""
        links = with_link_parameters(self._robot.pinocchio, full[self._base.layout.links])
        links.armature = np.zeros(self._robot.n)
        return [torques(links, s.q, s.qd, s.qdd) for s in self._signals]

    def _follows_a_guess(self, laws: Sequence[FrictionModel], before: Sequence[Array],
                         after: Sequence[Array]) -> set[int]:
        """Joints whose friction grows with a load that turned out to be another one."""
        old, new = np.concatenate(before), np.concatenate(after)
        change = np.sqrt(np.mean((new - old) ** 2, axis=0)) / np.maximum(np.sqrt(np.mean(old**2, axis=0)), 1e-12)
        return {j for j, law in enumerate(laws) if law.loaded and change[j] > _OTHER_LOAD}

    def _variance(self, rough: Solution) -> Array:
        """Variance of the torque that errors of velocity and acceleration make at each sample ``(M, n)``.

        Acceleration counts with the joint's inertia. Where the velocity's error leaves the direction open, dry friction
        is anywhere between its two values.
        """
        n, b = self._robot.n, self._base.count
        friction = np.abs(rough.value[b:].reshape(n, 2))
        sigma = np.maximum(np.mean(self._sigma_v, axis=0), 1e-12)
        # Approximates 4 p (1 - p), p the probability of the wrong sign; decimated like the samples.
        undecided = np.clip(np.concatenate([s.decimate(np.exp(-0.5 * np.minimum(np.abs(s.qd) / sigma, 30.0) ** 2))
                                            for s in self._signals]), 0.0, 1.0)
        return np.asarray((np.abs(self._inertia(rough)) * self._sigma_a) ** 2 + (friction[:, 0] * self._sigma_v) ** 2
                          + friction[:, 1] ** 2 / 3.0 * undecided)

    def _inertia(self, rough: Solution) -> Array:
        """Inertia that each joint's drive feels, mean over the motion ``(n,)``."""
        q = np.concatenate([s.q[:: max(1, len(s.q) // 50)] for s in self._signals])
        n, independent, still = self._robot.n, list(self._base.independent), np.zeros_like(q)
        at_rest = full_regressor(self._robot.pinocchio, q, still, still)
        felt = np.empty(n)
        for j in range(n):
            pushed = full_regressor(self._robot.pinocchio, q, still, still + np.eye(n)[j])
            rows = (pushed - at_rest)[:, j][:, independent]
            felt[j] = float(np.mean(rows @ rough.value[: self._base.count]))
        return felt


def _without(solution: Solution, places: np.ndarray) -> Solution:
    """The solution without the parameters at these places."""
    keep = np.delete(np.arange(len(solution.value)), places)
    return replace(solution, value=solution.value[keep], covariance=solution.covariance[np.ix_(keep, keep)],
                   std_white=solution.std_white[keep], unexcited=solution.unexcited[keep],
                   at_bound=solution.at_bound[keep])


_PASSED = 20.0
"""Twists are compared with loads up to this frequency at least [Hz]: gears of arms resonate at 10 to 20 Hz."""


def stiffness_from_arm(recordings: Sequence[Recording], model: Model) -> Gears:
    """Stiffness and damping of each joint, ``k (q_m - q) + d (q̇_m - q̇) = load``, by least squares.

    The load is the torque of the links, without the rotor's, which does not pass the gear. An offset between the two
    angles is estimated along with each recording of ``q_i`` and ``qa_i``. Raises InputError where one has no arm
    angles.

    Returns:
        Both are at least zero. A gear that does not give way with its load is rigid, without damping; of one that
        carries no load nothing is known (NaN).
    """
    # Accelerations of a coarse encoder need the filter that the identification chose: noise in the load would make
    # gears appear stiff. Damping is determined near the gears' resonance, which must be in the band.
    cutoff = max(_PASSED, model.provenance.get("filters", {}).get("cutoff", 0.0))
    twists, rates, loads = [], [], []
    for recording in recordings:
        if not recording.has("qa"):
            raise InputError("arm angles qa_1 to qa_n are needed for stiffness", file=recording.source, field="qa_1")
        s = preprocess(recording, cutoff=cutoff)
        arm = resampled(recording.t, recording.joints("qa"), s.t, smooth=True)
        raw = resampled(recording.t, recording.joints("q"), s.t, smooth=True) - arm
        twist = lowpass(raw, s.dt, s.cutoff)
        load = model.rigid_body(lowpass(arm, s.dt, s.cutoff), s.qd, s.qdd)
        twists.append(s.decimate(twist))
        rates.append(s.decimate(np.gradient(twist, s.dt, axis=0)))
        loads.append(s.decimate(load))
    k, d = np.full((2, model.n), np.nan)
    for j in range(model.n):
        x = np.concatenate([v[:, j] - v[:, j].mean() for v in twists])
        v = np.concatenate([v[:, j] - v[:, j].mean() for v in rates])
        y = np.concatenate([v[:, j] - v[:, j].mean() for v in loads])
        # The noise is in the angles, not in the load: regress the twist on the load, and invert.
        if np.allclose(y, 0.0):
            continue
        compliance = float(y @ x / (y @ y))
        k[j] = 1.0 / compliance if compliance > 0.0 else np.inf
        d[j] = max(0.0, float((y - k[j] * x) @ v / (v @ v))) if compliance > 0.0 else 0.0
    return Gears(k, d)
