"""The desired path x_d over the horizon, in joint space: reference plus smoothed deviation ([L] 4.1, Fig. 2)."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array, held, interpolated
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.command_answer import CommandAnswer
from ideal_robot.robots.robot import Robot
from planning.path.commanded import Commanded
from planning.path.joint_path import JointPath
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from planning.path.speed_profile import SpeedProfile

# Smoothing of the sensed path x_s to the desired path x_d ([L] 4.1, Fig. 2): continuous for any sensor values.
#
# The desired deviation :math:`d(t)` follows the estimated one, :math:`r(t)`, as the minimum of
#
# .. math:: \int (d - r)^2 + \omega^{-6}\, \dddot d^{\,2} \; dt
#
# over the horizon, from the position, velocity and acceleration that the plan has at the first instant that may still
# be changed. Looking ahead, it has no delay: a wave of frequency :math:`f` passes with the gain
# :math:`1/(1 + (2 \pi f/\omega)^6)`.

FROZEN = 1
"""Cycles from now on that a new estimate does not change: the arm is on its way to the next position."""
SPARE = 0.144
"""By how much a plan reaches further than it is asked for [s], for fields that fail to come: seven at 50 a second."""


def planned_cycles(n_d: int, t_ipo: float, spare: float = SPARE) -> int:
    """Number of cycles that a plan covers.

    Args:
        n_d: cycles of the horizon.
        t_ipo: cycle [s].
        spare: by how much it reaches further [s].
    """
    return n_d + round(spare / t_ipo)


class Smoother:
    """Computes the smoothed plan for several cutoff frequencies; each is one precomputed matrix product.

    The highest cutoff whose plan needs at most ``acceleration``, and that the commands can follow, is used: small
    changes of the estimate are followed quickly, a line that was just found is approached gently.

    Args:
        samples, t_ipo: cycles of the plan, and how long one is [s].
        cutoff: highest cutoff frequency [Hz]; softer ones are each a factor 1.4 below, down to 1 Hz.
        acceleration: largest one of corrections, beyond the estimate's own acceleration [m/s²].
    """

    def __init__(self, samples: int, t_ipo: float, cutoff: float = 15.0, acceleration: float = 4.0) -> None:
        self.samples, self._t, self._acceleration = samples, t_ipo, acceleration
        self._laws = _laws(samples, t_ipo, cutoff)
        self._bend_at = np.maximum(np.arange(samples - 1) - 1, 0)

    def plan(self, state: Array, estimate: Array, possible: Callable[[Array, Array], bool] | None = None) -> Array:
        """Positions, velocities and accelerations of the next cycles ``(3, samples, directions)`` [m, m/s, m/s²].

        Args:
            state: the same at the last instant that stays ``(3, directions)``.
            estimate: the estimated deviation at the ``samples`` following cycles ``(samples, directions)`` [m].
            possible: whether the commands can follow a plan, from its accelerations and those of the estimate
                ``(samples - 1, directions)`` [m/s²]; None accepts every plan.
        """
        stacked = np.concatenate([state, estimate])
        rise = estimate[1:] - estimate[:-1]
        bend = (rise[1:] - rise[:-1])[self._bend_at] / self._t**2
        for law in self._laws:
            planned = (law @ stacked).reshape(3, self.samples, -1)
            within = np.abs(planned[2, :-1] - bend).max() <= self._acceleration
            if within and (possible is None or possible(planned[2, :-1], bend)):
                break
        return np.asarray(planned)


@lru_cache(maxsize=8)
def _laws(samples: int, T: float, cutoff: float) -> tuple[Array, ...]:
    """Matrices ``(3 samples, 3 + samples)`` from first state and estimate to the plan, the stiffest first."""
    A = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    B = np.array([T**3 / 6.0, T**2 / 2.0, T])
    # States after each cycle from the first state and the jerks, jerk constant over a cycle.
    free, forced = np.zeros((samples, 3, 3)), np.zeros((samples, 3, samples))
    power = np.eye(3)
    for i in range(samples):
        power = A @ power
        free[i] = power
    response = B
    for late in range(samples):
        for j in range(samples - late):
            forced[j + late, :, j] = response
        response = A @ response
    G = forced[:, 0]
    laws = []
    frequency = cutoff
    while True:
        weight = (2.0 * np.pi * frequency) ** -6
        jerk = np.linalg.solve(G.T @ G + weight * np.eye(samples), G.T)
        # Columns: first state (3), then the estimate's samples.
        law = np.concatenate(
            [free - np.einsum("isj,jk,kl->isl", forced, jerk, free[:, 0]), np.einsum("isj,jk->isk", forced, jerk)],
            axis=2,
        )
        law = np.ascontiguousarray(law.transpose(1, 0, 2).reshape(3 * samples, 3 + samples))
        law.setflags(write=False)
        laws.append(law)
        frequency /= 1.4
        if frequency < 1.0:
            return tuple(laws)


# The reference path at every interpolation cycle of its travel, in Cartesian and in joint space.

Rows = slice | NDArray[np.int_]
"""Which cycles: a slice, or their numbers."""


class ReferenceTable:
    """The parts of a reference that sensors do not change, tabulated before the travel begins.

    Args:
        kinematics, reference, profile: of the arm, the reference path, and the travel along it.
        rest: cycles at rest at the end of the table, after the travel.

    Attributes:
        s: arc length at every cycle ``(K,)`` [m].
        frames: the path's frames there.
        rotations: of the tool in the base frame ``(K, 3, 3)``.
        q: joint angles ``(K, n)`` [rad].
    """

    def __init__(self, kinematics: InverseKinematics, reference: ReferencePath, profile: SpeedProfile,
                 rest: int) -> None:
        T = kinematics.robot.t_ipo
        cycles = int(np.ceil(profile.duration / T)) + rest
        self.s = profile.s(T * np.arange(cycles))
        self.frames = reference.frames(self.s)
        self.rotations = reference.rotation(self.s)
        path = profile.joint_path or JointPath.of(kinematics.robot, reference)
        self.q = interpolated(self.s, path.s, path.q)
        self.q = kinematics.refine_rows(self.rotations, self.frames.position, self.q, tolerance=1e-12)

    def __len__(self) -> int:
        return len(self.s)

    def displaced(self, rows: Rows, deviation: Array) -> Array:
        """Positions :math:`x_r + d_1 n + d_2 u` at some cycles ``(m, 3)`` [m], [L] (6).

        ``deviation`` is lateral, and with a second column along the surface normal too ``(m, 1 or 2)`` [m].
        """
        positions = self.frames.position[rows] + deviation[:, :1] * self.frames.normal[rows]
        if deviation.shape[1] > 1:
            positions = positions + deviation[:, 1:] * self.frames.up[rows]
        return positions


class DesiredPath:
    r"""Desired joint positions of the coming cycles, kept up to date with an estimated deviation from the reference.

    .. math:: x_d(t) = x_r(s(t)) + d_1(t)\, n(s(t)) + d_2(t)\, u(s(t))

    with the lateral normal ``n`` and the surface normal ``u`` of the path ([L] (6)); the orientation is the
    reference's. All of the reference is tabulated beforehand for every cycle, and only what a new estimate changes is
    computed again: a cycle without one costs a single pose.

    Args:
        robot, reference, profile: the arm, the reference path, and the travel along it.
        n_d: desired positions a call of ``horizon`` gives.
        directions: 1 lateral, 2 also height.
        t_start: controller time at which the travel begins [s].
    """

    def __init__(self, robot: Robot, reference: ReferencePath, profile: SpeedProfile, n_d: int, *,
                 directions: int = 1, t_start: float = 0.0) -> None:
        if n_d < 1:
            raise InputError("expected at least 1", field="n_d", value=n_d)
        self.n_d, self.t_start, self._T = n_d, t_start, robot.t_ipo
        self._kinematics = InverseKinematics(robot)
        self.samples = planned_cycles(n_d, self._T)
        self._smoother = Smoother(self.samples, self._T)
        self._table = table = ReferenceTable(self._kinematics, reference, profile, 2 * self.samples)
        self.s = table.s
        """Arc length of the reference at every cycle ``(K,)`` [m]."""
        self.q_reference = table.q
        """The reference in joint space at every cycle ``(K, n)`` [rad]."""
        self._q = self.q_reference.copy()
        self._plan = np.zeros((3, len(table), directions))
        self._planned_to = self._solved_to = self._ever_solved = -1
        self._commanded: Commanded | None = None

    def led_by(self, feedforward: Feedforward) -> None:
        """Limits corrections from now on to those that a feedforward's commands can make within the limits."""
        robot, table = self._kinematics.robot, self._table
        answer = CommandAnswer.of(feedforward, robot, table.q[len(table) // 2])
        self._commanded = Commanded(answer, robot.a_max, self._per_metre())

    def _per_metre(self) -> Array:
        """Change of the joint angles with each direction's deviation at every cycle ``(K, n, directions)`` [rad/m]."""
        frames, away = self._table.frames, self._kinematics.away
        return np.stack([[away(q, way) for q, way in zip(self._table.q, ways, strict=True)]
                         for ways in (frames.normal, frames.up)[: self._plan.shape[2]]], axis=2)

    def cycle(self, t: float) -> int:
        """Number of the cycle at ``t`` [s]; behind the end of the tables everything rests."""
        k = round((t - self.t_start) / self._T)
        return min(max(k, 0), len(self.s) - self.samples - 2)

    def horizon(self, t: float, estimate: Callable[[Array], Array], changed: bool) -> Array:
        """Desired joint positions ``q_d(k) … q_d(k + n_d - 1)`` from ``t`` on, shape ``(n_d, n)`` [rad].

        Raises ``OutOfReachError`` where the desired path leads out of the arm's reach.

        Args:
            t: now [s].
            estimate: the estimated deviation ``(m, directions)`` [m] of arc lengths ``(m,)`` [m].
            changed: whether the estimate is another one than at the last call.
        """
        k = self.cycle(t)
        end = k + self.n_d
        if changed or self._planned_to < end:
            self._replan(k, estimate)
        first = max(self._solved_to + 1, k)
        if first < end:
            self._solve(first, end)
        return self._q[k:end].copy()

    def deviation(self, t: float) -> Array:
        """Desired deviation at ``t``, its velocity and acceleration, ``(3, directions)`` [m, m/s, m/s²]."""
        return self._plan[:, self.cycle(t)].copy()

    def _replan(self, k: int, estimate: Callable[[Array], Array]) -> None:
        """New desired deviation behind the cycles that are being executed."""
        keep = k + FROZEN if self._planned_to >= k + FROZEN else max(k, 0)
        keep = min(keep, len(self.s) - self.samples - 1)
        if self._planned_to < keep:
            # Cycles without a call of ``horizon``: the deviation was constant.
            self._plan[0, self._planned_to + 1 : keep + 1] = self._plan[0, max(self._planned_to, 0)]
        coming = slice(keep + 1, keep + 1 + self.samples)
        possible: Callable[[Array, Array], bool] | None = None
        if (commanded := self._commanded) is not None:
            before = commanded.answer.before
            past = held(self._plan[2, max(k - before, 0) : coming.start], before=max(before - k, 0))
            possible = partial(commanded.possible, k, past)
        self._plan[:, coming] = self._smoother.plan(self._plan[:, keep], estimate(self.s[coming]), possible)
        self._planned_to = keep + self.samples
        self._solved_to = min(self._solved_to, keep)

    def _solve(self, first: int, end: int) -> None:
        """Inverse kinematics of the cycles ``first … end - 1``."""
        # Cycles solved before start from their solution; later ones start from the reference plus the last offset.
        start = self._q[first:end]
        new = self._ever_solved + 1
        if new < end:
            start = start.copy()
            offset = self._q[new - 1] - self.q_reference[new - 1] if new else 0.0
            start[max(new - first, 0) :] = self.q_reference[max(new, first) : end] + offset
        coming = slice(first, end)
        self._q[coming] = self._kinematics.refine_rows(
            self._table.rotations[coming], self._table.displaced(coming, self._plan[0, coming]), start,
            wanted=self.q_reference[coming])
        self._solved_to = end - 1
        self._ever_solved = max(self._ever_solved, end - 1)
