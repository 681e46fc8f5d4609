"""Sliding joints are known from turning ones, in whatever order they stand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ideal_robot.arrays import held
from ideal_robot.robots.robot import Robot

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
