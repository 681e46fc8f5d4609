"""Joints of the chain that follow others: found in URDFs, moved, identified, simulated and written out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.dynamics.base_parameters import FullLayout, base_parameters, full_regressor, link_labels
from ideal_robot.dynamics.consistent_inertias import consistent_parameters
from ideal_robot.dynamics.inverse_kinematics import Tool, tool_jacobian
from ideal_robot.dynamics.newton_euler import chain_of, frames_of, inverse_dynamics, joint_frames
from ideal_robot.dynamics.newton_euler import mass_matrix as compiled_mass_matrix
from ideal_robot.dynamics.regressor import link_parameters, regressor
from ideal_robot.errors import InputError
from ideal_robot.identification.weighted_least_squares import prior_of
from ideal_robot.model.mjcf import arm_of_mjcf, export_mjcf
from ideal_robot.model.model import Model
from ideal_robot.robots.joints import joint_motions, mass_matrix, own_joints, without_followers
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import of_its_size
from sim.arm.arm import SimulatedArm
from sim.arm.world import STEP, World
from tests.arms import INERTIAL, LIFTED, LINK, PALLETIZER, following, urdf, written

Arm = Callable[[Path], Robot]


def drawn(seed: int) -> str:
    """A chain with followers at random places, before and behind what they follow, of mixed kinds."""
    rng = np.random.default_rng(seed)
    count, parts = int(rng.integers(5, 9)), []
    followers = set(rng.choice(count - 1, size=2, replace=False).tolist())
    own = [i for i in range(count) if i not in followers]
    for i in range(count):
        axis = rng.standard_normal(3)
        kind = "prismatic" if rng.uniform() < 0.25 else "revolute"
        place = " ".join(f"{x:.4f}" for x in rng.uniform(-0.3, 0.3, 3))
        mimic = ""
        if i in followers:
            mimic = (f'joint="j{rng.choice(own)}" multiplier="{rng.choice([-1.0, 0.5, -0.3, 2.0]):g}" '
                     f'offset="{rng.uniform(-0.2, 0.2):.3f}"')
        parts.append((f"j{i}", kind, " ".join(f"{x:.5f}" for x in axis / np.linalg.norm(axis)), place,
                      float(rng.uniform(1.0, 5.0)), mimic))
    return following(parts)


@pytest.mark.parametrize("text", [PALLETIZER, LIFTED, *(drawn(seed) for seed in range(12))])
def test_everything_compiled_and_pinocchio_agree_with_the_free_chain(text: str, tmp_path: Path) -> None:
    model = Robot.load(written(tmp_path, text), tool_frame(tmp_path)).pinocchio
    free, motions = without_followers(model), joint_motions(model)
    n, b = model.nv, free.nv
    assert b > n
    G = np.zeros((b, n))
    G[np.arange(b), motions.coordinate] = motions.ratio
    data, own, chain = free.createData(), model.createData(), chain_of(model)
    q, qd, qdd = np.random.default_rng(0).standard_normal((3, 20, n))
    expected = np.array([G.T @ pin.rnea(free, data, motions.angles(a), motions.rates(b), motions.rates(c))
                         for a, b, c in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(inverse_dynamics(chain, q, qd, qdd), expected, atol=1e-9)
    np.testing.assert_allclose(regressor(model, q, qd, qdd) @ link_parameters(model), expected, atol=1e-9)
    tool = Tool.of(model, len(model.frames) - 1)
    J, turned, place, (R, p), M = np.empty((6, n)), np.empty((3, 3)), np.empty(3), frames_of(chain), np.empty((n, n))
    for row in q:
        full = G.T @ np.array(pin.crba(free, data, motions.angles(row))) @ G
        joint_frames(chain, row, R, p)
        compiled_mass_matrix(chain, R, p, M)
        np.testing.assert_allclose(M, full, atol=1e-9)
        np.testing.assert_allclose(mass_matrix(model, own, row), full, atol=1e-9)
        tool_jacobian(tool, row, J, turned, place)
        whole = pin.computeFrameJacobian(free, data, motions.angles(row), len(free.frames) - 1, pin.LOCAL)
        np.testing.assert_allclose(J, np.asarray(whole) @ G, atol=1e-10)
        pin.framesForwardKinematics(free, data, motions.angles(row))
        np.testing.assert_allclose(place, data.oMf[len(free.frames) - 1].translation, atol=1e-10)


def tool_frame(folder: Path) -> Path:
    """Drive data that take the whole chain, whatever it looks like."""
    path = folder / "arm.toml"
    path.write_text('tool_frame = "tool0"\n')
    return path


@pytest.mark.parametrize("text", [PALLETIZER, LIFTED])
def test_base_parameters_and_possible_bodies_of_all_links(text: str, tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, text))
    base, layout = base_parameters(robot.pinocchio), FullLayout.of(robot.pinocchio)
    assert layout.bodies == robot.pinocchio.njoints - 1 > robot.n
    q, qd, qdd = np.random.default_rng(1).standard_normal((3, 200, robot.n))
    true = np.concatenate([link_parameters(robot.pinocchio), np.full(robot.n, 0.3), np.full(robot.n, 0.1)])
    W = full_regressor(robot.pinocchio, q, qd, qdd)
    torque = W @ true
    grouped = W[:, :, list(base.independent)] @ base.of(true)
    np.testing.assert_allclose(grouped, torque, atol=1e-8 * np.abs(torque).max())
    # From a wrong start: bodies 20 % too heavy, and the base parameters as the torques have them.
    wrong = np.concatenate([1.2 * link_parameters(robot.pinocchio), np.full(robot.n, 0.2), np.zeros(robot.n)])
    found = consistent_parameters(base, base.of(true), np.diag(np.full(base.count, 1e-8)), wrong)
    np.testing.assert_allclose(base.of(found.full), base.of(true), atol=1e-3 * np.abs(base.of(true)).max())
    assert found.smallest_eigenvalue.shape == (layout.bodies, 2)
    assert (found.smallest_eigenvalue[:, 1] > 0.0).all()
    assert set(base.joints) <= set(range(1, robot.n + 1))


def test_the_offset_of_a_lift_is_known_to_the_weight_of_all_that_it_lifts(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, LIFTED))
    base = base_parameters(robot.pinocchio)
    rng = np.random.default_rng(4)
    signals: Any = SimpleNamespace(tau=rng.standard_normal((50, robot.n)), qdd=rng.standard_normal((50, robot.n)),
                                   decimate=lambda values: values)
    prior = prior_of(robot, base, [signals], amperes=False)
    # Of the base parameters the offset alone is weight without motion; what is grouped into it adds to its spread.
    offset = base.names.index("offset_1")
    spread = float(np.sqrt(np.linalg.pinv(prior.information, rcond=1e-12)[offset, offset]))
    weight = 9.81 * sum(body.mass for body in list(robot.pinocchio.inertias)[1:])
    assert weight * 0.99 < spread < 3.0 * weight


def test_rods_keep_a_wrist_level_wherever_the_arm_stands(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, PALLETIZER))
    assert (robot.n, robot.tool_frame, robot.assumed) == (4, "tool0", ())
    assert link_labels(robot.pinocchio) == ("1", "2", "2b", "3", "3b", "4")
    assert len(robot.following) == 2
    assert "rods = -1 j2" in robot.following
    pose = robot.fk()
    for q in np.random.default_rng(2).uniform(robot.q_min, robot.q_max, (20, 4)):
        np.testing.assert_allclose(pose(q).rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-6)


def test_a_follower_s_limits_are_those_of_what_it_follows(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, LIFTED))
    # 0.8 q + 0.02 is to stay between 0 and 0.3, and below 2 m/s.
    np.testing.assert_allclose([robot.q_min[0], robot.q_max[0], robot.v_max[0]], [0.0, 0.3, 2.0])
    narrow = LIFTED.replace('multiplier="0.8"', 'multiplier="4"')
    robot = Robot.load(written(tmp_path, narrow, "narrow"))
    np.testing.assert_allclose([robot.q_min[0], robot.q_max[0], robot.v_max[0]], [0.0, 0.07, 0.5])
    with pytest.raises(InputError, match="joints coupled to it"):
        Robot.load(written(tmp_path, LIFTED.replace('offset="0.02"', 'offset="9"'), "none"))


def with_end(beyond: str) -> str:
    """The arm of six joints with something on its flange, or on its links."""
    return urdf(6, mass=2.0).replace("</robot>", beyond + "</robot>")


def with_mimic(text: str, name: str, mimic: str) -> str:
    """A URDF whose joint of a name follows another one."""
    head = f'<joint name="{name}" type="revolute">'
    return text.replace(head, f"{head}<mimic {mimic}/>")


def moved(name: str, parent: str, child: str, mimic: str = "", kind: str = "revolute") -> str:
    """A joint with its link, which may follow another one."""
    return (LINK.format(name=child, inertial=INERTIAL.format(mass=0.2, inertia=0.001))
            + f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="5" velocity="1"/>'
            f'{f"<mimic {mimic}/>" if mimic else ""}</joint>')


@pytest.mark.parametrize("beyond", [
    moved("a", "tool0", "one") + moved("b", "tool0", "two", 'joint="a"'),
    moved("a", "tool0", "one") + moved("b", "one", "two", 'joint="a" multiplier="0.5"'),
    moved("a", "tool0", "one") + moved("b", "one", "two", 'joint="a"') + moved("c", "tool0", "three", 'joint="a"'),
])
def test_what_closes_a_gripper_is_held_whatever_it_is_called(beyond: str, tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, with_end(beyond)))
    assert (robot.n, robot.pinocchio.njoints - 1, robot.tool_frame) == (6, 6, "tool0")
    assert sum("is held" in note for note in robot.assumed) == beyond.count("<joint name")


def test_what_comes_before_the_joint_that_it_follows_leads_it(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, with_mimic(urdf(6, mass=2.0), "joint_2", 'joint="joint_5" multiplier="4"')))
    assert robot.following == ("joint_5 = 0.25 joint_2",)
    assert any("joint_2 moves on its own" in note for note in robot.assumed)


@pytest.mark.parametrize("mimic", ['joint="flange"', 'joint="joint_2" multiplier="0" offset="0.1"'])
def test_what_follows_nothing_that_moves_is_held(mimic: str, tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, with_mimic(urdf(6, mass=2.0), "joint_3", mimic)))
    assert (robot.n, robot.following) == (5, ())
    assert any("joint_3 is held" in note for note in robot.assumed)


def test_what_follows_a_joint_beside_the_chain_moves_on_its_own(tmp_path: Path) -> None:
    # The motor's crank stands beside the chain, which two joints of it follow.
    text = with_mimic(with_mimic(urdf(6, mass=2.0), "joint_2", 'joint="crank" multiplier="0.5"'), "joint_3",
                      'joint="crank" multiplier="-1" offset="0.1"')
    robot = Robot.load(written(tmp_path, text.replace("</robot>", moved("crank", "link_1", "arm_of_it") + "</robot>")))
    assert robot.n == 5
    assert any("joint_2 moves on its own" in note for note in robot.assumed)
    assert robot.following == ("joint_3 = -2 joint_2 +0.1",)


def test_a_follower_of_a_follower_follows_what_leads_both(tmp_path: Path) -> None:
    text = with_mimic(with_mimic(urdf(6, mass=2.0), "joint_3", 'joint="joint_2" multiplier="-1"'), "joint_5",
                      'joint="joint_3" multiplier="0.5" offset="0.2"')
    robot = Robot.load(written(tmp_path, text))
    assert robot.following == ("joint_3 = -1 joint_2", "joint_5 = -0.5 joint_2 +0.2")


@pytest.mark.parametrize("text", [PALLETIZER, LIFTED])
def test_the_simulated_arm_moves_as_its_equation_of_motion_says(text: str, tmp_path: Path) -> None:
    robot = of_its_size(Robot.load(written(tmp_path, text)))
    with SimulatedArm(robot, World.ideal(robot), np.random.default_rng(0)) as arm:
        torques = arm._torques
        assert torques is not None
        assert torques.followers
        q, qd = np.array(arm.q_a), np.zeros(robot.n)
        asked: list[Any] = []
        of_drives = torques.of_drives
        torques.of_drives = lambda a, b, tau: (asked.append((a.copy(), b.copy(), tau.copy())), of_drives(a, b, tau))[1]
        for k in range(25):
            arm.cycle(robot.home + 0.02 * (1.0 - np.cos(0.1 * k)))
        model = arm._model.copy()
        model.armature = np.where(arm._elastic, 0.0, arm._specimen.rotor_inertia)
        data = model.createData()
        for a, b, tau in asked:
            np.testing.assert_allclose(a, q, atol=1e-7)
            acceleration = np.linalg.solve(mass_matrix(model, data, a), tau - pin.nonLinearEffects(model, data, a, b))
            qd = b + STEP * acceleration
            q = a + STEP * qd


def test_an_exported_mjcf_has_its_joints_follow(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = Robot.load(written(tmp_path, PALLETIZER))
    model = Model.nominal(robot)
    export_mjcf(model, tmp_path / "arm.xml")
    spec = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert spec.neq == 2
    assert spec.nv == 6
    data = mujoco.MjData(spec)
    motions = joint_motions(robot.pinocchio)
    q = robot.home + 0.1
    data.qpos[:] = motions.angles(q)
    mujoco.mj_forward(spec, data)
    own = [joint - 1 for joint in own_joints(robot.pinocchio)]
    acceleration = np.linalg.solve(
        mass_matrix(model.dynamics, model.dynamics.createData(), q),
        -pin.computeGeneralizedGravity(model.dynamics, model.dynamics.createData(), q))
    np.testing.assert_allclose(data.qacc[own], acceleration, rtol=0.05, atol=0.5)
    again = arm_of_mjcf(tmp_path / "arm.xml")
    assert again.robot.joint_names == robot.joint_names
    assert again.robot.following == robot.following
    assert not [text for text in again.left_out if "motion" in text or "follow" in text]
    q, qd, qdd = np.random.default_rng(3).uniform(-0.5, 0.5, (3, 20, robot.n))
    np.testing.assert_allclose(again.model.rigid_body(q, qd, qdd), model.rigid_body(q, qd, qdd), rtol=1e-4, atol=1e-3)


def test_massless_links_between_joints_are_written_to_an_mjcf(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    massless = PALLETIZER.replace('mass value="3.0"/><inertia ixx="0.06" iyy="0.06" izz="0.06"',
                                  'mass value="0"/><inertia ixx="0" iyy="0" izz="0"')
    assert massless != PALLETIZER
    robot = of_its_size(Robot.load(written(tmp_path, massless)))
    (tmp_path / "bare.urdf").write_text(massless)
    model = Model.nominal(robot)
    export_mjcf(model, tmp_path / "arm.xml", like=tmp_path / "bare.urdf")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml")).nv == 6
