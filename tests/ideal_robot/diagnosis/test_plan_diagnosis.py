"""The motion that a diagnosis asks for: it tells apart what the recording could not, within the limits, or says so."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from ideal_robot.diagnosis import Open, diagnose, plan_diagnosis, read_questions
from ideal_robot.diagnosis.next_motion.plan import _planned_pair
from ideal_robot.diagnosis.next_motion.questions import Named
from ideal_robot.diagnosis.next_motion.separation import Cause, Pair, Separation
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.effects import Effect
from ideal_robot.effects.registry import find
from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import Workspace
from ideal_robot.identification.program import require_within_limits
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.poor_recording import TRUTH, poor_arm, poor_recording, recording_of

ANYWHERE = Workspace(z_min=-np.inf, r_min=0.0)
RIVAL = "torque_ripple"
"""Of the cause, as the poor recording has it."""


def asked(name: str, joint: int, rival: str) -> Open:
    return Open((Named(name, joint, "tau", ((rival, joint),)),))


@pytest.fixture(scope="module")
def planned():
    first = poor_recording()
    with poor_arm() as (plain, robot):
        yield first, plain, robot, plan_diagnosis(first, robot, asked(*TRUTH, RIVAL), workspace=ANYWHERE)


def test_planned_motion_tells_apart_what_the_recording_did_not(planned):
    first, plain, robot, plan = planned
    assert not diagnose(first, plain).effects
    (effect,) = diagnose(recording_of(plan.commands, robot.t_ipo), plain).effects
    assert (effect.fitted.name, effect.fitted.joint, effect.indistinguishable_from) == (*TRUTH, ())
    (pair,) = plan.pairs
    assert pair.told_apart
    assert pair.planned.sigma > 1.5 * pair.before.sigma


def test_motion_stays_within_limits_and_rests_at_its_ends(planned):
    _, _, robot, plan = planned
    q, dt = plan.commands, robot.t_ipo
    assert plan.seconds <= 30.0
    assert np.all((q >= robot.q_min) & (q <= robot.q_max))
    speed = np.diff(q, axis=0) / dt
    assert np.all(np.abs(speed) <= robot.v_max)
    assert np.all(np.abs(np.diff(speed, axis=0)) / dt <= 1.0001 * robot.a_max)
    assert not np.any(speed[0])
    assert not np.any(speed[-1])
    assert list(plan.path().columns) == ["t", "q_d_1", "q_d_2", "q_c_1", "q_c_2"]


@pytest.mark.parametrize("limit", ["position", "speed", "acceleration"])
def test_motion_that_leaves_a_limit_is_refused(planned, limit):
    _, _, robot, plan = planned
    q = plan.commands
    tight = {"position": {"q_max": np.array([robot.q_max[0], q[:, 1].max() - 1e-3])},
             "speed": {"v_max": np.array([np.inf, 1e-3])}, "acceleration": {"a_max": np.array([np.inf, 1e-3])}}[limit]
    with pytest.raises(InputError, match=f"{limit} limit of joint 2"):
        require_within_limits(dataclasses.replace(robot, **tight), q, ANYWHERE)


def test_motion_that_touches_the_base_plane_is_refused_where_no_cell_is_named():
    robot = Robot.load("kr6")
    low = robot.home.copy()
    low[1] += 1.4
    assert Shapes(robot).first_touch(robot.home[None]) is None
    assert Shapes(robot).first_touch(low[None]) is not None
    ramp = np.clip(np.linspace(-0.2, 1.2, 4000), 0.0, 1.0)
    ease = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    with pytest.raises(InputError, match="touches"):
        require_within_limits(robot, robot.home + ease[:, None] * (low - robot.home), ANYWHERE)


def test_gear_that_motors_cannot_show_is_left_to_a_device_on_the_arm_side(planned):
    """What noise hides is computed; what would show it then follows from the library: some gears have an arm side."""
    first, _, _, _ = planned
    hidden = Separation(1.2, 0.9, 0.01)
    clear = Separation(12.0, 0.9, 0.4)

    def said(name: str, after: Separation, recording: Recording = first) -> str:
        causes = [Cause(Candidate(find(cause, "tau"), 2, ()), np.ones(1), ((),)) for cause in (name, "dead_time")]
        pair = Pair(causes[0], causes[1], (), np.ones(2), 1.0, None)
        return _planned_pair(pair, hidden, after, recording).only

    assert "arm's side" in said("joint_elasticity", hidden)
    assert "clamped" in said("joint_elasticity", hidden)
    assert said("joint_elasticity", clear) == ""
    assert "arm's side" not in said("joint_elasticity", Separation(1.2, 0.9, 0.01), with_arm_angles(first))


def test_noise_hides_what_it_is_larger_than():
    """Twice the noise halves the distance of two causes; two motions together are never worse than one."""
    rows = np.linspace(0.0, 1.0, 400)
    regression = SimpleNamespace(W=np.ones((400, 1, 1)), use=np.ones((400, 1), dtype=bool), signals=rows,
                                 columns_of=lambda effect, joint, theta: effect.columns(rows, joint, theta))

    def pair(weight: float) -> Pair:
        causes = [Cause(Candidate(Power(power), 1), np.ones(1), ((),)) for power in (2, 3)]
        return Pair(causes[0], causes[1], (), np.array([weight]), 1.0, None)

    once = pair(1.0).separation(pair(1.0).products(regression))
    noisy = pair(0.25).separation(pair(0.25).products(regression))
    assert noisy.sigma == pytest.approx(0.5 * once.sigma, rel=1e-6)
    assert noisy.own_share == pytest.approx(once.own_share, rel=1e-6)
    # By hand: what of x² a straight line in x³ with a constant leaves.
    x2, A = rows**2, np.column_stack([np.ones(400), rows**3])
    by_hand = np.sqrt(np.sum((x2 - A @ np.linalg.lstsq(A, x2, rcond=None)[0]) ** 2))
    x3, B = rows**3, np.column_stack([np.ones(400), rows**2])
    other = np.sqrt(np.sum((x3 - B @ np.linalg.lstsq(B, x3, rcond=None)[0]) ** 2))
    assert once.sigma == pytest.approx(min(by_hand, other), rel=1e-3)
    twice = pair(1.0).products(regression) + pair(1.0).products(regression)
    assert pair(1.0).separation(twice).sigma == pytest.approx(np.sqrt(2.0) * once.sigma, rel=1e-6)


class Power(Effect):
    """A torque that goes with a power of the only signal."""

    name = "power"

    def __init__(self, power: int) -> None:
        self.power = power

    def columns(self, signals, joint, theta):
        return (signals**self.power)[:, None, None]


def with_arm_angles(recording: Recording) -> Recording:
    columns = dict(recording.columns)
    return Recording({**columns, **{f"qa_{i}": columns[f"q_{i}"] for i in (1, 2)}})


@pytest.mark.slow
def test_undecided_joint_is_made_to_move():
    columns = dict(poor_recording().columns)
    columns["q_2"] = np.full_like(columns["q_2"], columns["q_2"][0])
    with poor_arm() as (_, robot):
        plan = plan_diagnosis(Recording(columns), robot, Open((), (2,)), workspace=ANYWHERE, longest=12.0)
    assert plan.useful
    assert not plan.still_undecided
    assert np.ptp(plan.commands[:, 1]) > 0.1
    assert {pair.rival for pair in plan.pairs} == {""}


@pytest.mark.slow
def test_currents_without_known_gains_are_planned_for_in_their_own_units(planned):
    """Each joint has a gain of its own, so they share no inertia; what told torques apart tells currents apart."""
    first, plain, *_ = planned
    columns = {f"current_{name[4:]}" if name.startswith("tau_") else name:
               values / 20.0 ** int(name[4:]) if name.startswith("tau_") else values
               for name, values in first.columns.items()}
    unknown = dataclasses.replace(plain, drive_gain=np.ones(plain.n))
    (pair,) = plan_diagnosis(Recording(columns), unknown, asked(*TRUTH, RIVAL), workspace=ANYWHERE).pairs
    assert pair.told_apart


def test_nothing_open_needs_no_motion(planned):
    first, _, robot, _ = planned
    plan = plan_diagnosis(first, robot, Open((Named("degressive", 2, "tau"),)))
    assert not plan.pairs
    assert not plan.useful
    with pytest.raises(InputError, match="no motion"):
        plan.path()


def test_where_the_recording_has_been_is_free():
    robot = Robot.load("kr6")
    low = robot.home + np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0])
    wide = Workspace(z_min=5.0, r_min=9.0, z_free=9.0).widened(robot, np.array([low]))
    assert wide.z_min < 5.0
    assert wide.r_min < 9.0


@pytest.mark.parametrize(("values", "field"), [
    ([], "effects"),
    ({"effects": [{"effect": [], "joint": 1}]}, "effects.0.effect"),
    ({"effects": [{"effect": "gremlin", "joint": 1}]}, "effects.0.effect"),
    ({"effects": [{"effect": "stribeck", "joint": 7}]}, "effects.0.joint"),
    ({"effects": [{"effect": "stribeck", "joint": 1, "indistinguishable_from": ["gremlin"]}]},
     "effects.0.indistinguishable_from"),
    ({"effects": [], "undecided": [{"joint": 9}]}, "undecided"),
    ({"effects": [], "undecided": [{"joint": True}]}, "undecided"),
])
def test_wrong_result_is_named(values, field):
    with pytest.raises(InputError) as caught:
        read_questions(values, 6)
    assert caught.value.field == field


def test_result_is_read_as_it_was_written():
    values = {"effects": [{"effect": "kinematic_error", "joint": 2, "channel": "tcp_2",
                           "indistinguishable_from": ["kinematic_error of joint 3", "dead_time"]}],
              "undecided": [{"joint": 4, "reason": "rests"}]}
    questions = read_questions(values, 6)
    assert questions.asks
    assert questions.undecided == (4,)
    assert questions.found[0].rivals == (("kinematic_error", 3), ("dead_time", None))
