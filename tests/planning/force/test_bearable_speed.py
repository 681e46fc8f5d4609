"""The stiffer a contact, the slower a surface of unknown shape is passed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.robots.robot import Robot
from planning.force.bearable_speed import (
    SLOWEST,
    STEPS,
    TIMES,
    bearable_speed,
    forecast_error,
    left_beside,
    worst_force,
)
from planning.force.contact import ContactSettings, most_force
from scenes.arms import model_at

T, ERRORS, LEFT = 0.012, (0.3, 5e-4, 0.3), 3e-5


def contact(elasticity: float, force: float = 20.0) -> ContactSettings:
    return ContactSettings(force=force, elasticity=elasticity, position_noise=5e-6)


@pytest.mark.parametrize("elasticity", [1e3, pytest.param(1e6, marks=pytest.mark.slow)])
def test_what_a_forecast_costs_grows_with_speed_stiffness_and_lateness(elasticity: float) -> None:
    errors = [forecast_error(contact(elasticity), ERRORS, speed, T, LEFT) for speed in (0.1, 0.2, 0.4)]
    assert (np.diff(errors) > 0.0).all()
    assert forecast_error(contact(2.0 * elasticity), ERRORS, 0.1, T, LEFT) > errors[0]
    assert forecast_error(contact(elasticity), ERRORS, 0.1, T, LEFT, answered=0.1) > errors[0]


@pytest.mark.parametrize("force", [20.0, 200.0])
@pytest.mark.parametrize("elasticity", [4e3, 1.3e5, 1e6])
def test_a_speed_that_would_do_is_the_largest_one(elasticity: float, force: float) -> None:
    settings, room = contact(elasticity, force), most_force(force) - force
    speed = bearable_speed(settings, ERRORS, 0.2, T, LEFT)
    if speed:
        assert TIMES * forecast_error(settings, ERRORS, speed, T, LEFT) <= room
    if speed < 0.2:
        faster = STEPS * max(speed, SLOWEST / STEPS)
        assert TIMES * forecast_error(settings, ERRORS, faster, T, LEFT) > room
    assert (speed == 0.2) or elasticity > 4e3
    assert (speed == 0.0) == (elasticity == 1e6)


@pytest.mark.parametrize(("kappa", "sigma", "error"), [(1.0, 0.06, 3.0), (1.2, 0.1, 0.5), (1.0, 0.5, 2.0)])
def test_the_surface_bears_more_than_the_worst_force_once_in_16000_times(kappa: float, sigma: float, error: float
                                                                          ) -> None:
    """Whatever a sensor's gain can be by what is known of it, together with what a forecast leaves."""
    rng, count = np.random.default_rng(3), 2_000_000
    true = (kappa + sigma * rng.standard_normal(count)) * 20.0 + kappa * error * rng.standard_normal(count)
    assert 0.5 * count / 32000 < np.sum(true > worst_force(20.0, (kappa, sigma), error)) < 2.0 * count / 32000


def test_the_less_is_known_of_a_gain_the_slower_a_surface_is_passed() -> None:
    speeds = [bearable_speed(contact(8e4), ERRORS, 0.2, T, LEFT, ratio=(1.0, sigma)) for sigma in (0.0, 0.1, 0.2, 0.5)]
    assert speeds[0] > speeds[2] > 0.0 == speeds[3]
    assert (np.diff(speeds) <= 0.0).all()


@pytest.mark.parametrize("seed", range(2))
def test_what_friction_leaves_is_how_far_the_tip_moves_as_it_turns_round(seed: int) -> None:
    """Behind gears that it bends one way and then the other: the arm's own kinematics, many draws."""
    rng, robot = np.random.default_rng(seed), Robot.load("kr6")
    model = model_at("shipped", robot)
    q, fk = robot.home + 0.2 * rng.standard_normal(robot.n), robot.fk()
    d = rng.standard_normal(3)
    d /= np.linalg.norm(d)
    bends = model.noise_std / model.gears.rigid_if_unknown
    moved = [d @ (fk(q + b).translation - fk(q - b).translation) for b in bends * rng.standard_normal((2000, robot.n))]
    assert left_beside(model, robot, q, d) == pytest.approx(np.std(moved), rel=0.06)
    assert left_beside(replace(model, gears=None), robot, q, d) == 0.0


def test_a_slower_job_is_asked_for_no_other_speed() -> None:
    settings = replace(contact(4e3), noise=1.0)
    assert bearable_speed(settings, ERRORS, 0.004, T, LEFT) == 0.004
