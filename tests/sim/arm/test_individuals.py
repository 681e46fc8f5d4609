"""Drawn arms: how far they differ from their data, the plate before them, what makes their controllers stable."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot
from sim.arm.body import _lay as lay
from sim.arm.generic import LAG, growth
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from sim.bullet import pybullet

ROBOT, IDEAL = Robot.load("kr6"), World.ideal("kr6")


def test_masses_and_rotors_use_the_whole_of_their_tolerance_and_no_more() -> None:
    """Of 60 drawn arms: masses within the tolerance, rotors and sizes within a third of it, each nearly reached."""
    tolerance, nominal = 0.15, ROBOT.pinocchio.inertias
    world = IDEAL.replace(inertia_tolerance=tolerance)
    arms = [draw_specimen(ROBOT, world.replace(individual=seed)) for seed in range(1, 61)]
    mass = np.array([[one.model.inertias[j].mass / nominal[j].mass - 1.0 for j in range(1, 7)] for one in arms])
    rotor = np.array([one.rotor_inertia / ROBOT.rotor_inertia - 1.0 for one in arms])
    lever = np.array([[one.model.inertias[j].lever / np.where(nominal[j].lever == 0.0, np.nan, nominal[j].lever) - 1.0
                       for j in range(1, 7)] for one in arms])
    for off, most in ((mass, tolerance), (rotor, tolerance / 3.0), (lever, tolerance / 3.0)):
        assert 0.93 * most < np.nanmax(np.abs(off)) <= most
        assert 0.85 * most < np.nanmax(off)
        assert np.nanmin(off) < -0.85 * most


def test_more_mass_of_the_same_shape_has_as_much_more_inertia() -> None:
    """Second moments of a body f times as heavy and a, b, c times as long: f a², f b², f c² of what they were."""
    for seed in range(1, 6):
        arm = draw_specimen(ROBOT, IDEAL.replace(inertia_tolerance=0.2, individual=seed))
        for j in range(1, 7):
            here, there = ROBOT.pinocchio.inertias[j], arm.model.inertias[j]
            factor = there.mass / here.mass
            second, after = (0.5 * np.trace(one.inertia) * np.eye(3) - one.inertia for one in (here, there))
            stretch = np.diag(after) / (factor * np.diag(second))
            assert np.all(np.abs(np.sqrt(stretch) - 1.0) <= 0.2 / 3.0 + 1e-9)
            moved = here.lever != 0.0
            np.testing.assert_allclose(there.lever[moved] / here.lever[moved], np.sqrt(stretch)[moved], rtol=1e-6)


@pytest.mark.parametrize("kind", ["kinematic_error", "zero_error", "twist_error"])
def test_every_joint_is_displaced_within_its_error_and_in_its_own_way(kind: str) -> None:
    error = 1e-3
    nominal = ROBOT.pinocchio.jointPlacements
    found = []
    for seed in range(1, 21):
        model = draw_specimen(ROBOT, IDEAL.replace(individual=seed, **{kind: error})).model
        moved = [(nominal[j].rotation.T @ (model.jointPlacements[j].translation - nominal[j].translation),
                  pin.log3(model.jointPlacements[j].rotation @ nominal[j].rotation.T),
                  pin.log3(nominal[j].rotation.T @ model.jointPlacements[j].rotation)) for j in range(1, 7)]
        offset, in_parent, own = (np.array(one) for one in zip(*moved, strict=True))
        size = {"kinematic_error": np.linalg.norm(offset, axis=1), "zero_error": np.linalg.norm(own, axis=1),
                "twist_error": np.linalg.norm(in_parent, axis=1)}[kind]
        found.append(size)
        if kind == "zero_error":
            # About the joint's own axis.
            axes = [ROBOT.pinocchio.joints[j].shortname() for j in range(1, 7)]
            for name, turn in zip(axes, own, strict=True):
                np.testing.assert_allclose(np.delete(turn, "XYZ".index(name[-1])), 0.0, atol=1e-9)
        if kind != "kinematic_error":
            np.testing.assert_allclose(offset, 0.0, atol=1e-12)
        else:
            np.testing.assert_allclose(own, 0.0, atol=1e-12)
    most = np.max(found, axis=0)
    bound = error * (1.0 if kind == "zero_error" else np.sqrt(3.0))
    assert np.all(most <= bound + 1e-12)
    assert np.all(most > 0.6 * error)
    # No two joints share their draw.
    assert len(np.unique(np.round(found[0], 9))) == 6


def test_a_plate_lies_under_the_corners_of_the_paper() -> None:
    """Its upper side is 2 mm below them, whatever the paper's slope, so that a line on it is not hidden."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        turn = pin.exp3(np.array([0.2, -0.1, 0.7]))
        for corners in (np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0.3, 0], [0, 0.3, 0.0]]),
                        np.array([[0, 0, 0], [0, 0.3, 0], [0.4, 0.3, 0], [0.4, 0, 0.0]])):
            placed = corners @ turn.T + np.array([0.9, 0.1, 0.4])
            lay(placed, client)
            body = pybullet.getNumBodies(client) - 1
            place, quaternion = pybullet.getBasePositionAndOrientation(body, client)
            size = np.array(pybullet.getVisualShapeData(body, physicsClientId=client)[0][3])
            rotation = np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
            assert (rotation @ [0, 0, 1]) @ turn[:, 2] == pytest.approx(1.0)
            np.testing.assert_allclose(np.sort(size), [0.01, 0.3, 0.4], atol=1e-9)
            inside = (placed - place) @ rotation
            expected = [0.5 * size[0], 0.5 * size[1], 0.007]
            np.testing.assert_allclose(np.abs(inside), np.tile(expected, (4, 1)), atol=1e-7)
            assert np.all(inside[:, 2] > 0.0)
    finally:
        pybullet.disconnect(client)


# The stability that worlds of any arm are made by.

@pytest.mark.parametrize("seed", range(8))
def test_growth_is_that_of_the_characteristic_polynomial(seed: int) -> None:
    """P and PI control of a rotor behind two lags, with a link on a spring: the roots of 1 + C(s) L(s) G(s) = 0."""
    rng = np.random.default_rng(seed)
    J, link, k, d = rng.uniform(1.0, 20.0), rng.uniform(1.0, 50.0), 10.0 ** rng.uniform(4, 6), rng.uniform(1.0, 300.0)
    gain, k_v, T_i = rng.uniform(50.0, 2000.0), rng.uniform(5.0, 40.0), rng.uniform(0.02, 0.2)
    p = np.polynomial.polynomial
    plant = p.polymul([0.0, 0.0, 1.0], [k * (J + link), d * (J + link), J * link])
    lags = p.polypow([1.0, 0.5 * LAG], 2)
    open_loop = p.polymul(p.polymul([0.0, 1.0], lags), plant)
    control = gain * p.polymul(p.polymul([k_v, 1.0], [1.0 / T_i, 1.0]), [k, d, link])
    roots = p.polyroots(p.polyadd(open_loop, control))
    np.testing.assert_allclose(growth(gain, J, link, k, d, k_v, T_i), roots.real.max(), rtol=1e-4, atol=1e-3)
