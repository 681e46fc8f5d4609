"""The motion program of the two-step identification, [G] 3.1.2: simple moves any industrial controller can make.

At each operating point one axis after another goes back and forth with trapezoidal velocity: slowly, for the
gravitational torque, then with high acceleration, for the moment of inertia. At one of them every axis also goes back
and forth at several speeds, for friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, base_parameters, full_regressor
from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import Workspace, approach, clear_of_obstacles
from ideal_robot.robots.robot import Robot

FRICTION_SPEEDS = (0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.5)
"""Speeds of the friction moves, as shares of each axis's limit."""
_ON_A_WAY = 48
"""Postures that are looked at on the way from one operating point to the next: a centimetre or two apart."""


@dataclass(frozen=True)
class Move:
    """One axis back and forth about an operating point.

    Attributes:
        point: number of the operating point, from 0.
        axis: from 1.
        purpose: ``gravity``, ``inertia`` or ``friction``.
        amplitude: half of the way [rad].
        velocity, acceleration: of the trapezoid [rad/s, rad/s²].
        repeats: number of motions there and back.
    """

    point: int
    axis: int
    purpose: str
    amplitude: float
    velocity: float
    acceleration: float
    repeats: int


@dataclass(frozen=True)
class Program:
    """The motion program: operating points ``(K, n)`` [rad] and the moves about them, in order."""

    points: Array
    moves: tuple[Move, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the program file."""
        return {"operating_points_rad": self.points.tolist(), "moves": [vars(move) for move in self.moves]}

    def text(self) -> str:
        """The program for people: one line per move, in degrees."""
        lines, last = [], -1
        for move in self.moves:
            if move.point != last:
                angles = "  ".join(f"A{i + 1} {a:8.2f}" for i, a in enumerate(np.degrees(self.points[move.point])))
                lines.append(f"PTP  point {move.point + 1}: {angles}  [deg]")
                last = move.point
            lines.append(f"     axis {move.axis} ±{np.degrees(move.amplitude):.2f} deg, {move.repeats} times, "
                         f"{np.degrees(move.velocity):.2f} deg/s, {np.degrees(move.acceleration):.1f} deg/s² "
                         f"({move.purpose})")
        return "\n".join(lines) + "\n"

    def commands(self, start: Array, t_ipo: float, robot: Robot) -> Array:
        """Commands ``(N, n)`` [rad] every ``t_ipo``, from rest at ``start``.

        Args:
            start, t_ipo: joint angles at rest before the program ``(n,)`` [rad], and the interpolation cycle [s].
            robot: the arm with its limits.
        """
        v_max, a_max = finite_limits(robot)
        position, parts = np.asarray(start, dtype=float), []
        pause = round(0.25 / t_ipo)
        for move in self.moves:
            centre = self.points[move.point]
            axis = move.axis - 1
            low, high = centre.copy(), centre.copy()
            low[axis] -= move.amplitude
            high[axis] += move.amplitude
            if np.any(np.abs(position - low) > 1e-9):
                parts += [approach(position, low, t_ipo, v_max, a_max), np.repeat(low[None], pause, axis=0)]
            travel = trapezoid(2.0 * move.amplitude, move.velocity, move.acceleration, t_ipo)
            for _ in range(move.repeats):
                for begin, sign in ((low, 1.0), (high, -1.0)):
                    leg = np.repeat(begin[None], len(travel), axis=0)
                    leg[:, axis] += sign * travel
                    parts.append(leg)
            parts.append(np.repeat(low[None], pause, axis=0))
            position = low
        return np.concatenate(parts)


def trapezoid(way: float, velocity: float, acceleration: float, t_ipo: float) -> Array:
    """Positions ``(N,)`` of a move from 0 to ``way`` with trapezoidal velocity, start left out.

    Args:
        way, velocity, acceleration: [rad], the largest [rad/s], [rad/s²].
        t_ipo: interpolation cycle [s].
    """
    v = min(velocity, float(np.sqrt(way * acceleration)))
    t_up = v / acceleration
    total = way / v + t_up
    t = np.minimum(np.arange(1, int(np.ceil(total / t_ipo)) + 1) * t_ipo, total)
    up = 0.5 * acceleration * np.minimum(t, t_up) ** 2
    even = v * np.clip(t - t_up, 0.0, total - 2.0 * t_up)
    braking = np.maximum(t - (total - t_up), 0.0)
    return np.asarray(up + even + v * braking - 0.5 * acceleration * braking**2)


def finite_limits(robot: Robot) -> tuple[Array, Array]:
    """Velocity and acceleration limits ``(n,)``, cautious values where the robot's data have none."""
    return (np.where(np.isfinite(robot.v_max), robot.v_max, 1.0), np.where(np.isfinite(robot.a_max), robot.a_max, 5.0))


def require_within_limits(robot: Robot, q_c: Array, workspace: Workspace) -> None:
    """Raises InputError, with limit and joint, for commands that leave a limit of the arm or the workspace.

    Args:
        robot, q_c: the arm, and commands every interpolation cycle ``(N, n)`` [rad].
        workspace: region in which tool and links may move.
    """
    speed = np.diff(q_c, axis=0) / robot.t_ipo
    acceleration = np.diff(speed, axis=0) / robot.t_ipo
    over = 1.0 + 1e-6
    slack = 1e-6 * np.maximum(np.abs(robot.q_max - robot.q_min), 1e-3)
    for what, wrong in (("position", np.any((q_c < robot.q_min - slack) | (q_c > robot.q_max + slack), axis=0)),
                        ("speed", np.any(np.abs(speed) > over * robot.v_max, axis=0)),
                        ("acceleration", np.any(np.abs(acceleration) > over * robot.a_max, axis=0))):
        if np.any(wrong):
            raise InputError(f"the planned motion leaves the {what} limit of joint {int(np.argmax(wrong)) + 1}; "
                             "nothing is written", field="motion")
    cell = workspace.on_the_way(robot).cell
    if cell is not None and (touch := cell.first_touch(q_c)) is not None:
        raise InputError(f"on the way {touch}, {touch.row * robot.t_ipo:.1f} s from its begin; try another --seed, or "
                         "begin from another posture ([joints] home)", field="motion")
    if not clear_of_obstacles(robot, q_c, workspace).all():
        raise InputError("on its way between two postures the planned motion comes too near to floor or base column; "
                         "try another --seed, or a lower --z-min", field="motion")


def plan_two_step(robot: Robot, rng: np.random.Generator, *, points: int = 10, candidates: int = 400,
                  workspace: Workspace | None = None) -> Program:
    """Chooses operating points and writes the moves.

    The points are picked one by one out of random postures so that the gravitational torques g(q) and the moments of
    inertia M_ii(q) at all of them, taken as measurements of the base parameters, determine these best (determinant of
    the information matrix).

    Args:
        robot: the arm.
        rng: draws the postures.
        points: operating points.
        candidates: random postures to choose from.
        workspace: keeps the arm off floor and column; one in proportion to its reach if None.

    Raises:
        InputError: no postures within limits and workspace.
    """
    n = robot.n
    v_max, a_max = finite_limits(robot)
    amplitude = np.minimum(0.12, 0.08 * (robot.q_max - robot.q_min))
    workspace = workspace or Workspace.of(robot)
    postures = _postures(robot, rng, candidates, amplitude, workspace)
    room = workspace.on_the_way(robot)
    chosen = _telling(robot, postures, points, room, amplitude)
    first = postures[chosen[0]]
    speeds = np.array(FRICTION_SPEEDS)[:, None] * v_max
    # Long enough for half a second at constant speed, if the posture permits.
    reach = np.minimum(0.25 * speeds + 0.5 * speeds**2 / (0.5 * a_max), 4.0 * amplitude)
    reach = np.maximum(reach, np.minimum(0.02, np.minimum(first - robot.q_min, robot.q_max - first)))
    reach = np.minimum(reach, _farthest(robot, first, reach.max(axis=0), room))
    moves = [Move(k, i + 1, purpose, float(amplitude[i]), speed * float(v_max[i]), rise * float(a_max[i]), repeats)
             for k in range(len(chosen)) for i in range(n)
             for purpose, speed, rise, repeats in (("gravity", 0.06, 0.3, 1), ("inertia", 0.5, 0.5, 3))]
    for i in range(n):
        moves += [Move(0, i + 1, "friction", float(distance), float(v), float(0.5 * a_max[i]), 1)
                  for distance, v in zip(reach[:, i], speeds[:, i], strict=True)]
    return Program(postures[chosen], tuple(moves))


def _telling(robot: Robot, postures: Array, count: int, room: Workspace, amplitude: Array) -> list[int]:
    """Which of postures ``(m, n)`` determine the base parameters best, each in reach of the one before.

    Each axis can go by its amplitude ``(n,)`` both ways from there.
    """
    base = base_parameters(robot.pinocchio)
    rows = observation_rows(robot, base, postures)
    size = np.linalg.norm(rows.reshape(-1, rows.shape[2]), axis=0)
    rows = rows / np.where(size > 0, size, 1.0)
    gram = rows.transpose(0, 2, 1) @ rows
    information = 1e-6 * np.eye(rows.shape[2])
    chosen: list[int] = []
    for _ in range(min(count, len(postures))):
        remaining = [i for i in range(len(rows)) if i not in chosen]
        gains = np.linalg.slogdet(information + gram[remaining])[1]
        last = postures[chosen[-1]] if chosen else robot.home
        best = next((remaining[k] for k in np.argsort(gains, kind="stable")[::-1]
                     if _reached(robot, last, postures[remaining[k]], amplitude, room)), None)
        if best is None:
            break
        chosen.append(best)
        information += gram[best]
    if len(chosen) < 2:
        raise InputError("no way between operating points keeps off the arm itself, floor and column, and what stands "
                         "in the cell; give another [joints] home to begin from", field="workspace")
    return chosen


def _reached(robot: Robot, here: Array, there: Array, amplitude: Array, room: Workspace) -> bool:
    """Whether the straight way of the joints to a posture ``(n,)`` [rad], and the moves about it, stay in the room."""
    path = here + np.linspace(0.0, 1.0, _ON_A_WAY)[:, None] * (there - here)
    return (bool(clear_of_obstacles(robot, np.vstack([path, _turns(there, amplitude)]), room).all())
            and (room.cell is None or room.cell.touch_between(here, there) is None))


def _farthest(robot: Robot, centre: Array, wanted: Array, room: Workspace) -> Array:
    """How far each axis can go both ways from a posture: all that is wanted ``(n,)`` [rad], a half or a quarter."""
    half, whole = (clear_of_obstacles(robot, _turns(centre, share * wanted), room).reshape(2, -1).all(axis=0)
                  for share in (0.5, 1.0))
    return np.where(whole, wanted, np.where(half, 0.5 * wanted, 0.25 * wanted))


def _turns(centre: Array, moved: Array) -> Array:
    """Postures ``(2 n, n)`` at the ends of each axis's motion by ``moved (n,)`` [rad] both ways from ``centre``."""
    return np.vstack([centre + np.diag(moved), centre - np.diag(moved)])


def observation_rows(robot: Robot, base: BaseParameters, q: Array) -> Array:
    """Rows ``(m, 2 n, b)`` of g_i(q) and M_ii(q) as linear forms of the base parameters, [G] (6).

    Args:
        robot, base: the arm, and base parameters of the rigid body.
        q: postures ``(m, n)`` [rad].
    """
    m, n = q.shape
    unit = np.tile(np.vstack([np.zeros(n), np.eye(n)]), (m, 1))
    W = full_regressor(robot.pinocchio, np.repeat(q, n + 1, axis=0), np.zeros_like(unit), unit, base.independent)
    W = W.reshape(m, n + 1, n, -1)
    joints = np.arange(n)
    return np.concatenate([W[:, 0], W[:, joints + 1, joints] - W[:, 0]], axis=1)


def _postures(robot: Robot, rng: np.random.Generator, count: int, amplitude: Array, workspace: Workspace) -> Array:
    room = 4.0 * amplitude
    low = np.maximum(robot.q_min + room, -np.pi)
    high = np.minimum(robot.q_max - room, np.pi)
    postures: list[Array] = []
    tries = 40 * count
    while len(postures) < count and tries > 0:
        q = rng.uniform(low, high, (min(count - len(postures), tries), robot.n))
        tries -= len(q)
        around = np.stack([q, q + amplitude, q - amplitude], axis=1)
        clear = clear_of_obstacles(robot, around.reshape(-1, robot.n), workspace).reshape(-1, 3).all(axis=1)
        postures += [three[0] for three in around[clear]
                     if workspace.cell is None or workspace.cell.first_touch(three) is None]
    if len(postures) < 2:
        raise InputError("no operating points within limits and workspace; relax the workspace", field="workspace")
    return np.array(postures)
