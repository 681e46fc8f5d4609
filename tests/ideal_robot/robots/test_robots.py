"""Robots of others: a URDF or a drive data file that cannot be is refused with its field, and opens no other file.

At the controller what was missed is caught up under the arm's own limits of acceleration and jerk.
"""

from __future__ import annotations

import re
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array, held
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.arm_class import MASS, class_of
from ideal_robot.robots.collisions import FLOOR, Shapes
from ideal_robot.robots.interface import CatchUp, LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import of_its_size, reach
from ideal_robot.robots.urdf import without_meshes
from tests.arms import GRIPPER, INERTIAL, LINK, SCARA, urdf, written

URDF = """<robot name="one">
<link name="base"/>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
</robot>
"""


def test_the_untouched_robot_is_read(tmp_path: Path) -> None:
    (tmp_path / "one.urdf").write_text(URDF)
    (tmp_path / "one.toml").write_text("[joints]\ngear_ratio = 100\nrotor_inertia = [1e-4]\n[own]\nx = 1\n")
    robot = Robot.load(tmp_path / "one.urdf")
    assert robot.rotor_inertia == pytest.approx([1.0])
    assert robot.data["own"] == {"x": 1}
    assert np.isinf(robot.a_max).all()


@pytest.mark.parametrize(("old", "new"), [
    ('value="1"', 'value="x"'), ('value="1"', 'value="nan"'), ('value="1"', 'value="1e300"'), ('ixx="1"', 'ixx="inf"'),
    ('parent link="base"', 'parent link="arm"'), ('parent link="base"', 'parent link="gone"'),
    ('xyz="0 0 1"', 'xyz="0 0 0"'), ('xyz="0 0 1"', 'xyz="0 1e-200 0"'), ('value="1"', 'value="-1"'),
    ('ixx="1"', 'ixx="-1"'), ('velocity="2"', 'velocity="1e-9"'), ('mass value="1"', 'mass'),
    ('xyz="0 0 1"', 'xyz="0 1"'), ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><origin xyz="0 0 0" rpy="0 0"/>'),
    ("</joint>", '<mimic joint="j"/></joint>'), ("</robot>", '<a xmlns="http://www.ros.org/wiki/xacro"/></robot>'),
    ("revolute", "floating"), ("revolute", "fixed"), ('lower="-1"', 'lower="2"'), ('lower="-1"', 'lower="nan"'),
    ("<robot", "<!DOCTYPE r [<!ENTITY a 'b'>]><robot"), ("<robot", "<arm"), ("</robot>", ""), (URDF, ""),
    (URDF, "<a>" * 50_000), ("</robot>", "<link/>" * 30_000 + "</robot>"), ('name="one"', 'name="\0"'),
])
def test_a_urdf_that_cannot_be_is_refused_in_one_line(old: str, new: str, tmp_path: Path,
                                                      capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.urdf").write_text(URDF.replace(old, new))
    with pytest.raises(InputError) as refused:
        Robot.load(tmp_path / "one.urdf")
    assert "\n" not in str(refused.value)
    assert refused.value.file == tmp_path / "one.urdf"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("text", "field"), [
    ("joints = 3", "joints"), ("[joints]\ngear_ratio = 'x'", "joints.gear_ratio"),
    ("[joints]\ngear_ratio = 0", "joints.gear_ratio"), ("[joints]\ngear_ratio = [1, 2]", "joints.gear_ratio"),
    ("[joints]\nrotor_inertia = [1e-320]", "joints.rotor_inertia"),
    ("[joints]\ntorque_constant = [1e-320]", "joints.torque_constant"),
    ("[joints]\na_max = -1.0", "joints.a_max"), ("[joints]\nhome = nan", "joints.home"),
    ("[joints]\nhome = [[0.0]]", "joints.home"), ("[joints]\ntorque_constant = true", "joints.torque_constant"),
    ("[controller]\nt_ipo = 0", "controller.t_ipo"), ("[controller]\nt_ipo = 'fast'", "controller.t_ipo"),
    ("name = 3", "name"), ("name = ''", "name"), ("tool_frame = 'gone'", "tool_frame"),
    ("tool_frame = []", "tool_frame"),
    ("x = " + "[" * 9000, None), ("\0", None),
])
def test_drive_data_that_cannot_be_is_refused_with_its_field(text: str, field: str | None, tmp_path: Path) -> None:
    (tmp_path / "one.urdf").write_text(URDF)
    (tmp_path / "one.toml").write_text(text)
    with pytest.raises(InputError) as refused:
        Robot.load(tmp_path / "one.urdf")
    assert refused.value.file == tmp_path / "one.toml"
    if field is not None:
        assert str(refused.value.field).startswith(field)


@pytest.mark.parametrize(("given", "gain"), [("torque_constant = 1.0", 50.0), ("torque_constant = 0", 1.0), ("", 1.0)])
def test_a_torque_constant_of_one_is_known_and_none_is_not(given: str, gain: float, tmp_path: Path) -> None:
    (tmp_path / "one.urdf").write_text(URDF)
    (tmp_path / "one.toml").write_text(f"[joints]\ngear_ratio = 50.0\n{given}")
    robot = Robot.load(tmp_path / "one.urdf")
    assert (robot.drive_gain.tolist(), robot.knows_drive_gains) == ([gain], gain != 1.0)


def test_meshes_and_textures_are_left_out_of_what_viewers_get() -> None:
    mesh = '<visual><geometry><mesh filename="/etc/passwd"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry><material><texture filename="/x"/></material></visual>'
    text = without_meshes(URDF.replace('<link name="base"/>', f'<link name="base">{mesh}{box}</link>'))
    assert "passwd" not in text
    assert "filename" not in text
    assert "box" in text


# Sliding joints are known from turning ones, in whatever order they stand.

CHAIN = """<robot name="slider"><link name="a"/>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="b"/>
<joint name="j2" type="fixed"><parent link="b"/><child link="c"/></joint><link name="c"/>
<joint name="j3" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="0.6 0.8 0"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="d"/></robot>"""


def test_which_joints_slide(tmp_path: Path) -> None:
    (tmp_path / "slider.urdf").write_text(CHAIN)
    assert Robot.load(tmp_path / "slider.urdf").prismatic.tolist() == [False, True]
    assert not Robot.load("kr6").prismatic.any()


def test_rows_are_held_at_both_ends() -> None:
    rows = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert held(rows, before=1, after=2).tolist() == [[1, 2], [1, 2], [3, 4], [3, 4], [3, 4]]
    assert held(rows).tolist() == rows.tolist()


# The KR 500's URDF against [J] table 1, through a chain written down independently of it.

# α_j, d_j, offset of θ_j, r_j of [J] table 1.
TABLE_1 = (
    (np.pi, 0.0, 0.0, -1.045),
    (np.pi / 2, 0.500, 0.0, 0.0),
    (0.0, 1.300, np.pi / 2, 0.0),
    (-np.pi / 2, -0.055, 0.0, -1.025),
    (np.pi / 2, 0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, -np.pi / 2, -0.290),
)
CONFIGURATIONS = ((1.62, -0.89, 1.84, 1.62, -np.pi / 2, 0.46), (1.48, -0.87, 1.37, np.pi, -1.05, 0.0))


def khalil_kleinfinger(q: np.ndarray) -> list[np.ndarray]:
    """Frames 1 … 6 in the base: each Rx(α) Tx(d) Rz(θ) Tz(r), written out as in Khalil & Kleinfinger (1986)."""
    frames = []
    total = np.eye(4)
    for (alpha, d, offset, r), angle in zip(TABLE_1, q, strict=True):
        c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
        total = total @ np.array([[c, -s, 0.0, d], [ca * s, ca * c, -sa, -r * sa], [sa * s, sa * c, ca, r * ca],
                                  [0.0, 0.0, 0.0, 1.0]])
        frames.append(total)
    return frames


def test_every_link_frame_is_that_of_the_table() -> None:
    robot = Robot.load("kr500")
    data = robot.pinocchio.createData()
    rng = np.random.default_rng(0)
    for q in (*CONFIGURATIONS, *rng.uniform(robot.q_min, robot.q_max, (50, 6))):
        pin.framesForwardKinematics(robot.pinocchio, data, np.array(q))
        expected = khalil_kleinfinger(np.array(q))
        for joint in range(6):
            # A joint frame of the URDF is the table's frame, moved by r_j along z_j already: the same frame.
            np.testing.assert_allclose(data.oMi[joint + 1].homogeneous, expected[joint], atol=1e-9)
        np.testing.assert_allclose(data.oMf[robot.tool_id].homogeneous, expected[-1], atol=1e-9)


@pytest.mark.parametrize(("configuration", "loaded"), [(0, {1}), (1, {2, 3})])
def test_pressing_along_z6_loads_the_joints_that_the_paper_says(configuration: int, loaded: set[int]) -> None:
    """[J] 4.2: configuration 1 is for joint 1, configuration 2 for joint 2, with f_z alone."""
    robot = Robot.load("kr500")
    q = np.array(CONFIGURATIONS[configuration])
    jacobian = pin.computeFrameJacobian(robot.pinocchio, robot.pinocchio.createData(), q, robot.tool_id, pin.LOCAL)
    lever = np.abs(jacobian[2])
    assert {int(j) + 1 for j in np.flatnonzero(lever > 0.2)} == loaded
    assert np.max(lever) > 1.5
    assert np.max(np.delete(lever, [j - 1 for j in loaded])) < 0.06


ROBOT = Robot.load("kr6")
RISE = 0.03


def received(T: float, missed: tuple[int, ...], goes_on: bool) -> tuple[Array, Array]:
    """Wanted path, and what a controller has in force that holds, or goes on, where an answer is missed."""
    t = T * np.arange(round(6.0 / T))
    desired = 0.5 * (1 - np.cos(1.3 * t))[:, None] * np.array([1.0, -0.6, 0.8, 1.0, -0.5, 0.3])
    desired[t > 2 * np.pi / 1.3] = 0.0
    catch_up, places = CatchUp(ROBOT.a_max, ROBOT.v_max, T), [desired[0], desired[0]]
    gap = False
    for k in range(1, len(t)):
        step, before = desired[k] - desired[k - 1], desired[k - 1] - desired[max(k - 2, 0)]
        speed = places[-1] - places[-2]
        if k in missed:
            places.append(places[-1] + (speed if goes_on else 0.0))
            gap = True
            continue
        if gap:
            catch_up.start(places[-1] - desired[k - 1], speed - before, before - step, before)
            gap = False
        places.append(desired[k] + catch_up.next(step))
    return desired, np.array(places[1:])


@pytest.mark.parametrize("T", [0.004, 0.012])
@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize("missed", [(150,), (100, 101, 102, 103), tuple(range(60, 330, 9))])
def test_speed_acceleration_and_jerk_are_kept(T: float, goes_on: bool, missed: tuple[int, ...]) -> None:
    desired, places = received(T, missed, goes_on)
    speed = np.diff(places, axis=0) / T
    bend = np.diff(speed, axis=0) / T
    jerk = np.diff(bend, axis=0) / T
    # That a controller holds the arm at once is its own doing; it shows in the differences about a missed cycle.
    held = np.zeros(len(places), dtype=bool)
    held[list(missed)] = not goes_on
    own = ~held[2:]
    usual = np.abs(np.diff(desired, axis=0)).max(axis=0) / T
    assert (np.abs(bend[own]) <= 0.8 * ROBOT.a_max).all()
    assert (np.abs(jerk[own[1:] & own[:-1] & ~held[1:-2]]) <= 1.1 * 0.5 * ROBOT.a_max / RISE + 3.0).all()
    assert (np.abs(speed) <= 1.3 * usual + 0.05 * ROBOT.v_max + 1e-9).all()
    np.testing.assert_allclose(places[-1], desired[-1], atol=1e-12)


@pytest.mark.parametrize(("goes_on", "within"), [(True, 0.05), (False, 0.8)])
@pytest.mark.parametrize("T", [0.004, 0.012])
def test_a_missed_answer_is_made_good_as_soon_as_the_limits_let_it(T: float, goes_on: bool, within: float) -> None:
    """An arm that went on by itself has lost little, one that was held all of its speed. Where 2 % of the packets were
    lost a line was left by 0.3 mm while each offset faded for 0.3 s, whatever its size."""
    desired, places = received(T, (150,), goes_on)
    away = np.flatnonzero(np.abs(places - desired).max(axis=1) > 1e-12)
    assert away[0] == 150
    assert (away[-1] - away[0]) * T < within


def test_a_cycle_that_no_controller_has_takes_no_memory() -> None:
    """A file said 1 µs: plans of all lengths up to 0.4 s took 2.6 GB (fuzz, seed 9723220)."""
    tracemalloc.start()
    CatchUp(ROBOT.a_max, ROBOT.v_max, 1e-6)
    most, _ = tracemalloc.get_traced_memory()[1], tracemalloc.stop()
    assert most < 20e6


def test_the_joints_keep_step() -> None:
    """Held and led back at constant speed, the arm stays on the straight line in joint space."""
    T, direction = 0.012, np.array([1.0, -0.6, 0.8, 1.0, -0.5, 0.3])
    catch_up, step = CatchUp(ROBOT.a_max, ROBOT.v_max, T), 0.6 * T * direction
    catch_up.start(-step, -step, np.zeros(6), step)
    offsets = np.array([catch_up.next(step) for _ in range(100)])
    along = np.outer(offsets @ direction, direction) / (direction @ direction)
    np.testing.assert_allclose(offsets, along, atol=1e-12)


class ForgetfulLink(LinkedRobot):
    """A controller that falls silent once and is heard again, as one that a person has started anew."""

    def __init__(self) -> None:
        super().__init__(ROBOT, 0.1, 0.3)
        self.cycles, self.handed = 0, list[Array]()

    def connect(self, patience: float = 60.0) -> RobotState:
        self._at_rest(ROBOT.home, ROBOT.home)
        return RobotState(0.0, ROBOT.home, np.zeros(ROBOT.n))

    def _handed_over(self, q_c: Array) -> None:
        self.handed.append(q_c)

    def _received(self) -> RobotState:
        self.cycles += 1
        if self.cycles == 3:
            raise self.lost_link("no packet from the controller")
        return RobotState(ROBOT.t_ipo * self.cycles, ROBOT.home, np.zeros(ROBOT.n))

    def close(self) -> None:
        return


def test_a_link_that_was_lost_hands_over_nothing_until_it_is_connected_anew() -> None:
    """A run that had lost its controller tried to lead the arm off the surface. The next session answered it, whose arm
    stood elsewhere: 146 N on a surface of 20 N/mm."""
    link = ForgetfulLink()
    link.connect()
    for _ in range(2):
        link.cycle(ROBOT.home)
    with pytest.raises(IdealRobotError):
        link.cycle(ROBOT.home)
    handed = len(link.handed)
    for again in (link.receive, partial(link.send, ROBOT.home), partial(link.skip, ROBOT.home)):
        with pytest.raises(IdealRobotError, match="no packet"):
            again()
    assert (len(link.handed), link.cycles) == (handed, 3)
    link.connect()
    link.cycle(ROBOT.home)
    assert len(link.handed) == handed + 1


# URDFs as makers publish them: the arm in them is found, and what they leave open is taken from its class and told.

@pytest.mark.parametrize("joints", [5, 6, 7])
def test_a_bare_chain_is_read_with_its_tool_frame(joints: int, tmp_path: Path) -> None:
    """A fixed joint's axis may be 0 0 0, and a frame fixed to the base does not become the tool."""
    robot = Robot.load(written(tmp_path, urdf(joints)))
    assert (robot.n, robot.tool_frame, robot.assumed) == (joints, "tool0", ())


def test_a_gripper_is_held_where_it_rests_and_weighs_on_the_last_link(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, urdf(6, mass=3.0, beyond=GRIPPER)))
    assert (robot.n, robot.tool_frame) == (6, "tool0")
    assert [line.split()[1] for line in robot.assumed] == ["left_finger", "right_finger"]
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


@pytest.mark.parametrize("own", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_tool_beside_a_joint_that_bends_the_wrist_points_from_it(own: tuple[float, ...], tmp_path: Path) -> None:
    """Of arms of five joints that end in a bend the joint's axis was taken for the tool's direction."""
    text = urdf(5)
    for joint, axis in ((4, "0 0 1"), (5, "0 1 0")):
        text = re.sub(rf'(name="joint_{joint}".*?<axis xyz=)"[^"]*"', rf'\1"{axis}"', text)
    turn = pin.rpy.matrixToRpy(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(own)).matrix())
    text = re.sub(r'(<child link="tool0"/><origin) xyz="[^"]*" rpy="[^"]*"',
                  rf'\1 xyz="0.12 0.002 0" rpy="{" ".join(f"{value:.9g}" for value in turn)}"', text)
    robot = Robot.load(written(tmp_path, text))
    np.testing.assert_allclose(robot.fk()(np.zeros(5)).rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-6)
    assert any("bends the wrist" in said for said in robot.assumed) == (own[0] < 0.5)


@pytest.mark.parametrize(("up", "roll"), [(1, 0.0), (1, np.pi), (-1, 0.0)])
def test_what_no_joint_can_tilt_points_down(up: int, roll: float, tmp_path: Path) -> None:
    limit = '<limit lower="-2.5" upper="2.5" effort="50" velocity="4"/>'
    robot = Robot.load(written(tmp_path, SCARA.format(limit=limit, one=0.3, two=0.25, up=up, roll=roll)))
    assert robot.n == 4
    np.testing.assert_allclose(robot.fk()(robot.home).rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-9)
    assert (roll == 0.0) == any("points down" in said for said in robot.assumed)


@pytest.mark.parametrize("heavy", [20.0, 300.0])
def test_the_efforts_of_an_arm_on_a_turntable_and_a_carriage_are_its_makers(heavy: float, tmp_path: Path) -> None:
    limit = 'lower="-2.9" upper="2.9" effort="{}" velocity="3"'
    efforts = [300.0, 290.0, 200.0, 25.0, 22.0, 20.0]
    text = urdf(6, mass=4.0, limit=limit)
    for effort in efforts:
        text = text.replace("{}", f"{effort:g}", 1)
    base = LINK.format(name="{}", inertial=INERTIAL.format(mass=heavy, inertia=0.1 * heavy))
    below = (base.format("car") + base.format("table") + base.format("floor")
             + '<joint name="turntable" type="revolute"><parent link="floor"/><child link="table"/><axis xyz="0 0 1"/>'
             '<limit lower="-999999" upper="999999" effort="87" velocity="4"/></joint>'
             '<joint name="carriage" type="prismatic"><parent link="table"/><child link="car"/><axis xyz="1 0 0"/>'
             '<limit lower="-999999" upper="999999" effort="87" velocity="4"/></joint>'
             '<joint name="mount" type="fixed"><parent link="car"/><child link="base_link"/></joint>')
    robot = of_its_size(Robot.load(written(tmp_path, text.replace('<link name="base_link"/>',
                                                                  '<link name="base_link"/>' + below, 1))))
    assert robot.n == 8
    np.testing.assert_allclose(robot.tau_max[2:], efforts)
    assert robot.q_max[1] < 5.0
    assert any("carriage stand for none" in said for said in robot.assumed)


def test_links_about_the_centre_of_a_wrist_are_neighbours(tmp_path: Path) -> None:
    """An arm of seven joints whose last three meet in a point was said to touch itself wherever its wrist bends."""
    limit = 'lower="-2" upper="2" effort="100" velocity="2"'
    text = urdf(7, mass=3.0, limit=limit)
    places = [found.span(1) for found in re.finditer(r'<origin xyz="([^"]*)"/><axis', text)]
    for joint in (6, 5):
        begin, end = places[joint]
        text = text[:begin] + "0 0 0" + text[end:]
    robot = of_its_size(Robot.load(written(tmp_path, text)))
    bent = np.array([0.0, 0.5, 0.0, 0.8, 0.0, 1.9, 0.0])
    assert Shapes(robot).first_touch(np.array([bent])) is None


def test_a_finger_is_no_tool_and_a_fixed_joint_follows_none(tmp_path: Path) -> None:
    fixed = GRIPPER.replace('type="prismatic"', 'type="fixed"').replace('<link name="left"/>', "").replace(
        'link="left"', 'link="finger_tip"').replace('name="left"', 'name="finger_tip"')
    bare = urdf(6, beyond=fixed).replace("tool0", "plate")
    assert Robot.load(written(tmp_path, bare)).tool_frame == "right"
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
    (('<joint name="joint_4" type="revolute">', '<joint name="joint_4" type="revolute"><mimic joint="gone"/>'),
     "follows no joint"),
    (('<joint name="joint_4" type="revolute">', '<joint name="joint_4" type="revolute"><mimic joint="joint_4"/>'),
     "follows no joint"),
    (('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'), "an axis needs a direction"),
    (('<axis xyz="0 0 1"/>', "<axis/>"), "an axis needs a direction"),
])
def test_what_cannot_be_an_arm_is_said_with_its_joint(change: tuple[str, str], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says) as refused:
        Robot.load(written(tmp_path, urdf(6).replace(*change, 1)))
    assert str(refused.value.field).startswith("joint_")


@pytest.mark.parametrize("lift", [False, True])
def test_of_two_arms_one_is_used_and_told(lift: bool, tmp_path: Path) -> None:
    arm = urdf(6).replace("base_link", "left_base").replace("</robot>", "").replace('<robot name="bare">', "")
    twin = arm.replace("link_", "other_link_").replace("left_base", "right_base").replace('"joint_', '"other_joint_') \
        .replace("tool0", "tool1").replace('"flange"', '"flange2"').replace('"base"', '"base2"') \
        .replace("base_fixed", "base_fixed2")
    roots = "".join(f'<joint name="to_{side}" type="fixed"><parent link="torso"/><child link="{side}_base"/></joint>'
                    for side in ("left", "right"))
    if lift:
        roots += ('<link name="ground"/>'
                  '<joint name="lift" type="prismatic"><parent link="ground"/><child link="torso"/>'
                  '<axis xyz="0 0 1"/><limit lower="0" upper="0.3" effort="1000" velocity="0.1"/></joint>')
    path = written(tmp_path, f'<robot name="two"><link name="torso"/>{arm}{twin}{roots}</robot>')
    robot = Robot.load(path)
    assert (robot.n, robot.tool_frame) == (6 + lift, "tool0")
    assert all(word in robot.assumed[0] for word in ("left_base", "right_base", "tool_frame"))
    assert sum("other_joint_" in told for told in robot.assumed) == 6
    path.with_suffix(".toml").write_text('tool_frame = "tool1"\n')
    other = Robot.load(path)
    assert (other.n, other.tool_frame) == (6 + lift, "tool1")
    assert not any("arms that begin" in told for told in other.assumed)


@pytest.mark.parametrize("none", ['effort="-1" velocity="2"', "effort='-1.0' velocity = '-1'",
                                  'effort="10" velocity="-1"'])
def test_limits_below_zero_are_none(none: str, tmp_path: Path) -> None:
    below, zero = (of_its_size(Robot.load(written(tmp_path, urdf(6, limit=f'lower="-2" upper="2" {limit}'), name)))
                   for limit, name in ((none, "below"), (re.sub(r"-[\d.]+", "0", none), "zero")))
    np.testing.assert_allclose(below.tau_max, zero.tau_max)
    np.testing.assert_allclose(below.v_max, zero.v_max)
    assert (below.tau_max > 1.0).all()
    assert below.assumed == zero.assumed


def test_values_that_xacro_left_defined_change_nothing_unless_they_are_used(tmp_path: Path) -> None:
    text = urdf(6).replace('<robot name="bare">', '<robot name="bare" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                           '<xacro:property name="width" value="0.2"/>')
    robot, plain = Robot.load(written(tmp_path, text)), Robot.load(written(tmp_path, urdf(6), "plain"))
    assert robot.n == plain.n == 6
    for one, other in zip(robot.pinocchio.jointPlacements, plain.pinocchio.jointPlacements, strict=True):
        np.testing.assert_array_equal(one.homogeneous, other.homogeneous)
    for place in ('<link name="${width}"/></robot>', '<xacro:include filename="arm.xacro"/></robot>'):
        with pytest.raises(InputError, match="xacro"):
            Robot.load(written(tmp_path, text.replace("</robot>", place)))


# Masses, efforts and speeds of a class.

def test_a_bare_chain_gets_what_arms_of_its_size_have_and_tells_it(tmp_path: Path) -> None:
    robot = of_its_size(Robot.load(written(tmp_path, urdf(6))))
    masses = [body.mass for body in list(robot.pinocchio.inertias)[1:]]
    assert sum(masses) == pytest.approx(class_of(MASS, reach(robot)), rel=1e-6)
    assert min(masses) > 0.0
    assumed = " ".join(robot.assumed)
    assert all(word in assumed for word in ("links weigh 0 kg", "speed limit of joints 1, 2, 3, 4, 5, 6", "no effort"))
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


def test_a_place_in_the_arm_that_is_not_three_numbers_is_refused(tmp_path: Path) -> None:
    """Before the place of the tool is looked for."""
    text = urdf(6)
    wrong = text[: (place := text.rindex('rpy="') + 5)] + "0 " + text[text.index('"', place):]
    with pytest.raises(InputError, match=r"origin\.rpy: expected 3 numbers"):
        Robot.load(written(tmp_path, wrong))


def test_moments_of_inertia_below_zero_of_an_arm_are_replaced(tmp_path: Path) -> None:
    """A published URDF of an IRB 4600 has them in five links of six."""
    text = urdf(6, mass=4.0)
    wrong = re.sub(r'ixx="[^"]*"', 'ixx="-4.98"', text)
    assert wrong != text
    robot = of_its_size(Robot.load(written(tmp_path, wrong)))
    assert "no arm's masses or moments of inertia behind" in robot.assumed[0]
    assert all(np.linalg.eigvalsh(body.inertia)[0] > 0.0 for body in list(robot.pinocchio.inertias)[1:])


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_arms_are_read_as_they_are_and_touch_nothing_at_home(name: str) -> None:
    robot = Robot.load(name)
    assert Shapes(robot).first_touch(robot.home[None]) is None
    assert of_its_size(robot) is robot
    assert robot.description == robot.urdf.read_text(encoding="utf-8")
    assert robot.assumed == ()


# What an arm touches.

def test_an_arm_that_folds_into_itself_or_the_floor_is_seen(tmp_path: Path) -> None:
    shapes = Shapes(Robot.load(written(tmp_path, urdf(7))))
    # One joint each: straight up, bent over to the floor, folded back to the shoulder.
    upright, down, folded = np.zeros(7), 2.4 * np.eye(7)[1], 2.9 * np.eye(7)[3]
    assert shapes.first_touch(upright[None]) is None
    floor = shapes.first_touch(np.array([upright, down]))
    assert floor is not None
    assert (floor.row, floor.other) == (1, FLOOR)
    itself = shapes.first_touch(folded[None])
    assert itself is not None
    assert itself.other.startswith("link")
