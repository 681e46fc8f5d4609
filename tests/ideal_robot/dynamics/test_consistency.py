"""Physically possible parameters: unchanged where possible already, nearest where not."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.dynamics import base_parameters, link_parameters
from ideal_robot.dynamics.consistency import consistent_parameters, pseudo_inertia
from ideal_robot.errors import IdealRobotError


def arm() -> tuple[pin.Model, np.ndarray]:
    model = pin.buildSampleModelManipulator()
    for i in range(1, model.njoints):
        model.inertias[i] = pin.Inertia(5.0 / i, np.array([0.05, 0.02, 0.1]), 0.05 * np.eye(3))
    return model, np.concatenate([link_parameters(model), np.full(6, 0.3), np.zeros(6)])


def test_pseudo_inertia_of_a_point_mass() -> None:
    link = pin.Inertia(2.0, np.array([0.1, 0.2, 0.3]), np.zeros((3, 3))).toDynamicParameters()
    r = np.array([0.1, 0.2, 0.3, 1.0])
    np.testing.assert_allclose(pseudo_inertia(link), 2.0 * np.outer(r, r), atol=1e-12)


def test_possible_parameters_stay() -> None:
    model, full = arm()
    base = base_parameters(model)
    covariance = 1e-6 * np.eye(base.count)
    result = consistent_parameters(base, base.of(full), covariance, full)
    assert result.was_consistent
    np.testing.assert_allclose(base.of(result.full), base.of(full), atol=1e-4)


def test_impossible_parameters_become_possible_and_stay_near() -> None:
    model, full = arm()
    base = base_parameters(model)
    rng = np.random.default_rng(1)
    std = 0.3 * np.abs(base.of(full)) + 0.05
    values = base.of(full) + std * rng.normal(size=base.count)
    result = consistent_parameters(base, values, np.diag(std**2), full)
    assert not result.was_consistent
    for i in range(6):
        assert np.linalg.eigvalsh(pseudo_inertia(result.full[10 * i : 10 * i + 10]))[0] > 0
    assert np.all(result.full[60:66] >= -1e-9)
    # The truth is possible too, so what is nearest cannot be farther away than the truth is.
    assert np.linalg.norm(result.deviation) <= np.linalg.norm((base.of(full) - values) / std) + 0.1


def test_precise_data_leave_what_they_cannot_show_at_its_nominal_value() -> None:
    """With one joint only the sum of link and rotor inertia shows; the rotor once drifted from 1.0 to 0.02 kg m²."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint_1")
    model.appendBodyToJoint(joint, pin.Inertia(10.0, np.zeros(3), np.diag([1.0, 1.0, 1.0])), pin.SE3.Identity())
    base = base_parameters(model)
    nominal = np.concatenate([link_parameters(model), [1.0], [0.0]])
    values = base.of(nominal)
    for precision in (1e-1, 1e-3, 1e-5):
        covariance = np.diag((precision * np.maximum(np.abs(values), 1e-3)) ** 2)
        full = consistent_parameters(base, values, covariance, nominal).full
        np.testing.assert_allclose(full, nominal, atol=2e-3)


def test_a_covariance_that_is_none_is_said() -> None:
    """A URDF with inertias of 1e59 kg m² ended in a traceback of the factorisation (fuzz, seed 34932)."""
    model, full = arm()
    base = base_parameters(model)
    covariance = np.eye(base.count)
    covariance[0, 1] = covariance[1, 0] = 5.0
    with pytest.raises(IdealRobotError, match="no usable standard deviations"):
        consistent_parameters(base, base.of(full), covariance, full)


class PanicException(BaseException):
    """As PyO3 names what a panic of Rust becomes."""


def test_a_solver_that_panics_is_a_result_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fuzzed recording had one fit with which eigenvalues of an iterate did not converge (seed 88338)."""
    class Panics:
        def __init__(self, *_: object) -> None:
            pass

        def solve(self) -> None:
            raise PanicException("Eigval error: Eigen(1)")

    monkeypatch.setattr("ideal_robot.dynamics.consistency.clarabel.DefaultSolver", Panics)
    model, full = arm()
    base = base_parameters(model)
    with pytest.raises(IdealRobotError, match="Eigval error"):
        consistent_parameters(base, base.of(full), 1e-6 * np.eye(base.count), full)
