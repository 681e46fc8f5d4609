"""The controller's gains from a simulated cascade, and impulse responses of the closed loop."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.controller import identify_controller
from ideal_robot.identification.impulse_response_fit import METHODS, identify_linear_loop
from ideal_robot.signals.recording import Recording

K_P, K_D, K_I = 5000.0, 200.0, 0.2
T = 0.012


def closed_loop(integrator: bool, rng: np.random.Generator, noise: float = 0.5) -> Recording:
    """One axis under the controller of [G] (16), (17), at 0.5 ms, with inertia and friction, logged every 2 ms."""
    dt, inertia = 0.0005, 8.0
    t = np.arange(0.0, 12.0, dt)
    q_d = 0.4 * np.sin(2 * np.pi * 0.31 * t) ** 3 + 0.1 * np.sin(2 * np.pi * 1.7 * t) * np.sin(np.pi * t / 12.0)
    q = v = integral = direction = 0.0
    rows = np.empty((len(t), 2))
    before = q_d[0] - q
    for k in range(len(t)):
        e = q_d[k] - q
        u = K_P * e + K_D * (e - before) / dt - 30.0 * v
        before = e
        integral += integrator * K_I / T * u * dt
        tau = u + integral
        rows[k] = q, tau
        direction += (np.sign(v) - direction) * (1.0 - np.exp(-abs(v) * dt / 2e-4))
        v += dt * (tau - 12.0 * direction - 6.0 * v) / inertia
        q += dt * v
    every = 4
    tau = np.convolve(rows[:, 1], np.ones(every) / every)[: len(t)] + noise * rng.normal(size=len(t))
    return Recording.from_arrays(t[::every], q_c=q_d[::every, None], q=rows[::every, :1], tau=tau[::every, None])


def test_gains_as_in_the_paper() -> None:
    """PD gains from a recording without integrator, the integral gain by simulation from one with it."""
    rng = np.random.default_rng(2)
    found = identify_controller([closed_loop(True, rng)], T, without_integrator=[closed_loop(False, rng)])
    assert found.model.k_p[0] == pytest.approx(K_P, rel=0.05)
    assert found.model.k_d[0] == pytest.approx(K_D, rel=0.05)
    assert found.model.k_i[0] == pytest.approx(K_I, rel=0.2)
    assert found.error_percent[0] < 10.0
    assert found.simulated.shape == found.drifting.shape == found.measured.shape


def test_one_step_estimate_drifts_more_than_the_simulated_one() -> None:
    rng = np.random.default_rng(3)
    found = identify_controller([closed_loop(True, rng, noise=5.0)], T, without_integrator=[closed_loop(False, rng)])
    error = np.linalg.norm(found.simulated - found.measured)
    assert np.linalg.norm(found.drifting - found.measured) > error


def test_commands_are_needed() -> None:
    recording = closed_loop(True, np.random.default_rng(0))
    bare = Recording({k: v for k, v in recording.columns.items() if k != "q_c_1"})
    with pytest.raises(InputError, match="q_d_1"):
        identify_controller([bare], T)
    with pytest.raises(InputError, match="divide the cycle"):
        identify_controller([recording], 0.005)


def response(degree: int, rng: np.random.Generator) -> tuple[Recording, np.ndarray]:
    t = np.arange(1500) * T
    q_d = 0.4 * np.sin(np.pi * t) + 0.1 * np.sin(4.2 * np.pi * t) + 0.02 * np.sin(10.6 * np.pi * t)
    g = np.zeros(26)
    g[degree:] = 0.5 ** np.arange(26 - degree)
    g /= g.sum()
    q = np.convolve(q_d, g)[: len(t)] + 1e-5 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q_c=q_d[:, None], q=q[:, None]), g


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_impulse_response_and_relative_degree(method: str, degree: int) -> None:
    recording, g = response(degree, np.random.default_rng(degree))
    fit = identify_linear_loop([recording], T, method=method)
    assert fit.relative_degree == (degree,)
    np.testing.assert_allclose(fit.loop.g[:, 0], g, atol=0.06)
    assert fit.error_percent[0] < 0.1
    predicted = fit.loop.predict(recording.joints("q_c"))
    np.testing.assert_allclose(predicted[30:], recording.joints("q")[30:], atol=2e-4)


def test_both_estimators_agree() -> None:
    recording, _ = response(1, np.random.default_rng(7))
    a, b = (identify_linear_loop([recording], T, method=method) for method in METHODS)
    # Far below the standard deviations: two ways of computing the same.
    assert np.all(np.abs(a.loop.g - b.loop.g) < 1e-2 * a.std + 1e-12)
    np.testing.assert_allclose(a.std, b.std, rtol=1e-3)
