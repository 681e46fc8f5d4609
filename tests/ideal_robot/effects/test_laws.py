"""Laws of all effects of the library, on one small motion."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, FittedEffect, Signals, effect_of, library
from ideal_robot.effects.drive import LateTorque
from ideal_robot.effects.learned import Unknown
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction, ViscousCoulomb


def motion(n: int = 2, count: int = 1500) -> Signals:
    t = np.linspace(0.0, 12.0, count)
    w = np.array([1.1, 1.7, 0.6])[:n]
    q = 0.8 * np.sin(np.outer(t, w)) + 0.3 * np.sin(np.outer(t, 2.3 * w))
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)

    def rigid(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        return 2.0 * c + 5.0 * np.sin(a) + 0.1 * np.sum(c, axis=1, keepdims=True)

    load = rigid(q, qd, qdd)
    friction = 0.5 * qd + np.sign(qd)
    return Signals(t, q, qd, qdd, load, load + friction, friction, temperature=20.0 + t[:, None] * np.ones(n),
                   rigid=rigid, payload=np.ones((count, n, 10)), v_small=np.full(n, 1e-3))


TORQUE_OR_ARM = [e for e in library() if e.domain in (MOTOR_TORQUE, ARM_POSITION)]


@pytest.mark.parametrize("effect", TORQUE_OR_ARM, ids=lambda e: f"{e.name}-{e.channel(1)}")
class TestEffect:
    def test_columns_have_the_shape_they_promise(self, effect):
        signals = motion()
        for joint in effect.joints(signals):
            theta = effect.starts(signals, joint)[0]
            columns = effect.columns(signals, joint, theta)
            assert columns.shape == (len(signals.t), signals.n, len(effect.coefficient_names))
            assert np.all(np.isfinite(columns))
            assert len(theta) == len(effect.theta_names)

    def test_starts_lie_within_the_bounds(self, effect):
        signals = motion()
        joint = next(iter(effect.joints(signals)))
        bounds = effect.bounds(signals, joint)
        for theta in effect.starts(signals, joint):
            if bounds and theta[0] != 0.0:
                assert all(low - 1e-12 <= value <= high + 1e-12
                           for value, (low, high) in zip(theta, bounds, strict=True))

    def test_a_fitted_effect_survives_its_file(self, effect):
        signals = motion()
        joint = next(iter(effect.joints(signals)))
        theta = effect.starts(signals, joint)[0]
        m = len(effect.coefficient_names)
        fitted = FittedEffect(effect.name, joint, effect.channel(joint), tuple(0.1 * (i + 1) for i in range(m)),
                              (0.01,) * m, theta, (0.0,) * len(theta))
        again = FittedEffect.from_dict(json.loads(json.dumps(fitted.to_dict())))
        assert type(effect_of(again)) is type(effect)
        assert again.domain == effect.domain
        np.testing.assert_array_equal(again.contribution(signals), fitted.contribution(signals))

    def test_a_single_sample_does_not_fail(self, effect):
        whole = motion()
        joint = next(iter(effect.joints(whole)))
        theta = effect.starts(whole, joint)[0]
        one = Signals(whole.t[:1], whole.q[:1], whole.qd[:1], whole.qdd[:1], whole.load[:1], whole.torque[:1],
                      whole.friction[:1], rigid=whole.rigid, v_small=whole.v_small)
        assert effect.columns(one, joint, theta).shape[0] == 1


def test_every_name_of_the_list_is_there():
    asked = {"viscous", "coulomb", "degressive", "stribeck", "asymmetric_friction", "load_dependent_friction",
             "thermal_drift", "presliding_hysteresis", "torque_ripple", "current_offset", "drive_gain", "rotor_inertia",
             "gravity_spring", "cable_spring", "payload", "axis_coupling", "dead_time", "joint_elasticity", "backlash",
             "transmission_error", "kinematic_error", "thermal_growth"}
    assert asked <= {effect.name for effect in library()}


def test_an_effect_of_another_version_is_named():
    with pytest.raises(InputError, match="known are"):
        effect_of(FittedEffect("perpetual_motion", 1, "tau_1", (1.0,)))


def test_a_learned_term_goes_to_zero_outside_of_where_it_was_learned():
    signals = motion(count=3)
    term = Unknown(("q_1",), False, (tuple(np.linspace(-1.0, 1.0, 6)),))
    inside, far = (Signals(signals.t, np.full((3, 2), x), signals.qd, signals.qdd, signals.load, signals.torque,
                           signals.friction) for x in (0.3, 2.0))
    np.testing.assert_allclose(term.basis(inside).sum(axis=1), 1.0, atol=1e-9)
    np.testing.assert_array_equal(term.basis(far), 0.0)


def test_a_learned_term_still_holds_where_a_path_reaches_a_little_further():
    """A fall to zero within a tenth of the range made a loop worse that turned round a fifth of the range outside."""
    signals = motion(count=3)
    term = Unknown(("q_1",), False, (tuple(np.linspace(-1.0, 1.0, 6)),))
    left = [term.basis(Signals(signals.t, np.full((3, 2), x), signals.qd, signals.qdd, signals.load, signals.torque,
                               signals.friction)).sum(axis=1)[0] for x in (1.2, -1.4, 1.7)]
    assert left[0] > 0.97
    assert left[1] > 0.8
    assert left[2] < 0.35


def test_dead_time_is_exact_at_its_chord():
    signals = motion()
    effect = next(e for e in library() if e.name == "dead_time" and e.channel(1) == "tau_1")
    delay = 3.0 * signals.dt
    late = effect.columns(signals, 1, (delay,))[:, 0, 0] * delay + signals.torque[:, 0]
    np.testing.assert_allclose(late[10:-10], signals.torque[7:-13, 0], atol=1e-9)


@pytest.mark.parametrize("name", ["coulomb", "stribeck", "load_dependent_friction"])
def test_dry_friction_of_an_effect_builds_up_as_the_models_own_does(name):
    signals = motion()
    friction = PerJointFriction([ViscousCoulomb(np.array([[0.5], [1.0]]), np.array([[0.06]]), presliding=True),
                                 ViscousCoulomb(np.array([[0.5], [1.0]]))])
    known = replace(signals, sliding=friction.sliding(signals.q, signals.qd))
    effect = next(e for e in library() if e.name == name and e.acts_on("tau_1"))
    theta = effect.starts(signals, 1)[0]
    sharp, gradual = (effect.columns(s, 1, theta)[:, 0, 0] for s in (signals, known))
    # After each reversal that ends a long stroke it still acts in the old direction, later it is the same.
    turned = np.flatnonzero(np.diff(np.sign(signals.qd[:, 0])))
    turned = turned[1:][np.abs(np.diff(signals.q[turned, 0])) > 0.3] + 2
    assert len(turned) >= 3
    assert np.all(sharp[turned] * gradual[turned] < 0.0)
    fast = np.abs(signals.qd[:, 0]) > 0.9 * np.abs(signals.qd[:, 0]).max()
    assert gradual[fast] == pytest.approx(sharp[fast], rel=1e-3)
    # A joint whose model has no memory keeps the sign of its speed.
    assert np.array_equal(effect.columns(signals, 2, theta), effect.columns(known, 2, theta))


@pytest.mark.parametrize("delay", [-0.0008, 0.0003, 0.0137])
def test_a_delay_is_exact_where_the_chord_is_as_long(delay):
    t = np.arange(0.0, 4.0, 1e-3)
    still = np.zeros((len(t), 1))
    torque = np.sin(2.0 * np.pi * 8.0 * t)[:, None]
    effect = LateTorque()
    theta = effect.consistent_theta(np.array([delay]), (1e-3,))
    signals = Signals(t, still, still, still, still, torque, still)
    late = torque[:, 0] + delay * effect.columns(signals, 1, theta)[:, 0, 0]
    inner = slice(50, -50)
    assert late[inner] == pytest.approx(np.sin(2.0 * np.pi * 8.0 * (t - delay))[inner], abs=1e-5)
