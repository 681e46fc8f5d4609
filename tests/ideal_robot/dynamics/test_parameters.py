"""Base parameters reproduce the torques of any inertias, and fewer of them would not."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.dynamics import (
    BaseParameters,
    base_parameters,
    full_regressor,
    link_parameters,
    regressor,
    torques,
    with_link_parameters,
)
from ideal_robot.dynamics.consistent_inertias import consistent_parameters, pseudo_inertia
from ideal_robot.errors import IdealRobotError


def prismatic_and_fixed() -> pin.Model:
    text = """<robot name="gantry"><link name="base"/>
      <link name="slide"><inertial><mass value="3"/><origin xyz="0.1 0 0.2"/>
        <inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
      <link name="bracket"><inertial><mass value="1"/><origin xyz="0 0.3 0"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <link name="arm"><inertial><mass value="2"/><origin xyz="0.4 0 0"/>
        <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="z" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
      <joint name="f" type="fixed"><parent link="slide"/><child link="bracket"/><origin xyz="0.2 0 0"/></joint>
      <joint name="turn" type="revolute"><parent link="bracket"/><child link="arm"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    return pin.buildModelFromXML(text)


@pytest.fixture(params=["six_axes", "prismatic_and_fixed"])
def model(request: pytest.FixtureRequest) -> pin.Model:
    return pin.buildSampleModelManipulator() if request.param == "six_axes" else prismatic_and_fixed()


def motion(model: pin.Model, count: int = 50) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = np.random.default_rng(7).normal(size=(3, count, model.nv))
    return q, qd, qdd


def test_regressor_gives_the_torques_of_newton_and_euler(model: pin.Model) -> None:
    q, qd, qdd = motion(model)
    by_regressor = regressor(model, q, qd, qdd) @ link_parameters(model)
    np.testing.assert_allclose(by_regressor, torques(model, q, qd, qdd), atol=1e-11)


def test_regressor_is_pinocchios(model: pin.Model) -> None:
    q, qd, qdd = motion(model)
    data = model.createData()
    theirs = np.array([pin.computeJointTorqueRegressor(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(regressor(model, q, qd, qdd), theirs, atol=1e-11)
    some = [3, 11, 12 * model.nv - 1, 10 * model.nv]
    all_columns = full_regressor(model, q, qd, qdd)
    np.testing.assert_array_equal(full_regressor(model, q, qd, qdd, some), all_columns[:, :, some])


def test_grouped_parameters_give_the_same_torques(model: pin.Model) -> None:
    base = base_parameters(model)
    rng = np.random.default_rng(3)
    W = full_regressor(model, *motion(model))
    for _ in range(5):
        full = rng.normal(size=12 * model.nv)
        np.testing.assert_allclose(W[:, :, list(base.independent)] @ base.of(full), W @ full, atol=1e-8)


def test_base_is_as_small_as_the_rank_of_the_regressor(model: pin.Model) -> None:
    base = base_parameters(model)
    W = full_regressor(model, *motion(model, 400)).reshape(-1, 12 * model.nv)
    assert base.count == np.linalg.matrix_rank(W, tol=1e-8 * np.linalg.norm(W, 2))


def test_gravitational_parameters_are_those_that_show_at_rest(model: pin.Model) -> None:
    base = base_parameters(model)
    q, qd, qdd = motion(model)
    at_rest = full_regressor(model, q, 0 * qd, 0 * qdd)[:, :, list(base.independent)]
    shown = np.abs(at_rest).max(axis=(0, 1)) > 1e-9
    np.testing.assert_array_equal(shown, base.gravitational)
    assert 0 < shown.sum() < base.count


def test_nearest_full_parameters_have_the_wanted_base_parameters(model: pin.Model) -> None:
    base = base_parameters(model)
    start = np.concatenate([link_parameters(model), np.zeros(2 * model.nv)])
    wanted = base.of(start) * 1.1
    full = base.nearest_full(wanted, start)
    np.testing.assert_allclose(base.of(full), wanted, atol=1e-10)
    np.testing.assert_allclose(base.nearest_full(base.of(start), start), start, atol=1e-10)


def test_impossible_inertias_still_act_linearly(model: pin.Model) -> None:
    q, qd, qdd = motion(model)
    parameters = np.random.default_rng(5).normal(size=10 * model.nv)
    expected = regressor(model, q, qd, qdd) @ parameters
    np.testing.assert_allclose(torques(with_link_parameters(model, parameters), q, qd, qdd), expected, atol=1e-9)


def test_words_name_what_is_grouped() -> None:
    base = base_parameters(prismatic_and_fixed())
    words = dict(zip(base.names, base.words(), strict=True))
    assert words["m_1"].startswith("m_1")
    assert "m_2" in words["m_1"]
    assert "Ia_2" in words["Iyy_2"]


def test_axes_a_degree_off_parallel_leave_a_base_that_motions_tell() -> None:
    # Two axes that are parallel but for a turn of two degrees across them: what tells Ixx and Izz of the last link
    # apart is a thousandth of them, and must not stand in the base for a rotor, which shows plainly.
    model, parent = pin.Model(), 0
    for k, (kind, turn) in enumerate(((pin.JointModelRZ, 0.0), (pin.JointModelRY, 0.3), (pin.JointModelRY, 0.03))):
        place = pin.SE3(pin.utils.rotate("z", turn), np.array([0.1, 0.05, 0.3]) if k else np.zeros(3))
        parent = model.addJoint(parent, kind(), place, f"joint_{k + 1}")
    base = base_parameters(model)
    rng = np.random.default_rng(1)
    q, qd, qdd = rng.uniform(-3.0, 3.0, (200, 3)), rng.normal(size=(200, 3)), rng.normal(size=(200, 3))
    W = full_regressor(model, q, qd, qdd).reshape(600, 36)
    columns = W[:, list(base.independent)]
    size = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    assert size[0] < 100.0 * size[-1]
    full = rng.normal(size=36)
    np.testing.assert_allclose(columns @ base.of(full), W @ full, atol=1e-10)


# Physically possible parameters: unchanged where possible already, nearest where not.

def arm() -> tuple[BaseParameters, np.ndarray]:
    """Base and full parameters of an arm whose bodies can be."""
    model = pin.buildSampleModelManipulator()
    for i in range(1, model.njoints):
        model.inertias[i] = pin.Inertia(5.0 / i, np.array([0.05, 0.02, 0.1]), 0.05 * np.eye(3))
    return base_parameters(model), np.concatenate([link_parameters(model), np.full(6, 0.3), np.zeros(6)])


def test_pseudo_inertia_of_a_point_mass() -> None:
    link = pin.Inertia(2.0, np.array([0.1, 0.2, 0.3]), np.zeros((3, 3))).toDynamicParameters()
    r = np.array([0.1, 0.2, 0.3, 1.0])
    np.testing.assert_allclose(pseudo_inertia(link), 2.0 * np.outer(r, r), atol=1e-12)


def test_possible_parameters_stay() -> None:
    base, full = arm()
    result = consistent_parameters(base, base.of(full), 1e-6 * np.eye(base.count), full)
    assert result.was_consistent
    np.testing.assert_allclose(base.of(result.full), base.of(full), atol=1e-4)


def test_impossible_parameters_become_possible_and_stay_near() -> None:
    base, full = arm()
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
    base, full = arm()
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

    monkeypatch.setattr("clarabel.DefaultSolver", Panics)
    base, full = arm()
    with pytest.raises(IdealRobotError, match="Eigval error"):
        consistent_parameters(base, base.of(full), 1e-6 * np.eye(base.count), full)
