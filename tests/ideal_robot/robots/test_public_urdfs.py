"""URDFs as makers publish them: the arm in them is found, and what they leave open is taken from its class and told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import FLOOR, Shapes
from ideal_robot.robots.robot import SHIPPED, Robot
from ideal_robot.robots.size import MASS, class_of, of_its_size, reach
from tests.arms import GRIPPER, urdf, written


@pytest.mark.parametrize("joints", [5, 6, 7])
def test_a_bare_chain_is_read_with_its_tool_frame(joints: int, tmp_path: Path) -> None:
    """A fixed joint's axis may be 0 0 0, and a frame fixed to the base does not become the tool."""
    robot = Robot.load(written(tmp_path, urdf(joints)))
    assert (robot.n, robot.tool_frame, robot.assumed) == (joints, "tool0", ())


def test_a_gripper_is_held_where_it_rests_and_weighs_on_the_last_link(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, urdf(6, mass=3.0, beyond=GRIPPER)))
    assert (robot.n, robot.tool_frame) == (6, "tool0")
    assert [one.split()[1] for one in robot.assumed] == ["left_finger", "right_finger"]
    assert robot.pinocchio.inertias[6].mass == pytest.approx(3.1)
    # The one finger's lower limit is above 0, so that is where it rests.
    hand, left = (robot.pinocchio.frames[robot.pinocchio.getFrameId(name)].placement for name in ("hand", "left"))
    np.testing.assert_allclose(hand.actInv(left).translation, [0.0, 0.01, 0.0], atol=1e-12)


def test_a_jaw_behind_the_last_joint_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    jaw = ('<link name="moving_jaw"/><joint name="gripper" type="revolute"><parent link="tool0"/>'
           '<child link="moving_jaw"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>')
    assert Robot.load(written(tmp_path, urdf(5, beyond=jaw))).n == 5


def test_a_tool_frame_with_x_ahead_gets_one_with_z_ahead(tmp_path: Path) -> None:
    """As URDFs of before the frame tool0 have it; a link called as its joint may be the tool, too."""
    ahead = urdf(6).replace('rpy="0 1.5707963 0"', 'rpy="0 0 0"').replace('name="flange"', 'name="tool0"')
    robot = Robot.load(written(tmp_path, ahead))
    assert "last joint's axis" in robot.assumed[0]
    usual = Robot.load(written(tmp_path, urdf(6), "usual"))
    q = np.full(6, 0.3)
    np.testing.assert_allclose(robot.fk()(q).translation, usual.fk()(q).translation, atol=1e-9)
    np.testing.assert_allclose(robot.fk()(q).rotation[:, 2], usual.fk()(q).rotation[:, 2], atol=1e-6)
    robot.urdf.with_suffix(".toml").write_text('tool_frame = "tool0"\n')
    named = Robot.load(robot.urdf)
    assert named.assumed == ()
    np.testing.assert_allclose(named.fk()(q).rotation[:, 0], usual.fk()(q).rotation[:, 2], atol=1e-6)


def test_a_finger_is_no_tool_and_a_fixed_joint_follows_none(tmp_path: Path) -> None:
    fixed = GRIPPER.replace('type="prismatic"', 'type="fixed"').replace('<link name="left"/>', "").replace(
        'link="left"', 'link="finger_tip"').replace('name="left"', 'name="finger_tip"')
    bare = urdf(6, beyond=fixed).replace("tool0", "plate")
    robot = Robot.load(written(tmp_path, bare))
    assert robot.tool_frame == "right"
    assert Robot.load(written(tmp_path, bare.replace("right", "thumb"), "thumb")).tool_frame == "hand"


def test_joints_that_turn_without_end_or_slide_are_read(tmp_path: Path) -> None:
    endless = Robot.load(written(tmp_path, urdf(6, kind="continuous")))
    assert endless.q_max[0] == pytest.approx(2.0 * np.pi)
    assert "joint_1" in endless.assumed[0]
    assert Robot.load(written(tmp_path, urdf(6, kind="prismatic"), "slide")).prismatic.tolist() == [True] + 5 * [False]


def test_a_start_posture_lies_inside_the_limits(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, urdf(7, limit='lower="-3.1" upper="-0.1" effort="87" velocity="2"')))
    np.testing.assert_allclose(robot.home, -1.6)


@pytest.mark.parametrize(("change", "says"), [
    (('<joint name="joint_4" type="revolute">', '<joint name="joint_4" type="revolute"><mimic joint="joint_2"/>'),
     "follows another one"),
    (('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'), "an axis needs a direction"),
])
def test_what_cannot_be_an_arm_is_said_with_its_joint(change: tuple[str, str], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says) as refused:
        Robot.load(written(tmp_path, urdf(6).replace(*change, 1)))
    assert str(refused.value.field).startswith("joint_")


def test_two_arms_need_a_word(tmp_path: Path) -> None:
    one = urdf(6).replace("base_link", "left_base").replace("</robot>", "").replace('<robot name="bare">', "")
    two = one.replace("link_", "other_link_").replace("left_base", "right_base").replace('"joint_', '"other_joint_') \
        .replace("tool0", "tool1").replace('"flange"', '"flange2"').replace('"base"', '"base2"') \
        .replace("base_fixed", "base_fixed2")
    roots = "".join(f'<joint name="to_{side}" type="fixed"><parent link="torso"/><child link="{side}_base"/></joint>'
                    for side in ("left", "right"))
    path = written(tmp_path, f'<robot name="two"><link name="torso"/>{one}{two}{roots}</robot>')
    with pytest.raises(InputError, match="tool_frame"):
        Robot.load(path)
    path.with_suffix(".toml").write_text('tool_frame = "tool1"\n')
    robot = Robot.load(path)
    assert (robot.n, robot.tool_frame) == (6, "tool1")


# Masses, efforts and speeds of a class.

def test_a_bare_chain_gets_what_arms_of_its_size_have_and_tells_it(tmp_path: Path) -> None:
    robot = of_its_size(Robot.load(written(tmp_path, urdf(6))))
    masses = [body.mass for body in list(robot.pinocchio.inertias)[1:]]
    assert sum(masses) == pytest.approx(class_of(MASS, reach(robot)), rel=1e-6)
    assert min(masses) > 0.0
    told = " ".join(robot.assumed)
    assert all(word in told for word in ("links weigh 0 kg", "speed limit of joints 1, 2, 3, 4, 5, 6", "no effort"))
    data = robot.pinocchio.createData()
    for q in np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (50, 6)):
        assert (np.abs(pin.computeGeneralizedGravity(robot.pinocchio, data, q)) < robot.tau_max).all()
        assert np.linalg.eigvalsh(pin.crba(robot.pinocchio, data, q))[0] > 0.0


def test_masses_that_are_not_the_arms_are_replaced_and_believable_ones_stay(tmp_path: Path) -> None:
    limit = 'lower="-2.9" upper="2.9" effort="2000" velocity="2.5"'
    light = Robot.load(written(tmp_path, urdf(6, mass=0.1, limit=limit)))
    assert "the links weigh 0.6 kg" in of_its_size(light).assumed[0]
    right = Robot.load(written(tmp_path, urdf(6, mass=4.0, limit=limit), "right"))
    assert of_its_size(right).assumed == ()
    assert of_its_size(right).description == right.urdf.read_text()


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_arms_are_read_as_they_are(name: str) -> None:
    robot = Robot.load(name)
    assert of_its_size(robot) is robot
    assert robot.description == robot.urdf.read_text(encoding="utf-8")
    assert robot.assumed == ()


# What an arm touches.

def test_an_arm_that_folds_into_itself_or_the_floor_is_seen(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, urdf(7)))
    shapes = Shapes(robot)
    # One joint each: straight up, bent over to the floor, folded back to the shoulder.
    upright, down = np.zeros(7), np.array([0.0, 2.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    folded = np.array([0.0, 0.0, 0.0, 2.9, 0.0, 0.0, 0.0])
    assert shapes.first_touch(upright[None]) is None
    floor = shapes.first_touch(np.array([upright, down]))
    assert floor is not None
    assert (floor.row, floor.other) == (1, FLOOR)
    itself = shapes.first_touch(folded[None])
    assert itself is not None
    assert itself.other.startswith("link")


def test_no_shipped_arm_touches_anything_at_home() -> None:
    for name in SHIPPED:
        robot = Robot.load(name)
        assert Shapes(robot).first_touch(robot.home[None]) is None
