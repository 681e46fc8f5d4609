"""Every reason to stop is noticed and said with value, limit and remedy."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.force.stop_conditions import EmergencyStopError, StopConditions, StopLimits


@pytest.fixture
def watch() -> StopConditions:
    return StopConditions(Robot.load("kr6"), StopLimits(force=50.0, lost=0.1))


def motion(robot: Robot, speed: float, acceleration: float = 0.0, joint: int = 1) -> np.ndarray:
    t = robot.t_ipo * np.arange(12)
    q = np.tile(robot.home, (12, 1))
    q[:, joint] += speed * t + 0.5 * acceleration * t * (t - t[-1])
    return q


def test_what_is_allowed_passes(watch: StopConditions) -> None:
    watch.force(1.0, 49.0)
    watch.contact(1.0, 0.95)
    watch.approach(1.0, 0.01, 0.05)
    watch.command(1.0, motion(Robot.load("kr6"), 0.5))


@pytest.mark.parametrize(("call", "cause", "text"), [
    (lambda w, r: w.force(1.0, 51.0), "force", "51.0 N is above the limit 50.0 N"),
    (lambda w, r: w.force(1.0, float("nan")), "force", "nan N is above the limit 50.0 N"),
    (lambda w, r: w.contact(1.0, 0.85), "contact", "150 ms ago, allowed are 100 ms"),
    (lambda w, r: w.approach(1.0, 0.06, 0.05), "contact", "no contact within 50 mm"),
    (lambda w, r: w.command(1.0, motion(r, 1.1 * r.v_max[1])), "velocity", "joint 2 would need velocity"),
    (lambda w, r: w.command(1.0, motion(r, 0.0, 1.1 * r.a_max[1])), "acceleration", "joint 2 would need acceleration"),
    (lambda w, r: w.command(1.0, np.tile(r.q_max + 0.01, (5, 1))), "position", "would need position"),
])
def test_what_is_not_allowed_stops(watch: StopConditions, call: object, cause: str, text: str) -> None:
    with pytest.raises(EmergencyStopError, match=text.replace(".", r"\.")) as caught:
        call(watch, Robot.load("kr6"))  # type: ignore[operator]
    assert caught.value.cause == cause
    assert "stopped at t = 1.000 s" in str(caught.value)


@pytest.mark.parametrize("share", [1.0, 0.4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(6))
def test_joints_may_use_their_share_of_the_limits_and_no_thousandth_more(joint: int, sign: float, share: float) -> None:
    robot = Robot.load("kr6")
    watch = StopConditions(robot, StopLimits(share=share))
    speed, acceleration = sign * share * robot.v_max[joint], sign * share * robot.a_max[joint]
    for q_d, cause in ((lambda k: motion(robot, k * speed, joint=joint), "velocity"),
                       (lambda k: motion(robot, 0.0, k * acceleration, joint), "acceleration")):
        watch.command(1.0, q_d(0.999))
        with pytest.raises(EmergencyStopError) as caught:
            watch.command(1.0, q_d(1.001))
        assert caught.value.cause == cause
    limit = (robot.q_max if sign > 0 else robot.q_min)[joint]
    q = np.tile(robot.home, (5, 1))
    q[:, joint] = limit - 1e-4 * sign
    watch.command(1.0, q)
    q[3, joint] = limit + 1e-4 * sign
    with pytest.raises(EmergencyStopError, match="position"):
        watch.command(1.0, q)


def test_limits_have_to_make_sense() -> None:
    with pytest.raises(InputError, match="positive"):
        StopLimits(force=0.0)
