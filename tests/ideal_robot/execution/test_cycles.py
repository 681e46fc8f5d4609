"""A path at the cycles of a controller."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.execution.cycles import path_at_cycles
from ideal_robot.robots.robot import Robot

KR6 = Robot.load("kr6")


@pytest.mark.parametrize("duration", [1e-3, 0.5, 0.504, 0.5101])
def test_the_end_of_a_path_is_reached_wherever_in_a_cycle_it_lies(duration: float) -> None:
    """A path within one cycle was left out altogether, and none of its limits were looked at."""
    t = np.linspace(0.0, duration, 200)
    q = KR6.home + 0.05 * (t / duration)[:, None] ** 2
    times, positions = path_at_cycles(t, q, KR6, rest=0.12)
    np.testing.assert_allclose(np.diff(times), KR6.t_ipo)
    np.testing.assert_allclose(positions[0], q[0])
    np.testing.assert_allclose(positions[-1], q[-1], atol=1e-12)
