"""Rotor inertias that no recording tells: a loop that can be simulated, with the inertia that was identified."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.dynamics.newton_euler import inverse_dynamics, joint_frames, mass_matrix
from ideal_robot.loop.rotors import with_rotors
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.postures import spread_postures
from tests.ideal_robot.feedforward.plant import ROBOT, motion, plant, rms

LIMITS = ROBOT.q_min, ROBOT.q_max


def test_what_moves_keeps_its_inertia_and_mass_matrices_stay_positive() -> None:
    chain = plant().chain
    rotor = np.array(ROBOT.rotor_inertia)
    rotor[[0, 3]] = 0.0
    new, made = with_rotors(chain, rotor, *LIMITS)
    assert np.all(made[[0, 3]] > 0)
    np.testing.assert_array_equal(made[[1, 2, 4, 5]], rotor[[1, 2, 4, 5]])
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 20, 6))
    np.testing.assert_allclose(inverse_dynamics(new, q, qd, qdd) + made * qdd,
                               inverse_dynamics(chain, q, qd, qdd) + rotor * qdd, atol=1e-9)
    R, p, M = np.empty((6, 3, 3)), np.empty((6, 3)), np.empty((6, 6))
    for posture in spread_postures(*LIMITS, 500):
        joint_frames(new, posture, R, p)
        mass_matrix(new, R, p, M)
        assert np.linalg.eigvalsh(M)[0] > 0


def test_known_rotors_are_left_alone() -> None:
    chain = plant().chain
    new, made = with_rotors(chain, np.array(ROBOT.rotor_inertia), *LIMITS)
    np.testing.assert_array_equal(made, ROBOT.rotor_inertia)
    np.testing.assert_array_equal(new.armature, 0.0)


@pytest.mark.parametrize("elastic", [True, False])
def test_an_arm_without_known_rotors_is_simulated_as_the_one_it_is(elastic: bool) -> None:
    """Once the identified loop of a URDF without drive data was "unstable in simulation"."""
    whole = plant(elastic=elastic)
    # All inertia of the base joint counted to the link, as identification leaves it where nothing tells them apart.
    unknown, missing = np.array(whole.rotor_inertia), whole.rotor_inertia[0]
    unknown[0] = 0.0
    armature = np.array([missing, 0.0, 0.0, 0.0, 0.0, 0.0])
    chain, rotor = with_rotors(whole.chain._replace(armature=armature), unknown, *LIMITS)
    q_c = motion()
    error = simulate(whole.replace(chain=chain, rotor_inertia=rotor), q_c).q_a - simulate(whole, q_c).q_a
    assert rms(error) < 0.05 * rms(simulate(whole, q_c).q_a[:-1] - q_c)


def test_a_rotor_with_hardly_a_link_behind_a_rigid_gear() -> None:
    """A bare flange does not sag on the gear that stands for a rigid one."""
    whole = plant(elastic=False)
    light = whole.chain._replace(mass=whole.chain.mass * np.array([1, 1, 1, 1, 1, 1e-3]), inertia=whole.chain.inertia
                                 * np.array([1, 1, 1, 1, 1, 1e-3])[:, None, None])
    done = simulate(whole.replace(chain=light), motion())
    assert np.max(np.abs(done.q_a[:, 5] - done.q_m[:, 5])) < 2e-4
