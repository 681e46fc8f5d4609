"""The friction curve: it finds a shape and an inertia that the model has not, from motor angles, and stays bounded."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal
from ideal_robot.feedforward.friction_curve import CurveState, FrictionCurve
from ideal_robot.feedforward.friction_estimator import FAR, TERMS, friction_terms
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.loop.simulation import simulate
from tests.ideal_robot.feedforward.plant import commands, motion, plant, rms

SLOW = 0.02
"""Where the sticky arm differs most, in gross sliding [rad/s]."""


def sticky(loop: LoopModel) -> LoopModel:
    """The loop with a quarter more dry friction at rest, which is gone from 0.1 rad/s on."""
    more = 1.0 + 0.25 * np.exp(-((loop.friction_velocity / 0.05) ** 2))
    return loop.replace(friction_torque=loop.friction_torque * more, friction_dry=loop.friction_dry)


def learned(loop: LoopModel, true: LoopModel, q_d: Array, repeat: int = 4, scale: float = 1.0) -> CurveState:
    """What is learned while the ideal robot, which does not know, moves the true arm again and again."""
    ideal, curves = IdealRobot(loop), FrictionCurve(loop)
    q_d = np.concatenate([q_d] * repeat)
    done = simulate(true, commands(ideal, q_d))
    state, known = ideal.init(q_d[0]), curves.init()
    ahead = np.concatenate([q_d, np.tile(q_d[-1], (ideal.n_d, 1))])
    for k in range(len(q_d)):
        _, state = ideal.step(state, ahead[k : k + ideal.n_d])
        known = curves.planned(known, state)
        # The plan knows nothing of what is found.
        known = known._replace(plans=(*known.plans[:-1], known.plans[-1]._replace(x=np.zeros_like(known.x))))
        known = curves.update(known, scale * done.q_m[k + 1])
    return known


@pytest.mark.parametrize("delay", [0, 1])
def test_friction_that_falls_with_speed_is_found_in_the_motor_angles(delay: int) -> None:
    """The identified law rises from rest on; two factors on it cannot fall."""
    loop = plant(delay=delay)
    true = sticky(loop)
    found = FrictionCurve(loop).values(learned(loop, true, motion(amplitude=0.05)))
    more = (true.friction_torque - loop.friction_torque)[0]
    ratio = np.array([dry * friction_terms(np.array([SLOW / most]))[0] @ values / np.interp(SLOW, v, theirs)
                      for dry, most, values, v, theirs in zip(loop.friction_torque[0, 0], loop.v_max, found,
                                                              loop.friction_velocity.T, more.T, strict=True)])
    assert np.all((ratio > 0.5) & (ratio < 1.2)), ratio


@pytest.mark.parametrize("delay", [0, 1])
def test_inertia_that_the_model_has_not_is_found_in_the_motor_angles(delay: int) -> None:
    loop = plant(delay=delay)
    more = np.array([0.08, -0.08, 0.08, -0.08, 0.08, -0.08]) * loop.k_p * loop.t_ipo
    heavier = loop.replace(rotor_inertia=np.maximum(loop.rotor_inertia + more, 0.2 * loop.rotor_inertia))
    more = heavier.rotor_inertia - loop.rotor_inertia
    found = [learned(loop, true, motion()).inertia for true in (loop, heavier)]
    # Where joints move together it is not told apart whose acceleration it is; the torque is what counts.
    qdd = accelerations(loop, motion())
    for i in range(3):
        assert rms(qdd @ (found[1] - found[0])[i] - qdd[:, i] * more[i]) < 0.35 * rms(qdd[:, i] * more[i])


def accelerations(loop: LoopModel, q: Array) -> Array:
    return np.asarray(np.gradient(np.gradient(q, loop.t_ipo, axis=0), loop.t_ipo, axis=0))


def test_links_that_other_joints_accelerate_are_found_in_the_motor_angles() -> None:
    """A forearm that is heavier than the model's is felt by the upper arm's motor when the elbow turns."""
    loop, q_d = plant(), motion()
    mass = loop.chain.mass.copy()
    mass[2] *= 1.3
    heavier = loop.replace(chain=loop.chain._replace(mass=mass))
    middle = np.median(q_d, axis=0)
    found = learned(loop, heavier, q_d).inertia - learned(loop, loop, q_d).inertia
    q, still = np.tile(middle, (loop.n, 1)), np.zeros((loop.n, loop.n))
    more, less = (inverse_dynamics(true.chain, q, still, np.eye(loop.n))
                  - inverse_dynamics(true.chain, q, still, still) for true in (heavier, loop))
    wanted = (more - less)[1:3, 1:3].T
    qdd = accelerations(loop, q_d)[:, 1:3]
    left = rms(qdd @ (found[1:3, 1:3] - wanted).T)
    assert left < 0.5 * rms(qdd @ wanted.T)
    assert left < rms(qdd @ (np.diag(np.diagonal(found)[1:3]) - wanted).T)


def test_with_the_inertia_of_another_motion_the_arm_is_where_it_should_be() -> None:
    loop = plant()
    heavier = loop.replace(rotor_inertia=loop.rotor_inertia + 0.08 * loop.k_p * loop.t_ipo)
    curves = FrictionCurve(loop)
    known = curves.inertia_alone(learned(loop, heavier, motion(amplitude=0.05)))
    assert not known.x[:, : TERMS + 1].any()
    assert known.inertia.any()
    q_d = motion()
    knew, fixed, adapted = (
        rms(simulate(heavier, commands(feedforward, q_d)).q_a[40:-1] - q_d[40:]) for feedforward in
        (IdealRobot(heavier), IdealRobot(loop), AdaptedIdeal(IdealRobot(loop), curve=curves, known_curve=known)))
    assert adapted - knew < 0.35 * (fixed - knew), (knew, fixed, adapted)


def errors(loop: LoopModel, true: LoopModel) -> dict[str, float]:
    """How far the true arm is from where it should be, by the model's law and with the curve that it learned [rad]."""
    q_d = motion(amplitude=0.05)
    known = learned(loop, true, q_d)
    return {name: rms(simulate(true, commands(feedforward, q_d)).q_a[40:-1] - q_d[40:])
            for name, feedforward in (("law", IdealRobot(loop)),
                                      ("curve", AdaptedIdeal(IdealRobot(loop), curve=FrictionCurve(loop),
                                                             known_curve=known)))}


def test_with_the_curve_the_arm_is_where_it_should_be() -> None:
    loop = plant()
    error = errors(loop, sticky(loop))
    assert error["curve"] < 0.6 * error["law"], error


def test_an_arm_as_the_model_has_it_is_moved_no_worse() -> None:
    loop = plant()
    error = errors(loop, loop)
    assert error["curve"] < 1.03 * error["law"], error


def test_of_another_motion_the_curve_stays_and_the_following_error_does_not() -> None:
    loop = plant()
    known = learned(loop, sticky(loop), motion(amplitude=0.05), repeat=1)
    begun = FrictionCurve(loop).init(known)
    assert np.linalg.norm(begun.x[:, :TERMS] - known.x[:, :TERMS]) < 0.05 * np.linalg.norm(known.x[:, :TERMS])
    assert begun.plans == ()
    assert begun.error is None
    assert not begun.integral.any()
    np.testing.assert_allclose(begun.x[:, TERMS], 0.0, atol=1e-9)


@pytest.mark.parametrize("scale", [np.nan, 1e6, -1.0, 1.001])
def test_motor_angles_that_cannot_be_leave_it_bounded(scale: float) -> None:
    loop = plant()
    known = learned(loop, loop, motion(), repeat=1, scale=scale)
    assert np.all(np.abs(known.x) <= FAR)
    assert np.all(np.linalg.eigvalsh(known.covariance) > 0.0)
