"""Effects in the simulated drives: each changes what it says, the others change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.learned import Unknown
from ideal_robot.loop.effects_in_loop import with_effects
from ideal_robot.loop.further_torque import further_torque
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.arm_with_effects import chain_with, changes_of
from ideal_robot.model.model import Model
from tests.ideal_robot.feedforward.plant import ROBOT, motion, plant


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
    loop = plant().replace(stiffness=np.full(6, 1000.0))
    torque = FittedEffect("joint_elasticity", 1, "tau_1", (2e-3,))
    angle = FittedEffect("joint_elasticity", 1, "qa_1", (1e-3,))
    assert with_effects(loop, (torque,)).compliance[0] == pytest.approx(2e-3)
    assert with_effects(loop, (angle,)).compliance[0] == pytest.approx(2e-3)
    assert with_effects(loop, (torque, angle)).compliance[0] == pytest.approx(2e-3)
    beyond = FittedEffect("joint_elasticity", 1, "tcp_1", (5e-4,))
    assert with_effects(loop, (beyond,)).compliance[0] == pytest.approx(1.5e-3)
    assert with_effects(loop, (beyond, angle)).compliance[0] == pytest.approx(2e-3)


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


def test_further_torques_move_the_simulated_loop_as_a_change_of_its_drives_does():
    """Viscous friction as a torque beside the loop is viscous friction in it."""
    loop, q_c = plant(delay=0), motion()
    inside = with_effects(loop, (FittedEffect("viscous", 2, "tau_2", (150.0,)),))
    beside = loop.replace(terms=(FittedEffect("viscous", 2, "tau_2", (150.0,)),))
    moved = np.abs(simulate(inside, q_c).q_a - simulate(loop, q_c).q_a).max()
    left = np.abs(simulate(inside, q_c).q_a - simulate(beside, q_c).q_a).max()
    assert left < 0.1 * moved


@pytest.mark.parametrize("name", ["load_dependent_friction", "load_direction_friction"])
def test_friction_of_the_load_in_the_drives_is_the_effects_torque_beside_them(name):
    loop, q_c = plant(delay=0), motion()
    found = (FittedEffect(name, 2, "tau_2", (0.3,)),)
    inside, beside = with_effects(loop, found), loop.replace(terms=found)
    moved = np.abs(simulate(inside, q_c).q_a - simulate(loop, q_c).q_a).max()
    left = np.abs(simulate(inside, q_c).q_a - simulate(beside, q_c).q_a).max()
    assert left < 0.25 * moved


def test_a_gear_found_again_from_torques_is_a_change_of_what_was_found():
    loop = plant().replace(stiffness=np.full(6, 1000.0))
    first, second = (FittedEffect("joint_elasticity", 1, "tau_1", (value,)) for value in (2e-3, -3e-4))
    assert with_effects(loop, (first, second)).compliance[0] == pytest.approx(1.7e-3)


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
    asked = further_torque(loop, np.arange(3.0), q, still, still, still, still)[:, 1]
    assert asked[0] == pytest.approx(100.0)
    assert 50.0 < asked[1] < 100.0
    assert asked[2] == 0.0
    over_time = Unknown(("t",), False, ((0.0, 1.0, 2.0),))
    nowhere = FittedEffect("unknown", 2, "tau_2", (100.0,) * 5, data=over_time.to_data())
    assert not with_effects(plant(), (nowhere,)).terms
