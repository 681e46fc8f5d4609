"""Excitation keeps to the limits and excites; and a rigid arm that it moves, whose truth is known to the last digit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.dynamics import BaseParameters, base_parameters, link_parameters, torques, with_link_parameters
from ideal_robot.errors import InputError
from ideal_robot.friction import FrictionModel, PerJointFriction
from ideal_robot.friction.laws import ViscousCoulomb
from ideal_robot.identification.excitation import (
    FourierMotion,
    Workspace,
    approach,
    clear_of_obstacles,
    design_excitation,
)
from ideal_robot.identification.program import plan_two_step, trapezoid
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.signals.recording import Recording
from tests.arms import SCARA, urdf, written
from tests.sources import ROOT


@cache
def robot(name: str = "kr6") -> Robot:
    return Robot.load(name)


@cache
def base() -> BaseParameters:
    return base_parameters(robot().pinocchio)


@cache
def motion(seed: int = 1, period: float = 12.0) -> FourierMotion:
    return design_excitation(robot(), np.random.default_rng(seed), period=period, trials=30, refinements=60)


@dataclass(frozen=True)
class Truth:
    """Full parameters (links, rotors, offsets) and friction of the arm that is recorded."""

    full: np.ndarray
    friction: PerJointFriction

    @property
    def base(self) -> np.ndarray:
        return base().of(self.full)


def truth(laws: list[FrictionModel] | None = None) -> Truth:
    arm = robot()
    full = np.concatenate([link_parameters(arm.pinocchio), arm.rotor_inertia, 0.01 * arm.tau_max])
    if laws is None:
        laws = [ViscousCoulomb(np.array([[0.02 * tau], [0.04 * tau]])) for tau in arm.tau_max]
    return Truth(full, PerJointFriction(laws))


def record(what: Truth, rng: np.random.Generator, *, noise: float = 0.005, rate: float = 250.0,
           seed: int = 1) -> Recording:
    """A recording of two periods; the noise of the torque is relative to its limit, that of the position 2 µrad."""
    t = np.arange(0.0, 24.0, 1.0 / rate)
    return logged(what, rng, t, motion(seed).at(t), noise)


def logged(what: Truth, rng: np.random.Generator, t: np.ndarray, moved: tuple[np.ndarray, ...], noise: float
           ) -> Recording:
    """What is recorded of a motion: angles, velocities and accelerations ``(N, n)`` at ``t``."""
    arm, (q, qd, qdd) = robot(), moved
    n = arm.n
    load = torques(with_link_parameters(arm.pinocchio, what.full[: 10 * n]), q, qd, qdd)
    tau = load + what.full[10 * n : 11 * n] * qdd + what.full[11 * n :] + what.friction.torque(qd, load, q)
    return Recording.from_arrays(t, q=q + rng.normal(scale=2e-6, size=q.shape),
                                 tau=tau + noise * arm.tau_max * rng.normal(size=tau.shape), source="known truth")


def wrong_by_half(rng: np.random.Generator) -> Robot:
    """The robot with every link's inertias half or one and a half times what they are."""
    arm = robot()
    factors = np.repeat(rng.choice([0.5, 1.5], arm.n), 10)
    return replace(arm, pinocchio=with_link_parameters(arm.pinocchio, link_parameters(arm.pinocchio) * factors))


# Excitation keeps to the limits and excites; trapezoids are what they say.

def test_motion_keeps_to_limits_and_workspace_and_starts_at_rest() -> None:
    arm, excitation = robot(), motion()
    q, qd, qdd = excitation.at(np.linspace(0, excitation.period, 2000))
    assert np.all(q > arm.q_min)
    assert np.all(q < arm.q_max)
    assert np.all(np.abs(qd) < arm.v_max)
    assert np.all(np.abs(qdd) < arm.a_max)
    assert clear_of_obstacles(arm, q[::20], Workspace(z_min=0.05, r_min=0.25)).all()
    np.testing.assert_allclose(qd[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(qdd[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.gradient(q[:, 0], excitation.period / 1999)[5:-5], qd[5:-5, 0], atol=1e-3)


def test_search_lowers_the_condition_number() -> None:
    rough = design_excitation(robot(), np.random.default_rng(3), trials=1, refinements=0)
    assert motion().condition_number < rough.condition_number


def test_impossible_wishes_are_refused() -> None:
    with pytest.raises(InputError, match="harmonics"):
        design_excitation(robot(), np.random.default_rng(0), harmonics=2)
    with pytest.raises(InputError, match="workspace"):
        design_excitation(robot(), np.random.default_rng(0), workspace=Workspace(z_min=9.0), trials=3)


def test_limits_that_nobody_filled_in_are_named() -> None:
    """Both at 0, as exporters write them, gave a motion that leaves the joint at rest and a condition of 1e12."""
    arm = robot()
    shut = np.where(np.arange(arm.n) == 1, 0.0, 1.0)
    with pytest.raises(InputError, match="limits of joint 2 leave it nothing to move"):
        design_excitation(replace(arm, q_min=arm.q_min * shut, q_max=arm.q_max * shut), np.random.default_rng(3))


def test_a_limit_that_is_none_moves_the_motion_nowhere() -> None:
    """With the middle of such a range as the posture to begin with, the way there took years and all memory."""
    arm = robot()
    far = replace(arm, q_max=np.where(np.arange(arm.n) == 1, 1e9, arm.q_max))
    excitation = design_excitation(far, np.random.default_rng(3), trials=2, refinements=0)
    assert np.all(np.abs(excitation.centre - arm.home) < 50.0)


def test_a_way_that_takes_hours_is_refused() -> None:
    with pytest.raises(InputError, match="check them"):
        approach(np.zeros(2), np.array([0.1, 1e9]), 0.012, np.ones(2), np.ones(2))


def test_trapezoid_keeps_velocity_and_acceleration() -> None:
    s = trapezoid(0.5, 0.4, 2.0, 0.001)
    v = np.gradient(s, 0.001)
    assert s[-1] == pytest.approx(0.5)
    assert v.max() == pytest.approx(0.4, rel=1e-3)
    assert np.abs(np.gradient(v, 0.001)[3:-3]).max() < 2.1
    short = trapezoid(0.01, 0.4, 2.0, 0.001)
    assert np.gradient(short, 0.001).max() < 0.4


def test_approach_ends_at_rest_within_the_limits() -> None:
    arm = robot()
    q = approach(arm.home, arm.home + 0.4, 0.012, arm.v_max, arm.a_max)
    np.testing.assert_allclose(q[-1], arm.home + 0.4)
    assert np.all(np.abs(np.diff(q, axis=0)) / 0.012 < arm.v_max)


def test_program_has_every_axis_at_every_operating_point_within_the_limits() -> None:
    arm = robot()
    program = plan_two_step(arm, np.random.default_rng(1), points=3, candidates=40)
    for purpose in ("gravity", "inertia"):
        pairs = {(m.point, m.axis) for m in program.moves if m.purpose == purpose}
        assert pairs == {(k, i + 1) for k in range(3) for i in range(6)}
    commands = program.commands(arm.home, 0.012, arm)
    assert np.all(commands >= arm.q_min)
    assert np.all(commands <= arm.q_max)
    assert np.all(np.abs(np.diff(commands, axis=0)) / 0.012 <= arm.v_max)
    assert program.text().count("PTP") >= 3


# Where an arm may go by default, from its own reach.

OWN = ROOT / "examples" / "own_robot.urdf"


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15", "kr500"])
def test_arms_of_a_metre_and_more_keep_the_usual_distances(name: str) -> None:
    assert Workspace.of(Robot.load(name)) == Workspace()


@pytest.mark.parametrize("seed", range(3))
def test_the_tool_of_a_scara_may_slide_to_below_its_base(seed: int, tmp_path: Path) -> None:
    """Half of its stroke at least; the floor was half as high as the tool is at its highest."""
    rng = np.random.default_rng(seed)
    limit = '<limit lower="-2.3" upper="2.3" effort="100" velocity="4"/>'
    robot = Robot.load(written(tmp_path, SCARA.format(limit=limit, one=rng.uniform(0.2, 0.4), two=rng.uniform(0.2, 0.4),
                                                      up=1, roll=0.0).replace('lower="-0.2"', 'lower="-0.6"')))
    stroke = float(robot.q_max[2] - robot.q_min[2])
    highest = float(robot.fk()(np.array([0.0, 0.0, robot.q_max[2], 0.0])).translation[2])
    assert Workspace.of(robot).z_min < highest - 0.45 * stroke


@pytest.mark.parametrize("joints", [6, 7])
def test_an_arm_that_stands_upright_at_home_comes_down_beside_its_column(joints: int, tmp_path: Path) -> None:
    """Its tool is above the column there; that on the way down it is near the column's axis stopped it."""
    plain = Robot.load(written(tmp_path, urdf(joints, mass=1.0)))
    fk = plain.fk()
    drawn = spread_postures(plain.q_min, plain.q_max, 4000)
    upright = min(drawn, key=lambda q: float(np.hypot(*fk(q).translation[:2]) - fk(q).translation[2]))
    robot = replace(plain, home=upright)
    if Shapes(robot).first_touch(upright[None]) is not None:
        pytest.skip("the drawn posture touches the arm itself")
    way = Workspace.of(robot).on_the_way(robot)
    beside = float(np.hypot(*fk(upright).translation[:2]))
    assert way.r_min <= beside + 1e-9
    assert way.cell is not None
    assert clear_of_obstacles(robot, upright[None], way).all()


def test_a_turntable_on_the_floor_gets_a_motion() -> None:
    """Its tool is at the height of its base: with the usual floor of 0.15 m no motion was found."""
    arm = Robot.load(OWN)
    assert Workspace.of(arm).z_min == 0.0
    motion = design_excitation(arm, np.random.default_rng(1), trials=5, refinements=5)
    assert np.ptp(motion.at(np.linspace(0, motion.period, 200))[0]) > 1.0


def test_a_sliding_axis_on_the_floor_gets_one_too(tmp_path: Path) -> None:
    text = OWN.read_text(encoding="utf-8").replace('type="revolute"', 'type="prismatic"').replace("0 0 1", "1 0 0")
    (tmp_path / "axis.urdf").write_text(text, encoding="utf-8")
    arm = Robot.load(tmp_path / "axis.urdf")
    assert design_excitation(arm, np.random.default_rng(1), trials=5, refinements=0).condition_number < 100
