"""Diagnosis against a model that identification made of another recording of the same arm."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.identification.idim import identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.diagnosis.page import summary
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from tests.ideal_robot.diagnosis.test_diagnose import arm
from tests.trials.strangers.plants import a_plant, an_arm
from trials.strangers.arm import arm_of
from trials.strangers.engines import ENGINES
from trials.strangers.logger import draw_logger, record
from trials.strangers.motion import STEP, draw_motion
from trials.strangers.plant import BRISTLE, TANH


def with_spring(part: float, spring: float, seed: int, about: float = 0.0) -> Recording:
    """One joint that moves over a part of its range, with a spring about the middle of that."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.004)
    x = part * (0.6 * np.sin(0.7 * t + seed) + 0.3 * np.sin(1.9 * t) + 0.2 * np.sin(3.1 * t))
    q, qd, qdd = about + x, np.gradient(x, t), np.gradient(np.gradient(x, t), t)
    tau = 0.6 * qdd - 14.7 * np.cos(q) + 2.0 * np.tanh(qd / 2e-3) + 1.5 * qd + spring * x
    return Recording.from_arrays(t, q=q[:, None], tau=(tau + 0.03 * rng.normal(size=len(t)))[:, None])


def test_a_spring_that_refitting_swallows_is_said_with_the_parameters_that_moved(tmp_path):
    one = arm(tmp_path)
    model = identify([with_spring(1.0, 0.0, 1)], one).model
    healthy = diagnose(with_spring(1.0, 0.0, 2), one, model=model)
    assert (healthy.verdict, healthy.refitted) == ("none", ())
    # Over all of the range a spring is a spring; over little of it, heavier links.
    seen = diagnose(with_spring(1.0, 6.0, 2), one, model=model)
    assert ([e.fitted.name for e in seen.effects], seen.refitted) == (["cable_spring"], ())
    swallowed = diagnose(with_spring(0.1, 6.0, 2, about=0.8), one, model=model)
    assert not swallowed.effects
    assert swallowed.verdict == "unknown"
    (said,) = swallowed.refitted
    assert (said.joint, said.channel) == (1, "tau_1")
    assert said.rms_refit < 0.2 * said.rms_before
    assert {"mx_1", "mz_1"} & {p.name for p in said.moved}
    assert all(abs(p.sigmas) > 3.0 for p in said.moved)
    (values,) = swallowed.to_dict()["explained_by_refitting"]
    assert values["moved"][0]["name"] == said.moved[0].name
    assert "range" in values["would_tell"]
    # With the parameters as they were it is there: six newton metres per radian over 0.2 rad, whatever its name.
    assert seen.beside_known == healthy.beside_known == ()
    assert swallowed.to_dict()["with_parameters_held"][0][0]["joint"] == 1
    assert swallowed.beside_known
    for effects in swallowed.beside_known:
        assert np.ptp(effects[0].coefficients) == pytest.approx(1.2, rel=0.1)
    assert "Nothing is missing" not in summary(swallowed)


@pytest.mark.parametrize("engine", ["mujoco", "integrator"])
def test_a_healthy_recording_against_the_model_of_another_one_in_strangers_physics(engine, tmp_path):
    four = an_arm(seed=5, n=4)
    plant = dataclasses.replace(a_plant(four, kind=TANH if engine == "integrator" else BRISTLE))
    rng = np.random.default_rng(8)
    logger = dataclasses.replace(
        draw_logger(rng, 4, ()), every=8, torque="sampled", encoder=1e-5, jitter=0.0, dropped=0.0, spikes=0.0,
        temp=(), xy=False)
    made = []
    for seed in range(2):
        run = ENGINES[engine](plant, draw_motion(rng, four, 30.0, "fourier"))
        made.append(record(dataclasses.replace(logger, seed=seed, noise=0.005 * np.std(run.tau, axis=0)), plant, run))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(four.urdf, encoding="utf-8")
    robot = Robot.load(urdf)
    found = diagnose(made[1], robot, model=identify([made[0]], robot).model)
    assert [(e.fitted.name, e.fitted.joint) for e in (*found.effects, *found.unknown)] == []
    assert found.verdict == "none"


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
    world, there = (world.replace(torque_ripple=0.0, elasticity=False), set()) if bare else (
        world, {"torque_ripple", "joint_elasticity"})
    rng = np.random.default_rng(3)
    first, second = (in_world(world, seed, rng) for seed in (4, 5))
    model: Model = identify([first], robot).model
    found = diagnose(second, robot, model=model)
    assert {e.fitted.name for e in (*found.effects, *found.unknown)} <= there
    assert found.verdict == ("effects" if there else "none")


def test_a_model_made_of_late_torques_is_no_other_than_one_made_of_punctual_ones(tmp_path):
    two = an_arm(seed=5, n=4)
    plant, rng = a_plant(two, kind=TANH), np.random.default_rng(8)
    run = ENGINES["integrator"](plant, draw_motion(rng, two, 25.0, "fourier"))
    logger = dataclasses.replace(
        draw_logger(rng, 4, ()), every=8, torque="sampled", encoder=1e-5, jitter=0.0, dropped=0.0, spikes=0.0,
        temp=(), xy=False, noise=0.005 * np.std(run.tau, axis=0))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(two.urdf, encoding="utf-8")
    robot = Robot.load(urdf)

    def viscous(lag: float) -> np.ndarray:
        model = diagnose(record(dataclasses.replace(logger, lag=lag), plant, run), robot, only=()).model
        assert not model.effects
        return np.array([p.value for p in model.parameters if p.name.startswith("Fv_")])

    # Inertia that is late by 8 ms is friction: left in the parameters it changes some of these by more than a tenth.
    np.testing.assert_allclose(viscous(0.008), viscous(0.0), rtol=0.04)
