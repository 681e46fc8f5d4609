"""Laws that hold for every friction model."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.friction import LAWS, Arctan, CubeRoot, FrictionModel, PerJointFriction, Stribeck, ViscousCoulomb
from ideal_robot.friction.presliding import sliding_direction


def example(law: type[FrictionModel], refined: bool, n: int = 3) -> FrictionModel:
    rng = np.random.default_rng(11)
    shape = [[np.sqrt(low * high)] * n for low, high in law.shape_bounds] + [[1e-3] * n] * refined
    return law(rng.uniform(0.5, 2.0, (len(law.coefficient_names) + refined, n)), np.array(shape).reshape(-1, n),
               presliding=refined, loaded=refined)


@pytest.fixture(params=[(key, refined) for key in LAWS.names() for refined in (False, True)], ids=str)
def law(request: pytest.FixtureRequest) -> FrictionModel:
    key, refined = request.param
    return example(LAWS.get(key), refined)


def test_shape_of_torque_follows_velocity(law: FrictionModel) -> None:
    for shape in [(3,), (5, 3), (2, 4, 3)]:
        assert law.torque(np.ones(shape)).shape == shape


def test_brakes_and_is_silent_at_rest(law: FrictionModel) -> None:
    qd = np.random.default_rng(1).normal(size=(200, 3))
    assert np.all(law.torque(qd, load=np.ones_like(qd)) * qd > 0)
    np.testing.assert_array_equal(law.torque(np.zeros((4, 3))), 0.0)


def test_regressor_is_the_torque(law: FrictionModel) -> None:
    qd = np.random.default_rng(2).normal(size=(50, 3))
    load = np.random.default_rng(3).normal(size=(50, 3))
    by_regressor = np.einsum("knm,mn->kn", law.regressor(qd, load), law.coefficients)
    np.testing.assert_allclose(by_regressor, law.torque(qd, load), atol=1e-12)


def test_survives_the_model_file(law: FrictionModel) -> None:
    joints = [type(law)(law.coefficients[:, [j]], law.shape[:, [j]], presliding=law.presliding, loaded=law.loaded)
              for j in range(3)]
    friction = PerJointFriction(joints)
    qd = np.linspace(-2, 2, 30).reshape(10, 3)
    np.testing.assert_array_equal(PerJointFriction.from_dict(friction.to_dict()).torque(qd), friction.torque(qd))
    np.testing.assert_allclose(friction.torque(qd), law.torque(qd), atol=1e-14)


def test_parameters_cannot_be_changed(law: FrictionModel) -> None:
    with pytest.raises(ValueError):
        law.coefficients[0, 0] = 1.0


def test_the_four_equations_of_the_paper() -> None:
    v = np.array([[-0.8], [0.3]])
    s = np.sign(v)
    np.testing.assert_allclose(ViscousCoulomb([[2.0], [3.0]]).torque(v), 2 * v + 3 * s)
    np.testing.assert_allclose(CubeRoot([[2.0], [3.0], [4.0]]).torque(v), 2 * v + 3 * s + 4 * np.cbrt(v))
    np.testing.assert_allclose(Arctan([[2.0], [3.0], [4.0]], [[5.0]]).torque(v), 2 * v + 3 * s + 4 * np.arctan(5 * v))
    np.testing.assert_allclose(Stribeck([[2.0], [3.0], [4.0]], [[5.0]]).torque(v),
                               2 * v + 3 * s + 4 * np.exp(-5 * np.abs(v)) * s)


def test_presliding_turns_over_along_a_distance_and_remembers_at_rest() -> None:
    q = np.concatenate([np.linspace(0, 0.1, 101), np.full(50, 0.1), np.linspace(0.1, 0.0, 101)])[:, None]
    qd = np.gradient(q, axis=0)
    z = sliding_direction(q, qd, np.array([0.01]))
    assert np.all(np.abs(z) <= 1.0)
    np.testing.assert_allclose(z[100:151], 1.0, atol=1e-4)
    one_distance_back = 151 + 10
    # A twentieth of the distance to leave the noise band in each direction.
    np.testing.assert_allclose(z[one_distance_back], -1.0 + 2.0 * np.exp(-0.9), atol=1e-3)
    np.testing.assert_allclose(z[-1], -1.0, atol=1e-3)


def test_noise_at_rest_does_not_wear_the_memory_down() -> None:
    rng = np.random.default_rng(0)
    q = np.concatenate([np.linspace(0, 0.1, 100), 0.1 + 1e-4 * rng.normal(size=5000)])[:, None]
    z = sliding_direction(q, np.ones_like(q), np.array([0.01]))
    assert z[-1] > 0.9


def test_presliding_does_not_depend_on_speed() -> None:
    slow = np.sin(np.linspace(0, 12, 4001))[:, None]
    fast = slow[::4]
    z = sliding_direction(slow, np.ones_like(slow), np.array([0.05]))[::4]
    np.testing.assert_allclose(z, sliding_direction(fast, np.ones_like(fast), np.array([0.05])), atol=0.02)


def test_gross_sliding_is_the_law_without_memory() -> None:
    q = np.linspace(0, 5, 500)[:, None]
    qd = np.full_like(q, 0.7)
    with_memory = example(CubeRoot, True, n=1)
    np.testing.assert_allclose(with_memory.torque(qd, q=q), with_memory.torque(qd), atol=1e-12)
