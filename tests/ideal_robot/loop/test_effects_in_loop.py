"""Effects in the simulated drives: each changes what it says, the others change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.effects import FittedEffect
from ideal_robot.loop.effects_in_loop import with_effects
from tests.ideal_robot.feedforward.plant import plant


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
    FittedEffect("cable_spring", 1, "tau_1", (5.0,)), FittedEffect("dead_time", 1, "qa_1", (0.003,)),
    FittedEffect("transmission_error", 1, "qa_1", (1e-4, 1e-4), (), (40.0,)),
    FittedEffect("backlash", 1, "tau_1", (1e-4,), (), (3.0,))])
def test_what_the_drive_has_no_place_for_leaves_it(effect):
    loop = plant()
    changed = with_effects(loop, (effect,))
    for name in ("friction_torque", "friction_load", "friction_bend", "offset", "rotor_inertia", "stiffness"):
        np.testing.assert_allclose(getattr(changed, name), getattr(loop, name), rtol=1e-12)
    assert not len(changed.ripple)
