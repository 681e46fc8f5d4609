"""The simulation of the identified loop, and the compiled dynamics it stands on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import typeof

from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics, joint_frames, joint_places, mass_matrix
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.fitted import Unknown
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.friction.laws import Arctan, CubeRoot, ViscousCoulomb
from ideal_robot.loop.from_model import further_torque, with_effects, with_rotors
from ideal_robot.loop.loop_model import LoopModel, dry_and_fluid, friction_along, low_pass_taps, turns_of
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.arm_with_effects import chain_with, changes_of
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot, spread_postures
from tests.arms import ROBOT, T, motion, plant, rms


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
    point, places = np.array([0.1, -0.2, 0.3]), []
    for joint in (0, model.nv - 1, model.nv):
        for q_k in q:
            pin.forwardKinematics(model, data, q_k)
            places.append([*(pose.translation.copy() for pose in list(data.oMi)[1:]), data.oMi[joint].act(point)])
        np.testing.assert_allclose(joint_places(chain, q, joint, point), places[-len(q):], atol=1e-12)


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
    lag = float((q_c[:, 0] - simulate(loop, q_c).q_m[:-1, 0])[-20:].mean() / 0.2)
    taps = loop.command_filter[:, 0]
    expected = 0.07 / 20 + T + loop.t_position * float(np.arange(len(taps)) @ taps)
    # The integrator makes the mean error of the velocity loop vanish; sampling costs up to a position cycle.
    assert lag == pytest.approx(expected, abs=loop.t_position)


def test_friction_stops_but_does_not_drive():
    loop = plant().replace(friction_bend=np.zeros(6))
    done = simulate(loop, np.tile(ROBOT.home, (150, 1)))
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


def _reversal(loop: LoopModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``friction_along`` of a motion over 40 mrad forward and 4 mrad back, every 10 µrad, without load."""
    v = np.concatenate([np.full(4000, 0.1), np.full(400, -0.1)])[:, None] * np.ones(loop.n)
    drives = loop.drives(loop.stiffness, loop.damping)
    return friction_along(drives, v, np.zeros_like(v), 1e-4, np.zeros(loop.n), 1e-3)


@pytest.mark.parametrize(("kind", "coefficients", "shape"), [
    (ViscousCoulomb, (40.0, 30.0), ()), (CubeRoot, (5.0, 30.0, 20.0), ()), (Arctan, (5.0, 30.0, 12.0), (40.0,))])
def test_friction_of_the_loop_is_that_of_the_identified_law(kind, coefficients, shape):
    """Dry friction turns over the presliding distance, what rises with speed acts at once: in law and loop."""
    law = kind(np.array(coefficients)[:, None], np.array([*shape, 1e-3])[:, None], presliding=True)
    loop = plant(elastic=False).replace(friction_bend=np.full(6, 1e-3))
    table = law.torque(np.maximum(loop.friction_velocity[:, :1], 1e-9))
    loop = loop.replace(friction_torque=np.tile(table, (2, 1, 6)), friction_dry=np.full(6, 30.0))
    v = np.concatenate([np.full(4000, 0.1), np.full(400, -0.1)])[:, None]
    q = 1e-4 * np.cumsum(v, axis=0)
    # The law follows a twentieth of the distance behind, on either side.
    np.testing.assert_allclose(_reversal(loop)[0][1000:, :1], law.torque(v, q=q)[1000:], atol=0.1 * 2 * 30.0)


def test_friction_that_falls_with_speed_is_dry_and_what_rises_again_is_the_lubricants():
    speeds, table = np.array([0.0, 0.1, 0.2]), np.array([50.0, 30.0, 45.0])
    turns = turns_of(np.tile(table[:, None], (2, 1, 6)))[0, :, 0]
    for speed, parts in ((0.0, (50.0, 0.0)), (0.05, (40.0, 0.0)), (0.1, (30.0, 0.0)), (0.15, (30.0, 7.5)),
                         (0.3, (30.0, 15.0))):
        assert dry_and_fluid(speed, speeds, turns, table) == pytest.approx(parts)


def test_bristles_keep_their_force_until_the_joint_has_moved():
    """The level of dry friction jumps, under load, without a motion: the force follows over the presliding distance."""
    loop = plant(elastic=False)
    loop = loop.replace(friction_load=np.full(6, 0.5), friction_bend=np.full(6, 1e-3),
                        friction_torque=np.full_like(loop.friction_torque, 30.0), friction_dry=np.full(6, 30.0))
    v, load = np.full((4000, 6), 0.1), np.zeros((4000, 6))
    load[2000:] = 40.0
    force = friction_along(loop.drives(loop.stiffness, loop.damping), v, load, 1e-4, np.zeros(6), 1e-3)[0][:, 0]
    assert force[1999] == pytest.approx(30.0)
    assert force[2000] == pytest.approx(30.0, rel=0.01)
    assert force[-1] == pytest.approx(50.0, rel=1e-4)


def test_bristles_are_as_stiff_at_standstill_as_they_are_while_sliding():
    """After a reversal dry friction rises along dF/dq = sigma (1 - F sign(v) / g), whatever surplus g has (Dahl)."""
    loop = plant(elastic=False)
    dry, bend = 30.0, 1e-3
    for surplus in (0.0, 40.0):
        now = loop.replace(friction_torque=np.full_like(loop.friction_torque, dry + surplus),
                           friction_dry=np.full(6, dry), friction_bend=np.full(6, bend))
        force = _reversal(now)[0][:, 0]
        assert force[3999] == pytest.approx(dry + surplus)
        # From the one direction to the other with twice the slope at which friction begins.
        assert force[4000] - force[3999] == pytest.approx(-2.0 * dry / bend * 1e-5, rel=0.02)


def test_bodies_that_are_none_are_no_traceback():
    loop = plant()
    with pytest.raises(IdealRobotError, match="mass matrix"):
        simulate(loop.replace(chain=loop.chain._replace(mass=-loop.chain.mass, inertia=-loop.chain.inertia)), motion())


def test_drives_are_of_one_type_whatever_the_loop_was_made_of():
    """What is read-only in one loop and not in another would be compiled twice, the second time while an arm moves."""
    loop = plant()
    own = loop.replace(k_v=np.array(loop.k_v)[::-1][::-1], friction_torque=np.array(loop.friction_torque, order="F"))
    assert typeof(own.drives(own.stiffness, own.damping)) == typeof(loop.drives(loop.stiffness, np.array(loop.damping)))


@given(st.integers(0, 2**32 - 1))
def test_friction_between_the_speeds_of_a_table_is_numpys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speeds, table = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 3.0, 39))]), rng.standard_normal(40)
    turns = np.minimum.accumulate(table)
    for speed in (0.0, *speeds[1:3], *rng.uniform(0.0, 4.0, 20)):
        dry, fluid = dry_and_fluid(float(speed), speeds, turns, table)
        assert (dry, dry + fluid) == pytest.approx((np.interp(speed, speeds, turns), np.interp(speed, speeds, table)))



# Effects in the simulated drives: each changes what it says, the others change nothing.

def test_friction_curve_and_constants_go_into_the_drive():
    loop = plant()
    changed = with_effects(loop, (
        FittedEffect("viscous", 1, "tau_1", (3.0,)), FittedEffect("current_offset", 1, "tau_1", (0.7,)),
        FittedEffect("rotor_inertia", 1, "tau_1", (0.2,)), FittedEffect("torque_ripple", 1, "tau_1", (1.0, 2.0), (),
                                                                        (40.0,))))
    np.testing.assert_allclose(changed.friction_torque[:, :, 0] - loop.friction_torque[:, :, 0],
                               np.tile(3.0 * loop.friction_velocity[:, 0], (2, 1)), atol=1e-6)
    assert changed.offset[0] - loop.offset[0] == pytest.approx(0.7)
    assert changed.rotor_inertia[0] - loop.rotor_inertia[0] == pytest.approx(0.2)
    assert changed.ripple[-1, :, 0].tolist() == [40.0, 1.0, 2.0]


def test_measured_arm_angles_say_more_of_a_gear_than_its_torque():
    """And a gear that is found again from torques is a change of what was found."""
    loop = plant().replace(stiffness=np.full(6, 1000.0))
    torque, again, angle, beyond = (FittedEffect("joint_elasticity", 1, channel, (size,)) for channel, size in (
        ("tau_1", 2e-3), ("tau_1", -3e-4), ("qa_1", 1e-3), ("tcp_1", 5e-4)))
    for effects, compliance in (((torque,), 2e-3), ((angle,), 2e-3), ((torque, angle), 2e-3), ((beyond,), 1.5e-3),
                                ((beyond, angle), 2e-3), ((torque, again), 1.7e-3)):
        assert with_effects(loop, effects).compliance[0] == pytest.approx(compliance)


@pytest.mark.parametrize("effect", [
    FittedEffect("dead_time", 1, "qa_1", (0.003,)), FittedEffect("torque_filter", 0, "tau", (0.003,), (), (0.003,)),
    FittedEffect("thermal_drift", 1, "tau_1", (3.0, 4.0), (), (100.0,))])
def test_what_acts_nowhere_leaves_the_loop(effect):
    loop = plant()
    changed = with_effects(loop, (effect,))
    for name, value in vars(loop).items():
        if name == "chain":
            assert all(np.array_equal(a, b) for a, b in zip(value, changed.chain, strict=True))
        elif np.size(value):
            np.testing.assert_array_equal(getattr(changed, name), value)
        else:
            assert not np.size(getattr(changed, name))


@pytest.mark.parametrize(("name", "size", "most"), [("viscous", 150.0, 0.1), ("load_dependent_friction", 0.3, 0.25),
                                                    ("load_direction_friction", 0.3, 0.25)])
def test_friction_in_the_drives_is_the_effects_torque_beside_them(name, size, most):
    loop, q_c = plant(delay=0), motion()
    effects = (FittedEffect(name, 2, "tau_2", (size,)),)
    inside, beside = with_effects(loop, effects), loop.replace(terms=effects)
    moved = np.abs(simulate(inside, q_c).q_a - simulate(loop, q_c).q_a).max()
    apart = np.abs(simulate(inside, q_c).q_a - simulate(beside, q_c).q_a).max()
    assert apart < most * moved


def test_a_body_on_the_last_link_weighs_what_its_columns_say():
    """[G] (5): the chain with the body, less the chain without, is the regressor times its parameters."""
    chain, q = chain_of(ROBOT.pinocchio), np.tile(ROBOT.home, (3, 1)) + 0.3 * np.arange(3)[:, None]
    qd, qdd = np.full((3, 6), 0.7), np.full((3, 6), -1.3)
    numbers = (4.0, 0.2, -0.1, 0.5, 0.09, 0.01, 0.08, -0.02, 0.005, 0.03)
    changed = chain_with(chain, changes_of((FittedEffect("payload", 0, "tau", numbers),)))
    added = inverse_dynamics(changed, q, qd, qdd) - inverse_dynamics(chain, q, qd, qdd)
    expected = regressor(ROBOT.pinocchio, q, qd, qdd)[:, :, 50:] @ np.array(numbers)
    np.testing.assert_allclose(added, expected, atol=1e-9)


def test_a_model_predicts_what_it_carries():
    """A payload and a leaning base are in the torque prediction of a model, not only in that of the diagnosis."""
    q = np.tile(ROBOT.home, (4, 1))
    still = np.zeros_like(q)
    model = Model.nominal(ROBOT)
    numbers = (4.0, 0.2, -0.1, 0.5, *np.zeros(6))
    more = model.with_effects((FittedEffect("payload", 0, "tau", numbers),
                               FittedEffect("base_tilt", 0, "tau", (0.3, -0.2))))
    changed = chain_with(chain_of(ROBOT.pinocchio), changes_of(more.effects))
    carried = chain_with(chain_of(ROBOT.pinocchio), changes_of(more.effects[1:]))
    np.testing.assert_allclose(more.inverse_dynamics(q, still, still), inverse_dynamics(changed, q, still, still),
                               atol=0.05 * np.abs(inverse_dynamics(changed, q, still, still)
                                                  - inverse_dynamics(carried, q, still, still)).max())


def test_a_learned_curve_acts_and_fades_outside_of_what_was_seen():
    """Over the angle where it was seen it is asked of the motor; far from there nothing is."""
    curve = Unknown(("q_2",), False, ((-2.2, -2.0, -1.8, -1.6),))
    fitted = FittedEffect("unknown", 2, "tau_2", (100.0,) * 6, data=curve.to_data())
    loop = with_effects(plant(), (fitted,))
    assert loop.terms == (fitted,)
    still = np.zeros((3, 6))
    q = np.zeros((3, 6))
    q[:, 1] = [-1.9, -1.59, 0.5]
    torque = further_torque(loop, np.arange(3.0), q, still, still, still, still)[:, 1]
    assert torque[0] == pytest.approx(100.0)
    assert 50.0 < torque[1] < 100.0
    assert torque[2] == 0.0
    over_time = Unknown(("t",), False, ((0.0, 1.0, 2.0),))
    nowhere = FittedEffect("unknown", 2, "tau_2", (100.0,) * 5, data=over_time.to_data())
    assert not with_effects(plant(), (nowhere,)).terms


# Rotor inertias that no recording tells: a loop that can be simulated, with the inertia that was identified.

LIMITS = ROBOT.q_min, ROBOT.q_max


def test_what_moves_keeps_its_inertia_and_mass_matrices_stay_positive() -> None:
    chain = plant().chain
    rotor = np.array(ROBOT.rotor_inertia)
    rotor[[0, 3]] = 0.0
    new, rotors = with_rotors(chain, rotor, *LIMITS)
    assert np.all(rotors[[0, 3]] > 0)
    np.testing.assert_array_equal(rotors[[1, 2, 4, 5]], rotor[[1, 2, 4, 5]])
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 20, 6))
    np.testing.assert_allclose(inverse_dynamics(new, q, qd, qdd) + rotors * qdd,
                               inverse_dynamics(chain, q, qd, qdd) + rotor * qdd, atol=1e-9)
    R, p, M = np.empty((6, 3, 3)), np.empty((6, 3)), np.empty((6, 6))
    for posture in spread_postures(*LIMITS, 500):
        joint_frames(new, posture, R, p)
        mass_matrix(new, R, p, M)
        assert np.linalg.eigvalsh(M)[0] > 0


def test_known_rotors_are_left_alone() -> None:
    chain = plant().chain
    new, rotors = with_rotors(chain, np.array(ROBOT.rotor_inertia), *LIMITS)
    np.testing.assert_array_equal(rotors, ROBOT.rotor_inertia)
    np.testing.assert_array_equal(new.armature, 0.0)


@pytest.mark.parametrize("elastic", [True, False])
def test_an_arm_without_known_rotors_is_simulated_as_the_one_it_is(elastic: bool) -> None:
    """Once the identified loop of a URDF without drive data was "unstable in simulation"."""
    whole = plant(elastic=elastic)
    # All inertia of the base joint counted to the link, as identification leaves it where nothing tells them apart.
    unknown, missing = np.array(whole.rotor_inertia), whole.rotor_inertia[0]
    unknown[0] = 0.0
    armature = np.array([missing, 0.0, 0.0, 0.0, 0.0, 0.0])
    chain, rotor = with_rotors(whole.chain._replace(armature=armature), unknown, *LIMITS)
    q_c = motion()
    error = simulate(whole.replace(chain=chain, rotor_inertia=rotor), q_c).q_a - simulate(whole, q_c).q_a
    assert rms(error) < 0.05 * rms(simulate(whole, q_c).q_a[:-1] - q_c)


def test_a_rotor_with_hardly_a_link_behind_a_rigid_gear() -> None:
    """A bare flange does not sag on the gear that stands for a rigid one."""
    whole = plant(elastic=False)
    light = whole.chain._replace(mass=whole.chain.mass * np.array([1, 1, 1, 1, 1, 1e-3]), inertia=whole.chain.inertia
                                 * np.array([1, 1, 1, 1, 1, 1e-3])[:, None, None])
    done = simulate(whole.replace(chain=light), motion())
    assert np.max(np.abs(done.q_a[:, 5] - done.q_m[:, 5])) < 2e-4
