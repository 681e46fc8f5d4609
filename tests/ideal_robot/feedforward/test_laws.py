"""What every feedforward has to obey, whatever it does."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.learning import Playback
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.feedforward.training import train
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.model.controller_model import ControllerModel
from ideal_robot.model.model import Model
from tests.ideal_robot.feedforward.plant import ROBOT, T, commands, motion, plant

LIMITS = ROBOT.q_min, ROBOT.q_max


def nominal_model() -> Model:
    """The data sheet's model with the plant's controller and gears."""
    loop = plant()
    controller = ControllerModel(
        t_cycle=0.002, k_p=loop.k_p * loop.k_v, k_d=loop.k_p * loop.k_ff, k_1=loop.k_p * (loop.k_ff - 1),
        k_2=loop.k_p * loop.t_filter, k_i=loop.k_i / loop.k_p * 0.002, filter_time=np.full(6, 1.5e-3), filter_order=2)
    return dataclasses.replace(Model.nominal(ROBOT), controller=controller, stiffness=np.array(loop.stiffness),
                               damping=np.array(loop.damping))


def trained():
    q_d = motion()
    return train([(q_d, q_d + 1e-3 * np.sin(np.arange(len(q_d)))[:, None])], T, chain=plant().chain, limits=LIMITS)


MAKERS = {
    "none": lambda: PassThrough(T),
    "linear": lambda: LinearInverse(LinearLoop.of(plant(), ROBOT.home), limits=LIMITS),
    "trained": trained,
    "trained_on_ideal": lambda: train([(motion(), motion())], T, base=IdealRobot(plant()), limits=LIMITS),
    "precorrected_1": lambda: Precorrection(nominal_model(), ROBOT),
    "precorrected": lambda: Precorrection.complete(nominal_model(), ROBOT, delay=1),
    "learned": lambda: Playback(motion(), T),
    "ideal": lambda: IdealRobot(plant()),
    "ideal_rigid": lambda: IdealRobot(plant(), elastic=False),
    "adapted": lambda: AdaptedIdeal(IdealRobot(plant())),
}
RIGID = ("none", "linear", "trained", "precorrected_1", "learned", "ideal_rigid")
"""Those that do not compensate the gears' deflection, so that at rest nothing may be left of the correction."""


@pytest.fixture(scope="module", params=MAKERS)
def named(request):
    return request.param, MAKERS[request.param]()


def test_shape_and_finiteness(named):
    q_d = motion()
    q_c = commands(named[1], q_d)
    assert q_c.shape == q_d.shape
    assert np.isfinite(q_c).all()


def test_a_step_changes_neither_state_nor_input_and_repeats_bit_for_bit(named):
    feedforward = named[1]
    q_d = motion()
    state = feedforward.init(q_d[0])
    for k in range(50, 55):
        horizon = q_d[k : k + 30].copy()
        before = copy.deepcopy(state)
        first, _ = feedforward.step(state, horizon)
        second, following = feedforward.step(before, horizon)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(horizon, q_d[k : k + 30])
        state = following


def test_at_rest_the_command_comes_to_rest(named):
    q_d = np.tile(ROBOT.home, (260, 1))
    q_c = commands(named[1], q_d)
    assert np.max(np.abs(np.diff(q_c[-30:], axis=0))) < 1e-5


def test_the_correction_vanishes_at_rest_so_that_static_accuracy_is_untouched(named):
    key, feedforward = named
    if key not in RIGID:
        pytest.skip("compensates the gears' deflection at rest on purpose")
    if key == "trained":
        pytest.skip("has the deflection under gravity in its third sum on purpose")
    q_d = np.concatenate([motion(), np.tile(ROBOT.home, (150, 1))])
    q_c = commands(feedforward, q_d)
    # After the motion u_d of [G] (18) fades with the integrator's time constant of 50 ms.
    assert np.max(np.abs(q_c[-1] - ROBOT.home)) < 1e-6


def test_commands_stay_within_the_limits(named):
    key, feedforward = named
    if key in ("none", "learned"):
        pytest.skip("plays what it is given")
    far = np.where(np.arange(ROBOT.n) % 2 == 0, ROBOT.q_max, ROBOT.q_min)
    q_d = ROBOT.home + np.linspace(0, 1, 80)[:, None] * (far - ROBOT.home)
    q_c = commands(feedforward, q_d)
    assert np.all(q_c <= ROBOT.q_max + 1e-12)
    assert np.all(q_c >= ROBOT.q_min - 1e-12)


def test_a_longer_horizon_than_needed_changes_nothing(named):
    feedforward = named[1]
    q_d = motion()
    np.testing.assert_allclose(commands(feedforward, q_d, 45), commands(feedforward, q_d, max(30, feedforward.n_d)),
                               atol=1e-12)


def test_a_horizon_of_one_is_borne(named):
    q_c = commands(named[1], motion(), 1)
    assert np.isfinite(q_c).all()
    # Without a horizon no law can be good; it must not be wild either: 0.1 rad is what the arm moves in four cycles.
    assert np.max(np.abs(q_c - motion())) < 0.1
