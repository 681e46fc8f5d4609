"""Robots of others: a URDF or a drive data file that cannot be is refused with its field, and opens no other file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes

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
    ("revolute", "continuous"),
    ('xyz="0 0 1"', 'xyz="0 0 0"'), ('xyz="0 0 1"', 'xyz="0 1e-200 0"'), ('value="1"', 'value="-1"'),
    ('ixx="1"', 'ixx="-1"'), ('velocity="2"', 'velocity="1e-9"'),
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


def test_meshes_and_textures_are_left_out_of_what_viewers_get() -> None:
    mesh = '<visual><geometry><mesh filename="/etc/passwd"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry><material><texture filename="/x"/></material></visual>'
    text = without_meshes(URDF.replace('<link name="base"/>', f'<link name="base">{mesh}{box}</link>'))
    assert "passwd" not in text
    assert "filename" not in text
    assert "box" in text
