"""The model of one arm by one motion: masses and ripple from those of another of its type, and what is left open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.dynamics import full_regressor
from ideal_robot.dynamics.consistent_inertias import consistent_parameters
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward import arm_of_its_type as arm_of_its_type_module
from ideal_robot.feedforward.arm_of_its_type import RIPPLE, arm_of_its_type
from ideal_robot.feedforward.training_motion import training_motion
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from tests.arms import ROBOT, motion
from tests.sources import MODELS

DT = 0.002


def other_arm(model: Model) -> Model:
    """Links heavier and lighter by up to a tenth, ripple turned by two radians."""
    factor = np.repeat([1.05, 0.93, 1.1, 0.94, 1.08, 0.95], 10)
    full = np.array(model.consistent)
    full[: 10 * model.n] *= factor
    turned = [np.exp(2j) * complex(*effect.coefficients) if effect.name == RIPPLE else None for effect in model.effects]
    effects = tuple(effect if wave is None else replace(effect, coefficients=(wave.real, wave.imag))
                    for effect, wave in zip(model.effects, turned, strict=True))
    return replace(with_bodies(model, full), effects=effects)


def with_bodies(model: Model, full: Array) -> Model:
    return replace(model, consistent=full, base_values=model.base_values + model.base.of(full - model.consistent))


def with_tool(model: Model, mass: float) -> Model:
    """The arm with a point mass [kg] 5 cm beside the middle of its tool."""
    place = ROBOT.tool_place + np.array([0.05, 0.0, 0.0])
    full, n = np.array(model.consistent), model.n
    full[10 * n - 10 : 10 * n] += pin.Inertia(mass, place, np.zeros((3, 3))).toDynamicParameters()
    return with_bodies(model, full)


def moved(scale: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Times, positions and their derivatives of the motion about a path that adaptation learns from."""
    q = ROBOT.home + scale * (training_motion(motion(), DT) - ROBOT.home)
    qd = np.gradient(q, DT, axis=0)
    return DT * np.arange(len(q)), q, qd, np.gradient(qd, DT, axis=0)


def recorded(arm: Model, friction: float = 1.0) -> Recording:
    """That motion of an arm, with noise of the currents, and friction that has changed since."""
    t, q, qd, qdd = moved()
    more = (friction - 1.0) * arm.friction.torque(qd, arm.rigid_body(q, qd, qdd), q)
    tau = arm.inverse_dynamics(q, qd, qdd, t=t) + more
    noise = 0.002 * np.array(ROBOT.tau_max) * np.random.default_rng(4).standard_normal(q.shape)
    return Recording.from_arrays(t, q=q, tau=tau + noise)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(MODELS / "kr15.json")


def test_masses_and_ripple_of_the_arm_that_moved_are_found(model: Model) -> None:
    true = other_arm(model)
    estimate = arm_of_its_type(recorded(true, friction=1.2), model, ROBOT)
    off = [bodies_apart(arm, true)[1:3] for arm in (model, estimate)]
    assert np.all(off[1] < 0.3 * off[0]), off
    waves = [[np.array(e.coefficients) for e in arm.effects if e.name == RIPPLE] for arm in (true, estimate)]
    assert len(waves[0]) >= 5
    for wave, ours in zip(*waves, strict=True):
        assert np.linalg.norm(ours - wave) < 0.5 * np.linalg.norm(wave)


def bodies_apart(one: Model, other: Model) -> Array:
    """Torque by which the links of two models differ on a motion ``(n,)`` [N m], root mean square."""
    _, *motion_ = moved(scale=0.8)
    return np.asarray(np.sqrt(np.mean((one.rigid_body(*motion_) - other.rigid_body(*motion_)) ** 2, axis=0)))


def left_open(model: Model) -> Array:
    """Standard deviation of the links' torque on that motion by what identification left open ``(n,)`` [N m]."""
    b, (_, *motion_) = model.base.count, moved(scale=0.8)
    counts = full_regressor(model.kinematics, *(some[::20] for some in motion_), model.base.independent)
    variance = np.einsum("knp,pr,knr->kn", counts, model.covariance[:b, :b], counts)
    return np.asarray(np.sqrt(np.mean(variance, axis=0)))


@pytest.mark.parametrize("friction", [1.0, 1.3])
def test_the_very_arm_is_not_another_one(model: Model, friction: float) -> None:
    """What its model says exactly is not changed by noise, nor by friction, a third of what is left open at most."""
    estimate = arm_of_its_type(recorded(model, friction), model, ROBOT)
    assert estimate.effects is model.effects
    assert np.all(bodies_apart(estimate, model) < left_open(model) / 3.0)


@pytest.mark.parametrize("friction", [1.0, 1.3])
def test_a_heavier_tool_is_not_another_arm(model: Model, friction: float) -> None:
    """Half of what the arm may carry; taken for links it would bend the gears at postures that were not played.

    The last joint turns about its axis: the tool's weight is nothing to it.
    """
    heavy = with_tool(model, 8.0)
    estimate = arm_of_its_type(recorded(heavy, friction), model, ROBOT)
    assert estimate.effects is model.effects
    assert np.all(bodies_apart(estimate, model)[:5] < 0.1 * bodies_apart(heavy, model)[:5])


@pytest.mark.parametrize("joint", [2, 3])
def test_what_identification_left_open_of_the_very_arm_is_found(model: Model, joint: int) -> None:
    """Bodies two standard deviations away in the direction in which a joint's torque is known worst."""
    b, (_, *motion_) = model.base.count, moved(scale=0.8)
    counts = full_regressor(model.kinematics, *(some[::20] for some in motion_), model.base.independent)[:, joint - 1]
    covariance = model.covariance[:b, :b]
    values, vectors = np.linalg.eigh(counts @ covariance @ counts.T)
    change = covariance @ counts.T @ vectors[:, -1] / np.sqrt(values[-1])
    true = replace(model, base_values=model.base_values + 2.0 * change,
                   consistent=consistent_parameters(model.base, model.base_values + 2.0 * change, covariance,
                                                    np.array(model.consistent)).full)
    estimate = arm_of_its_type(recorded(true, friction=1.2), model, ROBOT)
    assert estimate.effects is model.effects
    assert bodies_apart(estimate, true)[joint - 1] < 0.5 * bodies_apart(model, true)[joint - 1]


def test_another_arm_is_found_with_a_heavier_tool_too(model: Model) -> None:
    true = with_tool(other_arm(model), 8.0)
    estimate = arm_of_its_type(recorded(true), model, ROBOT)
    off = [bodies_apart(arm, true)[1:3] for arm in (model, estimate)]
    assert np.all(off[1] < 0.3 * off[0]), off


def at_once(model: Model, joint: int) -> Model:
    """The model with friction of one joint (from 1) that turns at once at a reversal."""
    laws = list(model.friction.laws)
    law = laws[joint - 1]
    assert law.presliding
    laws[joint - 1] = type(law)(law.coefficients, law.shape[:-1], presliding=False, loaded=law.loaded)
    return replace(model, friction=PerJointFriction(laws))


def test_a_joint_whose_friction_turns_at_once_counts_like_any_other(model: Model) -> None:
    """Of its sliding the law says nothing; taken as that, no torque of the arm was a number."""
    sudden = at_once(model, 2)
    assert arm_of_its_type(recorded(sudden), sudden, ROBOT).effects is sudden.effects
    estimate = arm_of_its_type(recorded(other_arm(sudden)), sudden, ROBOT)
    assert estimate.effects is not sudden.effects
    assert np.isfinite(estimate.base_values).all()


def test_what_holds_a_joint_at_rest_is_not_taken_for_weight(model: Model) -> None:
    """Friction at rest is whatever balances the rest, up to the dry one: taken for weight it was 1.8 % of that here."""
    true = other_arm(model)
    moving = recorded(true)
    dry = true.friction.torque(np.full((1, true.n), 1e-9))[0]
    _, _, qd, _ = moved()
    at_rest = np.all(np.abs(qd) < 1e-9, axis=1)
    assert 300 < at_rest.sum() < 0.3 * len(qd)
    held = Recording.from_arrays(moving.t, q=moving.joints("q"),
                                 tau=moving.joints("tau") + 0.5 * dry * at_rest[:, None])
    off = bodies_apart(*(arm_of_its_type(recording, model, ROBOT) for recording in (moving, held)))
    assert np.all(off < 0.01 * dry), off / dry


def test_bodies_stay_possible(model: Model) -> None:
    estimate = arm_of_its_type(recorded(other_arm(model)), model, ROBOT)
    assert np.all(estimate.rotor_inertia >= 0.0)
    assert all(np.all(np.linalg.eigvalsh(body.inertia) > 0.0) for body in list(estimate.dynamics.inertias)[1:])


def test_what_tells_nothing_of_masses_changes_nothing(model: Model) -> None:
    whole = recorded(other_arm(model))
    once_a_cycle = Recording.from_arrays(whole.t[::6], q=whole.joints("q")[::6], tau=whole.joints("tau")[::6])
    assert arm_of_its_type(once_a_cycle, model, ROBOT) is model
    assert arm_of_its_type(Recording.from_arrays(whole.t, q=whole.joints("q")), model, ROBOT) is model


def test_another_number_of_joints_is_refused(model: Model) -> None:
    whole = recorded(model)
    with pytest.raises(InputError, match="joints"):
        arm_of_its_type(Recording.from_arrays(whole.t, q=whole.joints("q")[:, :3], tau=whole.joints("tau")[:, :3]),
                        model, ROBOT)


def test_where_no_bodies_can_be_found_the_model_stays(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_found(*_: object) -> None:
        raise IdealRobotError("no solution")

    monkeypatch.setattr(arm_of_its_type_module, "consistent_parameters", none_found)
    assert arm_of_its_type(recorded(other_arm(model)), model, ROBOT) is model


def test_links_of_a_soft_arm_move_behind_its_gears(model: Model) -> None:
    """Gears a fifth as stiff, bent by up to half a degree: the very arm is none, and another one's masses are found."""
    soft = replace(model, gears=Gears(model.gears.stiffness / 5.0, model.gears.damping))

    def recorded_behind_gears(arm: Model) -> Recording:
        t, arm_side, qd, qdd = moved()
        q = arm_side + arm.rigid_body(arm_side, qd, qdd) / arm.gears.stiffness
        v, a = np.gradient(q, DT, axis=0), np.gradient(np.gradient(q, DT, axis=0), DT, axis=0)
        tau = arm.inverse_dynamics(q, v, a, t=t) - arm.rigid_body(q, v, a) + arm.rigid_body(arm_side, qd, qdd)
        return Recording.from_arrays(t, q=q, tau=tau)

    rigid, unknown = (replace(soft, gears=Gears(np.where(np.arange(6) == 5, value, soft.gears.stiffness)))
                      for value in (np.inf, np.nan))
    of_rigid, of_unknown = (arm_of_its_type(recorded_behind_gears(rigid), model, ROBOT) for model in (rigid, unknown))
    np.testing.assert_array_equal(of_rigid.base_values, of_unknown.base_values)
    very = arm_of_its_type(recorded_behind_gears(soft), soft, ROBOT)
    assert very.effects is soft.effects
    assert np.all(bodies_apart(very, soft) < 0.5 * left_open(soft))
    true = other_arm(soft)
    estimate = arm_of_its_type(recorded_behind_gears(true), soft, ROBOT)
    off = [bodies_apart(arm, true)[1:3] for arm in (soft, estimate)]
    assert np.all(off[1] < np.array([0.05, 0.4]) * off[0]), off
