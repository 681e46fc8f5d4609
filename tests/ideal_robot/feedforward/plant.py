"""A KR 15-like closed loop with round numbers, and motions for it: what the feedforward tests try things on."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.loop.loop_model import LoopModel, low_pass_taps, velocity_grid
from ideal_robot.robots.robot import Robot

T = 0.012
ROBOT = Robot.load("kr15")


def plant(*, inertia: float = 1.0, friction: float = 1.0, stiffness: float = 1.0, delay: int = 1,
          elastic: bool = True) -> LoopModel:
    """The loop, or one whose inertias, friction and stiffness are wrong by factors."""
    chain = chain_of(ROBOT.pinocchio)
    n = ROBOT.n
    grid = velocity_grid(ROBOT.v_max)
    dry = np.array([90.0, 100.0, 55.0, 8.0, 8.0, 4.0])
    sliding = friction * (dry + 0.5 * dry * np.sqrt(grid))
    k = stiffness * np.array([4e5, 5e5, 2.5e5, 4e4, 4e4, 2e4])
    k_p = np.array([4500.0, 3500.0, 1400.0, 100.0, 95.0, 26.0])
    return LoopModel(
        chain=chain._replace(mass=inertia * chain.mass, inertia=inertia * chain.inertia),
        rotor_inertia=np.array(ROBOT.rotor_inertia), friction_velocity=grid,
        friction_torque=np.stack([sliding, sliding]), friction_load=np.zeros(n), friction_bend=np.full(n, 3e-4),
        offset=np.zeros(n), stiffness=k if elastic else np.full(n, np.inf), damping=1.5e-3 * k, k_v=np.full(n, 20.0),
        k_ff=np.full(n, 0.93), k_p=k_p, k_i=k_p / 0.05, t_filter=np.full(n, 1e-3),
        command_filter=low_pass_taps(1.5e-3, 2, 0.002, n), delay=delay, t_ipo=T, t_position=0.002, t_velocity=0.0005,
        tau_max=np.array(ROBOT.tau_max), q_min=np.array(ROBOT.q_min), q_max=np.array(ROBOT.q_max),
        v_max=np.array(ROBOT.v_max))


def motion(amplitude: float = 0.2, duration: float = 1.6, lead: int = 45, tail: int = 25) -> Array:
    """Desired positions ``(N, n)``: rest, every joint once around a closed curve, rest."""
    t = np.arange(round(duration / T)) * T / duration
    phase = 2 * np.pi * t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
    shape = np.column_stack([np.sin(phase), 1 - np.cos(phase), np.sin(phase), 1 - np.cos(phase), np.sin(phase),
                             1.5 * np.sin(phase)])
    moved = ROBOT.home + amplitude * shape
    return np.concatenate([np.tile(moved[0], (lead, 1)), moved, np.tile(ROBOT.home, (tail, 1))])


def commands(feedforward: Feedforward, q_d: Array, n_d: int | None = None) -> Array:
    """What a feedforward commands along a path, with a horizon of ``n_d`` rows if not its own."""
    if n_d is None:
        return feedforward.along(q_d)
    state, q_c = feedforward.init(q_d[0]), np.empty_like(q_d)
    ahead = np.concatenate([q_d, np.tile(q_d[-1], (n_d, 1))])
    for k in range(len(q_d)):
        q_c[k], state = feedforward.step(state, ahead[k : k + n_d])
    return q_c


def rms(error: Array) -> float:
    """Root mean square over everything."""
    return float(np.sqrt(np.mean(error**2)))
