"""Friction from constant-velocity runs, and friction that falls while the gear warms up."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.friction import LAWS, Arctan, CubeRoot, FrictionModel, ViscousCoulomb
from ideal_robot.friction.warm_up import fit_warm_up
from ideal_robot.identification.friction_runs import choose_law, fit_law

SPEEDS = np.concatenate([s * np.geomspace(0.02, 2.0, 15) for s in (-1.0, 1.0)])


def example(law: type[FrictionModel]) -> FrictionModel:
    shape = {"arctan": [[6.0]], "stribeck": [[20.0]], "bell_stribeck": [[20.0]]}.get(law.key)
    return law(np.array([[4.0], [10.0], [5.0], [9.0]])[: len(law.coefficient_names)], shape)


@pytest.mark.parametrize("law", [law for _, law in LAWS], ids=LAWS.names())
def test_every_law_is_found_again_within_its_deviations(law: type[FrictionModel]) -> None:
    rng = np.random.default_rng(3)
    what = example(law)
    fit = fit_law(law, SPEEDS, what.torque(SPEEDS[:, None])[:, 0] + 0.05 * rng.normal(size=len(SPEEDS)))
    found = np.concatenate([fit.law.coefficients[:, 0], fit.law.shape[:, 0]])
    exact = np.concatenate([what.coefficients[:, 0], what.shape[:, 0]])
    assert np.all(np.abs(found - exact) < 4.0 * fit.std)
    assert fit.rms == pytest.approx(0.05, rel=0.5)


@pytest.mark.parametrize("law", [CubeRoot, Arctan])
def test_choice_between_cube_root_and_arctan(law: type[FrictionModel]) -> None:
    rng = np.random.default_rng(4)
    tau = example(law).torque(SPEEDS[:, None])[:, 0] + 0.03 * rng.normal(size=len(SPEEDS))
    assert isinstance(choose_law(SPEEDS, tau).law, law)


def test_too_few_speeds_are_refused() -> None:
    with pytest.raises(InputError, match="more speeds"):
        fit_law(CubeRoot, np.array([0.1, 0.2, 0.3]), np.ones(3))


def warming(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, velocity, temperature and torque of a joint going back and forth while its gear warms up."""
    t = np.arange(0.0, 3000.0, 12.0)
    qd = np.where(np.arange(len(t)) % 2, 0.5, -0.5) * np.where(np.arange(len(t)) % 4 < 2, 1.0, 0.3)
    temperature = 45.0 - 20.0 * np.exp(-t / 700.0)
    law = ViscousCoulomb([[20.0], [30.0]])
    scale = 1.0 + 0.15 * (45.0 - temperature) / 10.0
    return t, qd, temperature, law.torque(qd[:, None])[:, 0] * scale + 0.2 * rng.normal(size=len(t))


def test_warm_up_by_temperature_and_by_time() -> None:
    t, qd, temperature, tau = warming(np.random.default_rng(5))
    by_temperature = fit_warm_up(ViscousCoulomb, qd, tau, temperature=temperature)
    at_reference = 0.15 / (1.0 + 0.15 * (45.0 - by_temperature.reference) / 10.0)
    assert abs(by_temperature.surplus - at_reference) < 4.0 * by_temperature.surplus_std
    by_time = fit_warm_up(ViscousCoulomb, qd, tau, time=t)
    assert by_time.time == pytest.approx(700.0, rel=0.1)
    for fit, cold in ((by_temperature, temperature), (by_time, t)):
        assert fit.rms < 0.2 * fit.rms_constant
        np.testing.assert_allclose(fit.torque(qd, cold), tau, atol=1.0)


def test_warm_up_needs_something_that_warms() -> None:
    with pytest.raises(InputError, match="hardly warms"):
        fit_warm_up(ViscousCoulomb, np.ones(50), np.ones(50), temperature=np.full(50, 30.0))
    with pytest.raises(InputError, match="temperatures or times"):
        fit_warm_up(ViscousCoulomb, np.ones(50), np.ones(50))
    with pytest.raises(InputError, match="without shape"):
        fit_warm_up(Arctan, np.ones(50), np.ones(50), time=np.arange(50.0))
