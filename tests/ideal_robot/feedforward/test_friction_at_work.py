"""Friction from a slow motion's torques: a shape that the law has not, where the motion goes, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.friction_at_work import FrictionAtWork, friction_at_work
from ideal_robot.feedforward.method import Setting
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.loop.simulation import simulate
from ideal_robot.signals.recording import Recording
from scenes.model_files import model_at
from tests.ideal_robot.feedforward.plant import ROBOT, T, plant

SPEEDS = np.array([0.01, 0.02, 0.04, 0.08])
"""At which friction is looked at [rad/s]."""


def sticky(loop: LoopModel) -> LoopModel:
    """The loop with a fifth more dry friction at rest, gone from 0.1 rad/s on, that turns over half the angle."""
    more = 1.0 + 0.2 * np.exp(-((loop.friction_velocity / 0.05) ** 2))
    return loop.replace(friction_torque=loop.friction_torque * more, friction_bend=0.5 * loop.friction_bend,
                        friction_dry=loop.friction_dry)


def recorded(loop: LoopModel) -> Recording:
    """Twelve seconds of all joints but the last, back and forth at up to 0.1 rad/s, with noise of the currents."""
    t = T * np.arange(1000)
    moves = np.append(0.1 / np.array([2.1, 2.7, 3.3, 3.9, 4.5]), 0.0)
    q_d = ROBOT.home + moves * (1.0 - np.cos(np.outer(t, [2.1, 2.7, 3.3, 3.9, 4.5, 1.0])))
    done = simulate(loop, q_d)
    noise = 0.005 * loop.tau_max * np.random.default_rng(5).standard_normal(done.tau.shape)
    return Recording.from_arrays(T * np.arange(len(done.q_m)), q=done.q_m, tau=done.tau + noise)


def at_speeds(loop: LoopModel) -> Array:
    """Friction at ``SPEEDS`` over dry friction of the joints ``(4, n)``."""
    dry = loop.friction_dry
    return np.column_stack([np.interp(SPEEDS, loop.friction_velocity[:, j], loop.friction_torque[0, :, j]) / dry[j]
                            for j in range(loop.n)])


@pytest.fixture(scope="module")
def found() -> FrictionAtWork:
    loop = plant()
    return friction_at_work(recorded(sticky(loop)), loop)


def test_friction_that_falls_with_speed_is_found(found: FrictionAtWork) -> None:
    """The law's own is off by a fifth of dry friction where joints move slowly."""
    loop = plant()
    moving = slice(0, loop.n - 1)
    before, after = (np.abs(at_speeds(one) - at_speeds(sticky(loop)))[:, moving] for one in (loop, found.in_loop(loop)))
    assert before.max() > 0.18
    assert np.sqrt(np.mean(after**2, axis=0)).max() < 0.3 * np.sqrt(np.mean(before**2, axis=0)).min()


def test_the_angle_over_which_friction_turns_is_found(found: FrictionAtWork) -> None:
    """Half of what the loop says; of the heavy joints, whose torques the noise leaves clear."""
    assert np.all(found.bend[:3] < 0.75)


def test_a_joint_that_rests_tells_nothing(found: FrictionAtWork) -> None:
    loop = plant()
    np.testing.assert_allclose(at_speeds(found.in_loop(loop))[:, -1], at_speeds(loop)[:, -1], atol=0.01)
    assert found.bend[-1] == 1.0


def test_friction_as_identified_stays() -> None:
    loop = plant()
    same = friction_at_work(recorded(loop), loop).in_loop(loop)
    np.testing.assert_allclose(at_speeds(same), at_speeds(loop), atol=0.03)


def test_methods_are_made_with_it(found: FrictionAtWork) -> None:
    model = model_at("shipped", ROBOT)
    plain = Setting(ROBOT, model, 20).loop()
    other = Setting(ROBOT, model, 20, friction=found).loop()
    np.testing.assert_array_equal(other.friction_torque, found.in_loop(plain).friction_torque)
    assert not np.allclose(other.friction_torque, plain.friction_torque)


def test_a_recording_without_torques_is_refused() -> None:
    loop = plant()
    q = np.tile(ROBOT.home, (400, 1)) + 0.01 * np.sin(np.arange(400) * T)[:, None]
    with pytest.raises(InputError, match="torques"):
        friction_at_work(Recording.from_arrays(T * np.arange(400), q=q), loop)
    with pytest.raises(InputError, match="joints"):
        friction_at_work(Recording.from_arrays(T * np.arange(400), q=q[:, :3], tau=q[:, :3]), loop)


def test_ripple_that_the_loop_knows_is_no_friction() -> None:
    """Two thirds of dry friction, over three of its periods at most: taken for friction it bends the curve."""
    loop = plant()
    waves = np.stack([np.full(loop.n, 25.0), 0.6 * loop.friction_dry, 0.3 * loop.friction_dry])[None]
    rippled = loop.replace(ripple=waves)
    same = friction_at_work(recorded(rippled), rippled).in_loop(rippled)
    moving = slice(0, loop.n - 1)
    np.testing.assert_allclose(at_speeds(same)[:, moving], at_speeds(loop)[:, moving], atol=0.03)
