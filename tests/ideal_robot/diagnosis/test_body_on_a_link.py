"""A body that the given model does not know: on the flange it is a payload, on another link a load of that link."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.search.choice import Choice, Options
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.misfit import with_misfit
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.effects.registry import find
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.known_arm import harmonics, point_mass


def carrying(name: str, link: int, mass: float, at: np.ndarray, left: float = 0.02) -> tuple[Problem, Robot]:
    """An arm whose parameters are known, with a point mass fixed to one of its links.

    Args:
        name: of a shipped robot.
        link: that carries it, from 1.
        mass: of the body [kg].
        at: where, in the frame of the link's joint ``(3,)`` [m].
        left: what of the torques of joints 1 to 3 no model knows, as a share of them; two hundredths of a wrist's.
    """
    robot, rng, t = Robot.load(name), np.random.default_rng(2), np.arange(0.0, 24.0, 0.004)
    q, qd, qdd = harmonics(rng, t, robot.home, 0.25, (0.8, 5.0), 4)
    model = Model.nominal(robot)
    columns = regressor(robot.pinocchio, q, qd, qdd)[:, :, 10 * link - 10 : 10 * link]
    tau = model.inverse_dynamics(q, qd, qdd) + columns @ point_mass(mass, at)
    # What rotors do with the inertia of a wrist is known no better than this.
    share = np.where(np.arange(robot.n) < 3, left, 0.02)
    tau = tau + share * np.std(tau, axis=0) * np.sin(7.0 * q) + 0.002 * np.std(tau, axis=0) * rng.normal(size=q.shape)
    made = torque_regression(Recording.from_arrays(t, q=q, tau=tau), robot, model, payload=True)
    problem = Problem(made, time_blocks(len(made.t), float(made.t[1] - made.t[0]), held_out=True))
    return problem.with_prior(1e9 * np.eye(made.W.shape[2])), robot


@pytest.mark.parametrize("name", ["kr6", "kr15"])
@pytest.mark.parametrize("mass", [1.0, 5.0])
def test_a_body_on_the_flange_is_a_payload_of_its_mass(name, mass):
    # On the axis of the last joint it turns like a body on the link before.
    robot = Robot.load(name)
    flange = robot.tool_place
    problem, robot = carrying(name, robot.n, mass, np.asarray(flange))
    bodies = tuple((e.name, j) for e in library() if e.domain == MOTOR_TORQUE and e.name in ("payload", "link_load")
                   for j in e.joints(problem.regression.signals))
    search = Search(problem, library(), Options(), np.random.default_rng(0), absorbed=True, only=bodies)
    choices = search.run()
    assert [(c.candidate.effect.name, c.candidate.joint) for c in choices] == [("payload", 0)]
    (found,) = problem.fit([choices[0].candidate]).coefficients
    assert found[0] == pytest.approx(mass, rel=0.1)


def test_a_body_on_an_inner_link_is_a_load_of_that_link():
    problem, _ = carrying("kr6", 3, 3.0, np.array([0.2, 0.05, 0.0]))
    bodies = (("payload", 0), *(("link_load", j) for j in range(1, 6)))
    choices = Search(problem, library(), Options(), np.random.default_rng(0), absorbed=True, only=bodies).run()
    assert (choices[0].candidate.effect.name, choices[0].candidate.joint) == ("link_load", 3)


def test_a_light_body_is_a_payload_by_its_weight_at_the_wrist():
    """Its mass hides in what the strong joints leave; a rotor or a filter of the wrist has no weight."""
    robot = Robot.load("kr15")
    flange = robot.tool_place
    problem, _ = carrying("kr15", robot.n, 0.1, flange + np.array([0.02, -0.04, 0.05]), left=0.05)
    payload = Candidate(find("payload", "tau"), 0)
    final = problem.on_all_blocks().fit([payload], uncertainty=True)
    domain = DomainDiagnosis(problem, [Choice(payload, 1e-9, asked=0.1)], final, None, True, "")
    wide = with_misfit(problem, [payload], final)
    assert abs(wide.coefficients[0][0]) < 3.0 * wide.std[0][0]
    settled, dropped = domain.settled()
    assert [choice.candidate.effect.name for choice in settled.choices] == ["payload"]
    assert not dropped
