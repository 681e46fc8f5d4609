"""Where an arm may go by default, from its own reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.identification.excitation import design_excitation
from ideal_robot.identification.workspace import Workspace
from ideal_robot.robots.robot import Robot

OWN = Path(__file__).resolve().parents[3] / "examples" / "own_robot.urdf"


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15", "kr500"])
def test_arms_of_a_metre_and_more_keep_the_usual_distances(name: str) -> None:
    assert Workspace.of(Robot.load(name)) == Workspace()


def test_a_turntable_on_the_floor_gets_a_motion() -> None:
    """Its tool is at the height of its base: with the usual floor of 0.15 m no motion was found."""
    arm = Robot.load(OWN)
    assert Workspace.of(arm).z_min == 0.0
    motion = design_excitation(arm, np.random.default_rng(1), trials=5, refinements=5)
    assert np.ptp(motion.at(np.linspace(0, motion.period, 200))[0]) > 1.0


def test_a_sliding_axis_on_the_floor_gets_one_too(tmp_path: Path) -> None:
    text = OWN.read_text(encoding="utf-8").replace('type="revolute"', 'type="prismatic"').replace("0 0 1", "1 0 0")
    (tmp_path / "axis.urdf").write_text(text, encoding="utf-8")
    arm = Robot.load(tmp_path / "axis.urdf")
    assert design_excitation(arm, np.random.default_rng(1), trials=5, refinements=0).condition_number < 100
