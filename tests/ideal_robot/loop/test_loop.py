"""The simulation of the identified loop, and the compiled dynamics it stands on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numba import typeof

from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics, joint_frames, joint_places, mass_matrix
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.fitted import Unknown
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.friction.table import DRY, FLUID, Presliding, distance_with, friction_along
from ideal_robot.friction.terms import TERMS, table_terms, with_terms
from ideal_robot.loop.from_model import with_effects, with_rotors
from ideal_robot.loop.loop import checked, further_torque, low_pass_taps
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
    taps = loop.path.command_filter[:, 0]
    expected = 0.07 / 20 + T + loop.path.t_position * float(np.arange(len(taps)) @ taps)
    # The integrator makes the mean error of the velocity loop vanish; sampling costs up to a position cycle.
    assert lag == pytest.approx(expected, abs=loop.path.t_position)


def test_friction_stops_but_does_not_drive():
    loop = plant().changed(distance=np.zeros(6))
    done = simulate(loop, np.tile(ROBOT.home, (150, 1)))
    np.testing.assert_array_equal(done.q_m, np.tile(done.q_m[0], (151, 1)))


def test_it_is_deterministic_and_refuses_nonsense():
    q_c = motion()
    np.testing.assert_array_equal(simulate(plant(), q_c).q_a, simulate(plant(), q_c).q_a)
    with pytest.raises(InputError, match="finite commands"):
        simulate(plant(), np.full((10, 6), np.nan))
    with pytest.raises(InputError, match="must be positive"):
        checked(plant().changed(k_v=np.zeros(6)))


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


def test_bodies_that_are_none_are_no_traceback():
    loop = plant()
    with pytest.raises(IdealRobotError, match="mass matrix"):
        simulate(loop.changed(chain=loop.chain._replace(mass=-loop.chain.mass, inertia=-loop.chain.inertia)), motion())


def test_loops_are_of_one_type_whatever_they_were_made_of():
    """What is read-only in one loop and not in another would be compiled twice, the second time while an arm moves."""
    loop = plant()
    frozen = np.array(loop.cascade.k_p)
    frozen.setflags(write=False)
    own = checked(loop.changed(k_v=np.array(loop.cascade.k_v)[::-1][::-1], k_p=frozen,
                               sizes=np.array(loop.friction.sizes, order="F")))
    assert typeof(own[:-1]) == typeof(loop[:-1])


def test_a_field_that_no_record_has_is_refused():
    with pytest.raises(TypeError, match="tau_c"):
        plant().changed(tau_c=1.0)


# Effects in the simulated drives: each changes what it says, the others change nothing.

def test_friction_curve_and_constants_go_into_the_drive():
    loop = plant()
    changed = with_effects(loop, (
        FittedEffect("viscous", 1, "tau_1", (3.0,)), FittedEffect("current_offset", 1, "tau_1", (0.7,)),
        FittedEffect("rotor_inertia", 1, "tau_1", (0.2,)), FittedEffect("torque_ripple", 1, "tau_1", (1.0, 2.0), (),
                                                                        (40.0,))))
    more = changed.friction.sizes[0] - loop.friction.sizes[0]
    np.testing.assert_allclose(more[..., FLUID], np.tile(3.0 * loop.friction.speeds[0], (2, 1)), atol=1e-6)
    np.testing.assert_allclose(more[..., DRY], 0.0, atol=1e-6)
    assert changed.drives.offset[0] - loop.drives.offset[0] == pytest.approx(0.7)
    assert changed.drives.rotor_inertia[0] - loop.drives.rotor_inertia[0] == pytest.approx(0.2)
    assert changed.drives.ripple[-1, :, 0].tolist() == [40.0, 1.0, 2.0]


@pytest.mark.parametrize("surplus", [0.5, 1.0, 2.0])
def test_a_joint_that_sticks_starts_as_bristles_of_its_stiffness_do(surplus):
    """LuGre with the bristles of before: what holds the joint at rest for longer does not make them stiffer."""
    loop, v_s, joint = plant(), 0.05, 1
    dry, distance = loop.friction.dry[joint], loop.friction.distance[joint]
    sticks = with_effects(loop, (FittedEffect("stribeck", 2, "tau_bell_2", (surplus * dry,), theta=(v_s,)),))
    t = np.arange(0.0, 1.0, 1e-4)
    v = 0.02 * np.sin(2.0 * np.pi * t)
    steps = v * 1e-4
    true, force = np.zeros(len(t)), 0.0
    for k, (speed, step) in enumerate(zip(v, steps, strict=True)):
        size = dry * (1.0 + surplus * np.exp(-((speed / v_s) ** 2)))
        force += dry / distance * (step - abs(step) * force / size)
        true[k] = force

    def left(friction):
        fluid = friction._replace(sizes=friction.sizes * np.array([1.0, 0.0]))
        rows = np.zeros((len(t), 6))
        rows[:, joint], moved = v, np.zeros((len(t), 6))
        moved[:, joint] = steps
        return rms(friction_along(fluid, rows, np.zeros_like(rows), moved, Presliding.none(6))[0][:, joint] - true)

    assert left(sticks.friction) < 0.04 * surplus * dry
    same = sticks.friction._replace(distance=loop.friction.distance)
    assert left(sticks.friction) < 0.5 * left(same)


@pytest.mark.parametrize("seed", range(4))
def test_contacts_are_as_stiff_whatever_friction_becomes(seed):
    """A cold gear, wear, what was learned: D(0)/d stays. Without friction the distance says nothing, and stays."""
    loop, rng = plant(), np.random.default_rng(seed)
    before = loop.friction
    learned = with_terms(before, table_terms(before, loop.path.v_max), rng.normal(0.0, 0.2, (loop.n, TERMS)))
    named = with_effects(loop, (FittedEffect("coulomb", 2, "tau_2", (float(rng.uniform(1.0, 20.0)),)),)).friction
    for after in (learned, named):
        np.testing.assert_allclose(after.dry / after.distance, before.dry / before.distance)
    assert (learned.distance != before.distance).all()
    none = np.zeros_like(before.sizes)
    np.testing.assert_array_equal(distance_with(before, none), before.distance)


def test_measured_arm_angles_say_more_of_a_gear_than_its_torque():
    """And a gear that is found again from torques is a change of what was found."""
    loop = plant().changed(stiffness=np.full(6, 1000.0))
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
    for before, after in zip(flat(loop[:-1]), flat(changed[:-1]), strict=True):
        np.testing.assert_array_equal(before, after)
    assert not changed.terms


def flat(record):
    """The numbers and arrays of a record of records."""
    return [one for value in record for one in (flat(value) if isinstance(value, tuple) else [value])]


@pytest.mark.parametrize(("name", "size", "most"), [("viscous", 150.0, 0.1), ("load_dependent_friction", 0.3, 0.25),
                                                    ("load_direction_friction", 0.3, 0.25)])
def test_friction_in_the_drives_is_the_effects_torque_beside_them(name, size, most):
    loop, q_c = plant(delay=0), motion()
    effects = (FittedEffect(name, 2, "tau_2", (size,)),)
    inside, beside = with_effects(loop, effects), loop.changed(terms=effects)
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
    unknown, missing = np.array(whole.drives.rotor_inertia), whole.drives.rotor_inertia[0]
    unknown[0] = 0.0
    armature = np.array([missing, 0.0, 0.0, 0.0, 0.0, 0.0])
    chain, rotor = with_rotors(whole.chain._replace(armature=armature), unknown, *LIMITS)
    q_c = motion()
    error = simulate(whole.changed(chain=chain, rotor_inertia=rotor), q_c).q_a - simulate(whole, q_c).q_a
    assert rms(error) < 0.05 * rms(simulate(whole, q_c).q_a[:-1] - q_c)


def test_a_rotor_with_hardly_a_link_behind_a_rigid_gear() -> None:
    """A bare flange does not sag on the gear that stands for a rigid one."""
    whole = plant(elastic=False)
    light = whole.chain._replace(mass=whole.chain.mass * np.array([1, 1, 1, 1, 1, 1e-3]), inertia=whole.chain.inertia
                                 * np.array([1, 1, 1, 1, 1, 1e-3])[:, None, None])
    done = simulate(whole.changed(chain=light), motion())
    assert np.max(np.abs(done.q_a[:, 5] - done.q_m[:, 5])) < 2e-4
