"""Friction: laws of all models, and what a model lacks, with memory, under load; and the delays of drives.

Delays are exact along their chord, of one joint, of all, of a device; what a drive's cycle holds is none.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.arrays import interpolated
from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import Signals, library
from ideal_robot.effects.drive import LateTorque
from ideal_robot.effects.friction import LawTerm
from ideal_robot.effects.registry import find
from ideal_robot.friction import LAWS, Arctan, CubeRoot, FrictionModel, PerJointFriction, Stribeck, ViscousCoulomb
from ideal_robot.friction.presliding import sliding_direction
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm, strokes
from tests.ideal_robot.effects.test_gears import of_a_moved_arm
from tests.ideal_robot.effects.test_kinematics import ROBOT, swinging_arm, tcp
from tests.ideal_robot.effects.test_laws import motion


def test_terms_are_those_of_the_laws_that_identification_fits() -> None:
    """Of each law that has one a term is an effect: what the diagnosis names, identification can fit."""
    terms = [effect for effect in library() if isinstance(effect, LawTerm)]
    assert {effect.law for effect in terms} == {law for key, law in LAWS if key != "cube_root"}
    signals = motion()
    qd = signals.qd[:, 0]
    for effect in (term for term in terms if term.name != "asymmetric_friction"):
        theta = effect.starts(signals, 1)[0]
        a4 = [1.0 / value if effect.name == "stribeck" else value for value in theta]
        coefficients = np.zeros((len(effect.law.coefficient_names), 1))
        coefficients[effect.term] = 1.0
        law = effect.law(coefficients, np.array(a4)[:, None])
        torque = law.torque(qd[:, None], direction=signals.sliding_direction(1)[:, None])[:, 0]
        np.testing.assert_allclose(effect.columns(signals, 1, theta)[:, 0, 0], torque, rtol=1e-12)


@pytest.mark.parametrize("name", ["coulomb", "stribeck", "load_dependent_friction"])
def test_dry_friction_of_an_effect_builds_up_as_the_models_own_does(name):
    signals = motion()
    friction = PerJointFriction([ViscousCoulomb(np.array([[0.5], [1.0]]), np.array([[0.06]]), presliding=True),
                                 ViscousCoulomb(np.array([[0.5], [1.0]]))])
    known = replace(signals, sliding=friction.sliding(signals.q, signals.qd))
    effect = find(name, "tau")
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


@pytest.mark.parametrize(("exponent", "channel"), [(1.0, "tau_1"), (2.0, "tau_bell_1")])
def test_either_form_is_one_name_with_its_numbers(tmp_path: Path, exponent: float, channel: str) -> None:
    robot, (t, q, qd, tau) = arm(tmp_path), strokes()
    tau = tau + 1.2 * np.tanh(qd / 2e-3) * np.exp(-((np.abs(qd) / 0.2) ** exponent))
    diagnosis = diagnose(Recording.from_arrays(t, q=q, tau=tau), robot)
    assert [(e.fitted.name, e.fitted.channel) for e in diagnosis.effects] == [("stribeck", channel)]
    surplus, speed = (p.value for p in diagnosis.effects[0].fitted.parameters)
    assert surplus == pytest.approx(1.2, rel=0.1)
    assert speed == pytest.approx(0.2, rel=0.1)


def test_teeth_carry_what_is_behind_the_gear():
    signals, effect = of_a_moved_arm().signals, find("load_dependent_friction", "tau")
    column = effect.columns(signals, 2, (0.7,))[:, 1, 0]
    carried = np.abs(signals.load[:, 1] - 0.7 * signals.qdd[:, 1])
    np.testing.assert_allclose(column, carried * signals.sliding_direction(2), atol=1e-12)
    driven = find("load_direction_friction", "tau").columns(signals, 2, (0.7,))[:, 1, 0]
    drives = (signals.load[:, 1] - 0.7 * signals.qdd[:, 1]) * signals.qd[:, 1] > 0.0
    np.testing.assert_allclose(driven[drives], column[drives], atol=1e-12)
    np.testing.assert_allclose(driven[~drives], 0.0, atol=1e-12)
    # Models written before the effect knew of inertia before the gear.
    np.testing.assert_allclose(effect.columns(signals, 2, ()), effect.columns(signals, 2, (0.0,)))


def test_dead_time_is_exact_at_its_chord():
    signals = motion()
    effect = find("dead_time", "tau")
    delay = 3.0 * signals.dt
    late = effect.columns(signals, 1, (delay,))[:, 0, 0] * delay + signals.torque[:, 0]
    np.testing.assert_allclose(late[10:-10], signals.torque[7:-13, 0], atol=1e-9)


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


def test_a_filter_of_first_order_is_a_delay_well_below_its_corner_and_weakens_above():
    t = np.arange(0.0, 6.0, 1e-3)
    torque = np.column_stack([np.sin(2.0 * np.pi * f * t) for f in (1.0, 40.0)])
    signals = Signals(t, *[np.zeros_like(torque)] * 4, torque, np.zeros_like(torque))
    lag, delay = (find(name, "tau").columns(signals, 0, (0.004,))[1000:, :, 0] for name in ("torque_filter",
                                                                                           "common_delay"))
    assert np.std(lag[:, 0] - delay[:, 0]) < 0.02 * np.std(delay[:, 0])
    assert np.std(0.004 * lag[:, 1] + torque[1000:, 1]) == pytest.approx(
        np.std(torque[1000:, 1]) / np.hypot(1.0, 2.0 * np.pi * 40.0 * 0.004), rel=0.01)


def test_one_delay_is_every_joints():
    signals = of_a_moved_arm().signals
    column = find("common_delay", "tau").columns(signals, 0, (0.01,))[:, :, 0]
    steps = round(0.01 / signals.dt)
    late = signals.torque[100 - steps : -100 - steps] - signals.torque[100:-100]
    np.testing.assert_allclose(0.01 * column[100:-100], late, atol=1e-9)


def test_a_late_device_sees_where_the_arm_was():
    signals, h = swinging_arm(2000), 2e-3
    column = find("dead_time", "tcp").columns(signals, 0, ())[:, :, 0]
    before, after = (tcp(ROBOT.pinocchio, interpolated(signals.t - s * h, signals.t, signals.q)) for s in (-1.0, 1.0))
    np.testing.assert_allclose(column[10:-10], ((after - before) / (2 * h))[10:-10], atol=2e-4)


@pytest.mark.parametrize(("name", "prefix", "early"), [("common_delay", "tau", -1.0), ("dead_time", "tau", -1.0),
                                                       ("dead_time", "q", 1.0)])
def test_torques_that_are_held_over_a_cycle_are_not_early(name, prefix, early):
    """Half a cycle of a loop of a kilohertz is in every drive: a torque acts from its stamp on until the next."""
    effect, signals = find(name, prefix), of_a_moved_arm().signals
    for delay, right in ((early * 2e-4, False), (early * 2e-3, True), (-early * 2e-4, True)):
        assert effect.plausible(np.array([delay]), (), signals, 1) == right


# Laws that hold for every friction model.

def example(law: type[FrictionModel], refined: bool, n: int = 3) -> FrictionModel:
    rng = np.random.default_rng(11)
    shape = [[np.sqrt(low * high)] * n for low, high in law.shape_bounds] + [[1e-3] * n] * refined
    return law(rng.uniform(0.5, 2.0, (len(law.coefficient_names) + refined, n)), np.array(shape).reshape(-1, n),
               presliding=refined, loaded=refined)


@pytest.fixture(params=[(key, refined) for key in LAWS.names() for refined in (False, True)], ids=str)
def law(request: pytest.FixtureRequest) -> FrictionModel:
    key, refined = request.param
    return example(LAWS.get(key), refined)


def test_shape_of_torque_follows_velocity(law: FrictionModel) -> None:
    for shape in [(3,), (5, 3), (2, 4, 3)]:
        assert law.torque(np.ones(shape)).shape == shape


def test_brakes_and_is_silent_at_rest(law: FrictionModel) -> None:
    qd = np.random.default_rng(1).normal(size=(200, 3))
    assert np.all(law.torque(qd, load=np.ones_like(qd)) * qd > 0)
    np.testing.assert_array_equal(law.torque(np.zeros((4, 3))), 0.0)


def test_regressor_is_the_torque(law: FrictionModel) -> None:
    qd = np.random.default_rng(2).normal(size=(50, 3))
    load = np.random.default_rng(3).normal(size=(50, 3))
    by_regressor = np.einsum("knm,mn->kn", law.regressor(qd, load), law.coefficients)
    np.testing.assert_allclose(by_regressor, law.torque(qd, load), atol=1e-12)


def test_survives_the_model_file(law: FrictionModel) -> None:
    joints = [type(law)(law.coefficients[:, [j]], law.shape[:, [j]], presliding=law.presliding, loaded=law.loaded)
              for j in range(3)]
    friction = PerJointFriction(joints)
    qd = np.linspace(-2, 2, 30).reshape(10, 3)
    np.testing.assert_array_equal(PerJointFriction.from_dict(friction.to_dict()).torque(qd), friction.torque(qd))
    np.testing.assert_allclose(friction.torque(qd), law.torque(qd), atol=1e-14)


def test_parameters_cannot_be_changed(law: FrictionModel) -> None:
    with pytest.raises(ValueError):
        law.coefficients[0, 0] = 1.0


def test_the_four_equations_of_the_paper() -> None:
    v = np.array([[-0.8], [0.3]])
    s = np.sign(v)
    np.testing.assert_allclose(ViscousCoulomb([[2.0], [3.0]]).torque(v), 2 * v + 3 * s)
    np.testing.assert_allclose(CubeRoot([[2.0], [3.0], [4.0]]).torque(v), 2 * v + 3 * s + 4 * np.cbrt(v))
    np.testing.assert_allclose(Arctan([[2.0], [3.0], [4.0]], [[5.0]]).torque(v), 2 * v + 3 * s + 4 * np.arctan(5 * v))
    np.testing.assert_allclose(Stribeck([[2.0], [3.0], [4.0]], [[5.0]]).torque(v),
                               2 * v + 3 * s + 4 * np.exp(-5 * np.abs(v)) * s)


def test_presliding_turns_over_along_a_distance_and_remembers_at_rest() -> None:
    q = np.concatenate([np.linspace(0, 0.1, 101), np.full(50, 0.1), np.linspace(0.1, 0.0, 101)])[:, None]
    z = sliding_direction(q, np.gradient(q, axis=0), np.array([0.01]))
    assert np.all(np.abs(z) <= 1.0)
    np.testing.assert_allclose(z[100:151], 1.0, atol=1e-4)
    one_distance_back = 151 + 10
    # A twentieth of the distance to leave the noise band in each direction.
    np.testing.assert_allclose(z[one_distance_back], -1.0 + 2.0 * np.exp(-0.9), atol=1e-3)
    np.testing.assert_allclose(z[-1], -1.0, atol=1e-3)


def test_noise_at_rest_does_not_wear_the_memory_down() -> None:
    rng = np.random.default_rng(0)
    q = np.concatenate([np.linspace(0, 0.1, 100), 0.1 + 1e-4 * rng.normal(size=5000)])[:, None]
    assert sliding_direction(q, np.ones_like(q), np.array([0.01]))[-1] > 0.9


def test_presliding_does_not_depend_on_speed() -> None:
    slow = np.sin(np.linspace(0, 12, 4001))[:, None]
    fast = slow[::4]
    z = sliding_direction(slow, np.ones_like(slow), np.array([0.05]))[::4]
    np.testing.assert_allclose(z, sliding_direction(fast, np.ones_like(fast), np.array([0.05])), atol=0.02)


def test_gross_sliding_is_the_law_without_memory() -> None:
    q = np.linspace(0, 5, 500)[:, None]
    qd = np.full_like(q, 0.7)
    with_memory = example(CubeRoot, True, n=1)
    np.testing.assert_allclose(with_memory.torque(qd, q=q), with_memory.torque(qd), atol=1e-12)
