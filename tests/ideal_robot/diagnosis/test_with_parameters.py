"""What a diagnosis makes of a model's parameters: an arm that can be, and one joint is an arm too."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.diagnosis.channels.frames import frames_along
from ideal_robot.diagnosis.statistics.with_parameters import with_parameters, with_possible_inertias
from ideal_robot.diagnosis.validation.refit import _moved
from ideal_robot.dynamics.consistency import pseudo_inertia
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot

OWN = Path(__file__).resolve().parents[3] / "examples" / "own_robot.urdf"


def test_a_refitted_model_has_bodies_that_can_be() -> None:
    """Its mass matrix was not positive definite, so that no path could be corrected with it."""
    robot = Robot.load("kr6")
    nominal = Model.nominal(robot)
    count = nominal.base.count
    std = np.zeros(len(nominal.covariance))
    std[:count] = 0.3 * np.abs(nominal.base_values) + 0.05
    model = dataclasses.replace(nominal, covariance=np.diag(std**2))
    refitted = with_parameters(model, std * np.random.default_rng(3).normal(size=len(std)))
    possible = with_possible_inertias(refitted, nominal.consistent)

    def smallest(one: Model) -> float:
        return min(float(np.linalg.eigvalsh(pseudo_inertia(one.consistent[10 * i: 10 * i + 10]))[0]) for i in range(6))

    assert smallest(refitted) < 0 < smallest(possible)
    M = pin.crba(possible.dynamics, possible.dynamics.createData(), robot.home)
    assert np.linalg.eigvalsh(np.triu(M) + np.triu(M, 1).T)[0] > 0
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 5, 6))
    np.testing.assert_allclose(possible.inverse_dynamics(q, qd, qdd), refitted.inverse_dynamics(q, qd, qdd), atol=1e-6)


@pytest.mark.filterwarnings("error")
def test_a_fit_far_from_any_body_keeps_near_to_bodies_that_can_be() -> None:
    """Sizes were taken of the fit itself: the root of a negative inertia."""
    nominal = Model.nominal(Robot.load("kr6"))
    count = nominal.base.count
    std = np.zeros(len(nominal.covariance))
    std[:count] = 3.0 * np.abs(nominal.base_values) + 3.0
    fitted = with_parameters(dataclasses.replace(nominal, covariance=np.diag(std**2)), -std)
    inertia = [np.trace(pseudo_inertia(fitted.consistent[10 * i: 10 * i + 10])[:3, :3]) for i in range(6)]
    assert min(inertia) < 0.0
    full = with_possible_inertias(fitted, nominal.consistent).consistent
    assert all(np.linalg.eigvalsh(pseudo_inertia(full[10 * i: 10 * i + 10]))[0] > 0.0 for i in range(6))


@pytest.mark.filterwarnings("error")
def test_a_parameter_that_moves_nothing_has_not_moved() -> None:
    """Its deviation was the square of a number beyond the largest that there is."""
    nominal = Model.nominal(Robot.load("kr6"))
    change = np.ones(len(nominal.covariance))
    W = np.zeros((20, len(change)))
    W[:, 3] = 1.0
    (moved,) = _moved(nominal, change, W, 1e-3)
    assert moved.name == nominal.parameters[3].name


def test_frames_of_a_single_joint() -> None:
    """Pinocchio's Jacobian has one dimension then: a turntable with a measured tool could not be diagnosed."""
    frames = frames_along(Robot.load(OWN), np.array([[0.0], [0.5]]))
    np.testing.assert_allclose(frames.axis[:, 0], [[0, 0, 1], [0, 0, 1]])
