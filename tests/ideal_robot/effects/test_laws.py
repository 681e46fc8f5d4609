"""Laws of all effects of the library, the table of them, and the way in for effects of others."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.report import discriminating_motion
from ideal_robot.effects import (
    ARM_POSITION,
    MOTOR_TORQUE,
    Effect,
    FittedEffect,
    Signals,
    library,
    names,
    register,
    unregister,
)
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.registry import EFFECTS, find
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm, strokes
from tests.sources import ROOT


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


def as_read(effect: Effect, signals: Signals) -> FittedEffect:
    """An effect of some size as its file keeps it: the same one."""
    joint = next(iter(effect.joints(signals)))
    theta, m = effect.starts(signals, joint)[0], len(effect.coefficient_names)
    size = tuple(0.1 * (i + 1) for i in range(m))
    fitted = FittedEffect(effect.name, joint, effect.channel(joint), size, (0.01,) * m, theta, (0.0,) * len(theta))
    again = FittedEffect.from_dict(json.loads(json.dumps(fitted.to_dict())))
    assert type(again.effect) is type(effect)
    assert again.domain == effect.domain
    np.testing.assert_array_equal(again.contribution(signals), fitted.contribution(signals))
    return again


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
        as_read(effect, motion())

    def test_a_single_sample_does_not_fail(self, effect):
        whole = motion()
        joint = next(iter(effect.joints(whole)))
        theta = effect.starts(whole, joint)[0]
        sample = Signals(whole.t[:1], whole.q[:1], whole.qd[:1], whole.qdd[:1], whole.load[:1], whole.torque[:1],
                         whole.friction[:1], rigid=whole.rigid, v_small=whole.v_small)
        assert effect.columns(sample, joint, theta).shape[0] == 1


def test_every_name_of_the_list_is_there():
    known = {"viscous", "coulomb", "degressive", "stribeck", "asymmetric_friction", "load_dependent_friction",
             "thermal_drift", "presliding_hysteresis", "torque_ripple", "current_offset", "drive_gain", "rotor_inertia",
             "gravity_spring", "cable_spring", "payload", "axis_coupling", "dead_time", "joint_elasticity", "backlash",
             "transmission_error", "kinematic_error", "thermal_growth"}
    assert known <= {effect.name for effect in library()}


def test_a_learned_term_fades_to_zero_outside_of_where_it_was_learned():
    """A fall to zero within a tenth of the range made a loop worse that turned round a fifth of the range outside."""
    term = Unknown(("q_1",), False, (tuple(np.linspace(-1.0, 1.0, 6)),))
    inside, *outside, far = (term.basis(replace(motion(count=3), q=np.full((3, 2), x)))
                             for x in (0.3, 1.2, -1.4, 1.7, 2.0))
    np.testing.assert_allclose(inside.sum(axis=1), 1.0, atol=1e-9)
    near, further, out = (basis.sum(axis=1)[0] for basis in outside)
    assert near > 0.97
    assert further > 0.8
    assert out < 0.35
    np.testing.assert_array_equal(far, 0.0)


@pytest.mark.parametrize("key", ["prefix", "head"])
def test_a_learned_curve_of_an_older_file_is_read(key):
    data = {"depends_on": ["q_1"], "directed": False, "knots": [[-1.0, 1.0]], key: "tcp"}
    assert Unknown.from_data(data).channel(2) == "tcp_2"


def test_a_rotor_bends_no_gear_and_an_older_file_says_nothing_of_it():
    signals, effect = motion(), find("joint_elasticity", "qa")
    whole, less = (effect.columns(signals, 1, (rotor,))[:, 0, 0] for rotor in (0.0, 0.3))
    np.testing.assert_allclose(less - whole, 0.3 * signals.qdd[:, 0])
    assert effect.complete(())
    np.testing.assert_array_equal(effect.columns(signals, 1, ())[:, 0, 0], whole)


def test_a_rotor_is_not_looked_for_where_a_poor_model_has_less_than_no_inertia():
    signals, effect = motion(), find("joint_elasticity", "qa")
    vars(signals)["inertia"] = -np.ones((len(signals.t), signals.n))
    assert effect.bounds_near(signals, 1, (0.0,)) == []
    vars(signals)["inertia"] = 0.2 * np.ones((len(signals.t), signals.n))
    assert effect.bounds_near(signals, 1, (0.0,)) == [(-0.2, 0.2)]


def test_the_table_says_of_each_effect_what_its_class_says():
    assert EFFECTS.names() == tuple(effect.key for effect in library())
    assert len(set(EFFECTS.names())) == len(library())


def test_rivals_that_effects_name_are_effects():
    named = {rival for effect in library() for rival, _ in effect.discriminating_motion}
    assert named <= set(names())


class SquareOfPosition(Effect):
    """A torque that no effect of ours makes: ``tau = c sign(sin(7 q))``."""

    name = "square_of_position"
    discriminating_motion = (("cable_spring", "other strokes"),)

    def columns(self, signals, joint, theta):
        return signals.on_joint(joint, np.sign(np.sin(7.0 * signals.q[:, joint - 1])))


@pytest.fixture
def own_effect():
    effect = SquareOfPosition()
    register(effect)
    yield effect
    unregister(effect)


def test_an_own_effect_is_found_by_the_diagnosis(own_effect, tmp_path):
    assert own_effect in library()
    assert "square_of_position" in names()
    t, q, _, tau = strokes()
    diagnosis = diagnose(Recording.from_arrays(t, q=q, tau=tau + 0.7 * np.sign(np.sin(7.0 * q))), arm(tmp_path))
    assert [e.fitted.name for e in diagnosis.effects] == ["square_of_position"]
    assert diagnosis.effects[0].fitted.coefficients[0] == pytest.approx(0.7, rel=0.02)
    assert diagnosis.effects[0].fitted.channel == "tau_1"
    assert discriminating_motion("cable_spring", ("square_of_position",)) == "other strokes"


def test_an_effect_is_registered_once_and_unknown_after_it_was_taken_out():
    effect = SquareOfPosition()
    register(effect)
    with pytest.raises(InputError, match="already"):
        register(SquareOfPosition())
    fitted = FittedEffect(effect.name, 1, "tau_1", (2.0,))
    assert fitted.effect is effect
    unregister(effect)
    with pytest.raises(InputError, match="known are"):
        fitted.contribution(motion())


class Drag(Effect):
    """Grows with the square of speed."""

    name, coefficient_names, coefficient_units = "drag_of_air", ("drag",), ("N m s²/rad²",)
    made: Callable[[np.ndarray], np.ndarray]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> np.ndarray:
        return type(self).made(signals.on_joint(joint, signals.qd[:, joint - 1] * abs(signals.qd[:, joint - 1])))


@pytest.mark.parametrize(("made", "says"), [
    (lambda columns: columns[:, 0], r"have to be \(5000, c, 1\): samples, channels, coefficients"),
    (lambda columns: np.repeat(columns, 2, axis=2), r"\(5000, c, 1\).*got \(5000, 1, 2\)"),
    (lambda columns: columns[1:], r"\(5000, c, 1\).*got \(4999, 1, 1\)"),
    (lambda columns: columns * np.nan, "hold values that are not finite, of joint 1"),
    (lambda columns: columns[:, 9], "effect drag_of_air/tau at joint 1"),
])
def test_columns_of_an_own_effect_that_are_none_are_said(made: Callable[[np.ndarray], np.ndarray], says: str) -> None:
    """Not finite, the effect was never found, and another one named in its place."""
    q = np.sin(np.outer(t := np.arange(0.0, 20.0, 0.004), [1.1, 2.3, 4.7])) @ [0.6, 0.3, 0.1]
    qd = np.gradient(q, t)
    recording = Recording.from_arrays(t, q=q, tau=2.2 * np.gradient(qd, t) + 5.0 * np.tanh(100.0 * qd) + qd * abs(qd))
    own = type("Own", (Drag,), {"made": staticmethod(made)})()
    register(own)
    try:
        with pytest.raises((InputError, IndexError), match=says):
            diagnose(recording, Robot.load(ROOT / "examples" / "own_robot.urdf"))
    finally:
        unregister(own)


    with pytest.raises(InputError, match="expected an Effect; make one of the class"):
        register(Drag)  # type: ignore[arg-type]
