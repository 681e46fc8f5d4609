"""Diagnosis against a model that identification made of another recording of the same arm."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.arm import arm_angle_regression, with_loose_weights
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.prior import SAME
from ideal_robot.diagnosis.report import argument
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.refit import with_named_effects
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import MOTOR_TORQUE, FittedEffect, library
from ideal_robot.effects.registry import find
from ideal_robot.friction import PerJointFriction, ViscousCoulomb
from ideal_robot.identification.idim import identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from studies.strangers.arm import STEP, arm_of, draw_motion
from studies.strangers.engines import ENGINES
from studies.strangers.logger import record
from studies.strangers.plant import BRISTLE, TANH
from tests.arms import a_logger, a_plant, an_arm, written
from tests.ideal_robot.diagnosis.test_diagnose import arm, torque

# What tests of causes beside a known model draw alike: a motion of all joints, and a body of no extent.

def harmonics(rng: np.random.Generator, t: Array, middle: Array, size: float,
              frequencies: tuple[float, float], count: int) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations ``(N, n)`` of ``count`` random sines [rad/s] about ``middle``."""
    frequency, phase = rng.uniform(*frequencies, (count, len(middle))), rng.uniform(0.0, 6.0, (count, len(middle)))
    angle = t[:, None, None] * frequency + phase
    return (middle + size * np.sin(angle).sum(axis=1), size * (frequency * np.cos(angle)).sum(axis=1),
            -size * (frequency**2 * np.sin(angle)).sum(axis=1))


def point_mass(mass: float, at: Array) -> Array:
    """Mass, first moments and inertias ``(10,)`` of a mass [kg] at a place ``(3,)`` [m], in Pinocchio's order."""
    return np.asarray(pin.Inertia(mass, np.asarray(at, dtype=float), np.zeros((3, 3))).toDynamicParameters())


def with_spring(part: float, spring: float, seed: int, about: float = 0.0) -> Recording:
    """One joint that moves over a part of its range, with a spring about the middle of that."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.004)
    x = part * (0.6 * np.sin(0.7 * t + seed) + 0.3 * np.sin(1.9 * t) + 0.2 * np.sin(3.1 * t))
    tau = torque(t, about + x) + spring * x + 0.03 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q=(about + x)[:, None], tau=tau[:, None])


def test_a_spring_is_named_where_the_motion_shows_it_and_parameters_keep_near_to_what_was_known(tmp_path):
    robot = arm(tmp_path)
    model = identify([with_spring(1.0, 0.0, 1)], robot).model
    healthy = diagnose(with_spring(1.0, 0.0, 2), robot, model=model)
    assert (healthy.verdict, healthy.taken_for) == ("none", SAME)
    seen = diagnose(with_spring(1.0, 6.0, 2), robot, model=model)
    assert [e.fitted.name for e in seen.effects] == ["cable_spring"]
    assert seen.effects[0].fitted.coefficients[0] == pytest.approx(6.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mujoco", "integrator"])
def test_a_healthy_recording_against_the_model_of_another_one_in_strangers_physics(engine, tmp_path):
    four = an_arm(seed=5, n=4)
    plant = dataclasses.replace(a_plant(four, kind=TANH if engine == "integrator" else BRISTLE))
    rng = np.random.default_rng(8)
    logger, logged = a_logger(rng, 4), []
    for seed in range(2):
        run = ENGINES[engine](plant, draw_motion(rng, four, 20.0, "fourier"))
        logged.append(record(dataclasses.replace(logger, seed=seed, noise=0.005 * np.std(run.tau, axis=0)), plant, run))
    robot = Robot.load(written(tmp_path, four.urdf))
    diagnosis = diagnose(logged[1], robot, model=identify([logged[0]], robot).model)
    assert [(e.fitted.name, e.fitted.joint) for e in (*diagnosis.effects, *diagnosis.unknown)] == []
    assert diagnosis.verdict == "none"


def in_world(world: World, seed: int, rng: np.random.Generator) -> Recording:
    """A KR 6 of a world along a Fourier motion of its own."""
    robot = Robot.load("kr6")
    motion = draw_motion(rng, arm_of(rng, "kr6", robot.urdf.read_text(encoding="utf-8")), 40.0, "fourier")
    with SimulatedArm(robot, world, np.random.default_rng(seed)) as simulated:
        for s in np.linspace(0.0, 1.0, 200):
            simulated.cycle(robot.home + (motion.q[0] - robot.home) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        for q in motion.q[:: round(world.t_ipo / STEP)]:
            simulated.cycle(q)
        return simulated.recording()


@pytest.mark.slow
@pytest.mark.parametrize("bare", [pytest.param(True, id="rigid gears without ripple"),
                                  pytest.param(False, id="as it is")])
def test_a_healthy_recording_of_our_world_against_the_model_of_another_one(bare):
    # What identification has no parameters for is truly there, and found, in the default world: gears and ripples.
    robot, world = Robot.load("kr6"), World.default("kr6")
    world, effects = (world.replace(torque_ripple=0.0, elasticity=False), set()) if bare else (
        world, {"torque_ripple", "joint_elasticity"})
    rng = np.random.default_rng(3)
    first, second = (in_world(world, seed, rng) for seed in (4, 5))
    model: Model = identify([first], robot).model
    diagnosis = diagnose(second, robot, model=model)
    assert {e.fitted.name for e in (*diagnosis.effects, *diagnosis.unknown)} <= effects
    assert diagnosis.verdict == ("effects" if effects else "none")


@pytest.mark.slow
def test_where_their_delay_is_named_a_model_made_of_late_torques_is_that_of_punctual_ones(tmp_path):
    two = an_arm(seed=5, n=4)
    plant, rng = a_plant(two, kind=TANH), np.random.default_rng(8)
    run = ENGINES["integrator"](plant, draw_motion(rng, two, 25.0, "fourier"))
    logger = a_logger(rng, 4, noise=0.005 * np.std(run.tau, axis=0))
    robot = Robot.load(written(tmp_path, two.urdf))

    def viscous(lag: float) -> np.ndarray:
        model = diagnose(record(dataclasses.replace(logger, lag=lag), plant, run), robot,
                         only=(("common_delay", 0),)).model
        assert [effect.name for effect in model.effects] == ["common_delay"] * (lag > 0.0)
        return np.array([p.value for p in model.parameters if p.name.startswith("Fv_")])

    # Inertia that is late by 8 ms is friction: left in the parameters it changes some of these by more than a tenth.
    np.testing.assert_allclose(viscous(0.008), viscous(0.0), rtol=0.04)


# What is named is estimated beside a model that stays as it is: nothing else moves, and it has its true size.

STICKS = FittedEffect("stribeck", 2, "tau_2", (60.0,), theta=(0.05,))


def with_coulomb(robot: Robot, levels: list[float]) -> Model:
    laws = [ViscousCoulomb(np.array([[100.0], [level]])) for level in levels]
    return dataclasses.replace(Model.nominal(robot), friction=PerJointFriction(laws))


def recorded(model: Model) -> Recording:
    t = 0.004 * np.arange(2000.0)
    rate = 0.7 + 0.2 * np.arange(model.n)
    phase = np.outer(t, rate) + np.arange(model.n)
    q, qd, qdd = 0.3 * np.sin(phase), 0.3 * rate * np.cos(phase), -0.3 * rate**2 * np.sin(phase)
    tau = model.inverse_dynamics(q, qd, qdd, t=t)
    tau = tau + np.random.default_rng(1).normal(0.0, 1.0, tau.shape)
    columns = {"t": t, **{f"q_{i + 1}": q[:, i].copy() for i in range(model.n)},
               **{f"tau_{i + 1}": tau[:, i].copy() for i in range(model.n)}}
    return Recording(columns, {"robot": model.arm.name})


OFFSET = FittedEffect("current_offset", 3, "tau_3", (8.0,))


@pytest.fixture(scope="module")
def known_kr15():
    robot = Robot.load("kr15")
    known = with_coulomb(robot, [100.0] * robot.n)
    # What the model does not say well: without its being held, it would move with the effects.
    known = dataclasses.replace(known, covariance=np.diag(np.full(len(known.covariance), 1e2)))
    return robot, known, recorded(known.with_effects((STICKS, OFFSET)))


def test_oracle_finds_sizes_and_leaves_the_model_as_it_was(known_kr15):
    robot, known, recording = known_kr15
    extended = with_named_effects(recording, robot, known, (("stribeck", 2), ("current_offset", 3)))
    np.testing.assert_array_equal(extended.base_values, known.base_values)
    assert [law.coefficients.tolist() for law in extended.friction.laws] == [
        law.coefficients.tolist() for law in known.friction.laws]
    assert [effect.name for effect in extended.effects] == ["stribeck", "current_offset"]
    assert extended.effects[1].coefficients[0] == pytest.approx(8.0, rel=0.1)
    before, after = (model.predict(recording).relative_error_percent for model in (known, extended))
    assert np.all(after[1:3] < 0.6 * before[1:3])


def test_errors_of_several_joints_kinematics_are_estimated_together(known_kr15):
    """Each alone takes all that the others make as well: together they would count it several times."""
    robot, known, recording = known_kr15
    q = recording.joints("q")
    x = robot.tool_places(q)
    columns = {**recording.columns, **dict(zip("xyz", (x + 2e-4 * np.sin(3.0 * q[:, 1:2])).T.copy(), strict=True))}
    tracked = dataclasses.replace(recording, columns=columns)
    every = tuple(("kinematic_error", joint) for joint in range(1, 7))
    jointly = with_named_effects(tracked, robot, known, every)
    alone = [with_named_effects(tracked, robot, known, (error,)).effects[0] for error in every]
    size = [np.linalg.norm([effect.coefficients for effect in effects], axis=1) for effects in (jointly.effects, alone)]
    assert not np.allclose(size[0], size[1], rtol=0.1)


@pytest.mark.parametrize("reversals", [0, 1, 3])
def test_what_a_spring_bends_its_gear_by_is_open_however_often_the_joint_turns_round(known_kr15, reversals):
    robot, known, recording = known_kr15
    t = np.arange(0.0, 4.0, 0.004)
    q = recording.joints("q").mean(axis=0) + 0.4 * np.cos(np.pi * (reversals + 1) * t / t[-1])[:, None]
    short = Recording.from_arrays(t, q=q, tau=np.zeros_like(q), qa=q)
    angles = arm_angle_regression(short, robot, torque_regression(short, robot, known), None)
    springs = [Candidate(effect, joint, effect.starts(angles.signals, joint)[0])
               for joint in (2, 3) for effect in (find("gravity_spring", "tau"),)]
    unmeasured = dataclasses.replace(angles, use=angles.use & (np.arange(robot.n) != 2))
    assert with_loose_weights(angles, springs).W.shape[2] == angles.W.shape[2] + 4
    assert with_loose_weights(unmeasured, springs).W.shape[2] == angles.W.shape[2] + 2


# A body that the given model does not know: on the flange it is a payload, on another link a load of that link.

def carrying(name: str, link: int, mass: float, at: np.ndarray, left: float = 0.02) -> tuple[Problem, Robot]:
    """An arm whose parameters are known, with a point mass [kg] ``at`` a place in the frame of a link's joint [m].

    ``left``: what of the torques of joints 1 to 3 no model knows, as a share of them; two hundredths of a wrist's.
    """
    robot, rng, t = Robot.load(name), np.random.default_rng(2), np.arange(0.0, 24.0, 0.004)
    q, qd, qdd = harmonics(rng, t, robot.home, 0.25, (0.8, 5.0), 4)
    model = Model.nominal(robot)
    columns = regressor(robot.pinocchio, q, qd, qdd)[:, :, 10 * link - 10 : 10 * link]
    tau = model.inverse_dynamics(q, qd, qdd) + columns @ point_mass(mass, at)
    # What rotors do with the inertia of a wrist is known no better than this.
    share = np.where(np.arange(robot.n) < 3, left, 0.02)
    tau = tau + share * np.std(tau, axis=0) * np.sin(7.0 * q) + 0.002 * np.std(tau, axis=0) * rng.normal(size=q.shape)
    regression = torque_regression(Recording.from_arrays(t, q=q, tau=tau), robot, model, payload=True)
    problem = Problem(regression)
    return problem.with_root(10.0**-4.5 * np.eye(regression.W.shape[2])), robot


@pytest.mark.parametrize(("name", "mass"), [("kr6", 5.0), ("kr15", 1.0)])
def test_a_body_on_the_flange_is_a_payload_of_its_mass(name, mass):
    # On the axis of the last joint it turns like a body on the link before.
    robot = Robot.load(name)
    problem, _ = carrying(name, robot.n, mass, robot.tool_place)
    bodies = tuple((e.name, j) for e in library() if e.domain == MOTOR_TORQUE and e.name in ("payload", "link_load")
                   for j in e.joints(problem.regression.signals))
    best = BestSet(problem, library(), absorbed=True, only=bodies)
    choices = [choice for choice in best.run() if best.matters(choice)]
    assert [(c.effect.name, c.joint) for c in choices] == [("payload", 0)]
    (coefficients,) = problem.fit([choices[0]]).coefficients
    assert coefficients[0] == pytest.approx(mass, rel=0.1)


def test_a_body_on_an_inner_link_is_a_load_of_that_link():
    problem, _ = carrying("kr6", 3, 3.0, np.array([0.2, 0.05, 0.0]))
    bodies = (("payload", 0), *(("link_load", j) for j in range(1, 6)))
    best = BestSet(problem, library(), absorbed=True, only=bodies)
    first = best.run()[0]
    near = [(s.name, s.joint) for s in argument(best, first).sets if s.nats < 10.0]
    # The forearm turns little about itself here: the same body may hang on the link behind.
    assert ("link_load", 3) in [(first.effect.name, first.joint), *near]
