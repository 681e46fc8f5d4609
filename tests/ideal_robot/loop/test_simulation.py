"""The simulation of the identified loop, and the compiled dynamics it stands on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics, joint_frames, mass_matrix
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.loop.loop_model import between, bristles, low_pass_taps
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.robot import Robot
from tests.ideal_robot.feedforward.plant import ROBOT, T, motion, plant, rms


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15"])
def test_compiled_dynamics_agree_with_pinocchio(name):
    model = Robot.load(name).pinocchio
    data, chain = model.createData(), chain_of(model)
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, model.nv))
    expected = np.array([pin.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(inverse_dynamics(chain, q, qd, qdd), expected, rtol=1e-10, atol=1e-9)
    R, p, M = np.empty((model.nv, 3, 3)), np.empty((model.nv, 3)), np.empty((model.nv, model.nv))
    joint_frames(chain, q[0], R, p)
    mass_matrix(chain, R, p, M)
    full = pin.crba(model, data, q[0])
    np.testing.assert_allclose(M, np.triu(full) + np.triu(full, 1).T, atol=1e-10)


def test_prismatic_joints_too():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Random(), "slide")
    model.appendBodyToJoint(first, pin.Inertia(3.0, np.array([0.1, 0.2, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity())
    second = model.addJoint(first, pin.JointModelRY(), pin.SE3.Random(), "turn")
    model.appendBodyToJoint(second, pin.Inertia(2.0, np.array([0.0, 0.2, 0.3]), 0.2 * np.eye(3)), pin.SE3.Identity())
    data = model.createData()
    q, qd, qdd = np.random.default_rng(1).normal(size=(3, 10, 2))
    expected = np.array([pin.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(inverse_dynamics(chain_of(model), q, qd, qdd), expected, atol=1e-10)


def test_branches_are_refused():
    model = pin.Model()
    for name in ("left", "right"):
        model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), name)
    with pytest.raises(InputError, match="serial chain"):
        chain_of(model)


def test_at_rest_it_stays_in_equilibrium():
    done = simulate(plant(), np.tile(ROBOT.home, (200, 1)))
    assert np.max(np.abs(done.q_m - ROBOT.home)) < 1e-5
    assert np.max(np.abs(done.q_a - done.q_a[0])) < 1e-5
    # Gravity bends the gears of the joints that carry the arm.
    assert np.max(np.abs(done.q_a[0] - ROBOT.home)) > 3e-4


def test_the_planners_delay_is_one_cycle():
    q_c = motion()
    late, early = (simulate(plant(delay=delay), q_c).q_a for delay in (1, 0))
    # The first cycle differs: gravity settles the gears to a microradian once in both.
    np.testing.assert_allclose(late[1:], early[:-1], atol=3e-6)


def test_constant_velocity_is_followed_with_the_lag_of_the_cascade():
    """(1 - k_ff)/k_v, one cycle of interpolation, the low-pass and half a position cycle, without friction."""
    loop = plant(friction=0.0, delay=0, elastic=False)
    t = T * np.arange(250)
    q_c = np.tile(ROBOT.home, (250, 1))
    q_c[:, 0] += 0.2 * np.clip(t - 0.5, 0, None)
    done = simulate(loop, q_c)
    lag = float((q_c[:, 0] - done.q_m[:-1, 0])[-20:].mean() / 0.2)
    taps = loop.command_filter[:, 0]
    expected = 0.07 / 20 + T + loop.t_position * float(np.arange(len(taps)) @ taps)
    # The integrator makes the mean error of the velocity loop vanish; sampling costs up to a position cycle.
    assert lag == pytest.approx(expected, abs=loop.t_position)


def test_friction_stops_but_does_not_drive():
    loop = plant().replace(friction_bend=np.zeros(6))
    q_c = np.tile(ROBOT.home, (150, 1))
    done = simulate(loop, q_c)
    np.testing.assert_array_equal(done.q_m, np.tile(done.q_m[0], (151, 1)))


def test_it_is_deterministic_and_refuses_nonsense():
    q_c = motion()
    np.testing.assert_array_equal(simulate(plant(), q_c).q_a, simulate(plant(), q_c).q_a)
    with pytest.raises(InputError, match="finite commands"):
        simulate(plant(), np.full((10, 6), np.nan))
    with pytest.raises(InputError, match="must be positive"):
        plant().replace(k_v=np.zeros(6))


def test_rigid_gears_are_the_limit_of_stiff_ones():
    q_c = motion()
    rigid = simulate(plant(elastic=False), q_c).q_a
    away = [rms(simulate(plant(stiffness=factor), q_c).q_a - rigid) for factor in (1.0, 2.0, 4.0)]
    # What stays between them is the gear of 80 Hz that stands for a rigid one.
    assert away[0] > 1.3 * away[1] > 1.3**2 * away[2]


def test_a_loop_that_cannot_be_simulated_is_named():
    with pytest.raises(IdealRobotError, match="unstable"):
        simulate(plant(stiffness=1000.0), motion())


@pytest.mark.parametrize(("time", "order", "dead"), [(0.004, 1, 0.0), (0.0015, 2, 0.003), (0.0, 1, 0.002)])
def test_taps_have_the_lag_and_gain_they_should(time, order, dead):
    taps = low_pass_taps(time, order, 0.002, 2, dead_time=dead)
    assert taps.sum(axis=0) == pytest.approx(1.0)
    a = np.exp(-0.002 / time) if time > 0 else 0.0
    assert 0.002 * np.arange(len(taps)) @ taps[:, 0] == pytest.approx(order * 0.002 * a / (1 - a) + dead, rel=1e-3)


def test_bristles_are_as_stiff_at_standstill_as_they_are_while_sliding():
    """After a reversal friction rises along dF/dq = sigma (1 - F sign(v) / g), whatever surplus g has (Dahl)."""
    dry, surplus, bend, v = 55.0, 75.0, 3e-4, 0.01
    level, sigma, force, bent = dry + surplus, dry / bend, -(dry + surplus), -(dry + surplus) / dry
    for _ in range(400):
        force += sigma * (1.0 - force / level) * v * 1e-4
        bent = bristles(bent, v, 1e-4, level, dry, bend)
    assert dry * bent == pytest.approx(force, rel=0.02, abs=0.5)
    # The way to 90 % of what is between the two directions grows with the surplus.
    assert abs(dry * bent) < level


def test_bodies_that_are_none_are_no_traceback():
    loop = plant()
    with pytest.raises(IdealRobotError, match="mass matrix"):
        simulate(loop.replace(chain=loop.chain._replace(mass=-loop.chain.mass, inertia=-loop.chain.inertia)), motion())


@given(st.integers(0, 2**32 - 1))
def test_values_between_those_of_a_table_are_numpys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xs, ys = np.sort(rng.uniform(0.0, 3.0, 40)), rng.standard_normal(40)
    for x in (*rng.uniform(-0.5, 3.5, 20), xs[0], xs[7], xs[-1]):
        assert between(float(x), xs, ys) == np.interp(x, xs, ys)
