"""An arm nobody wrote a world for: it is planned for, played, served over RSI and viewed, with meshes or without."""

from __future__ import annotations

import re
import socket
import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from ideal_robot.robots.robot import Robot
from scenes.cli import _register, app
from scenes.identification.plan import plan, play_plan
from scenes.view.viewer import Viewer
from sim.arm.world import World
from sim.devices import rsi_controller

pytest.importorskip("viser")
KR6 = Robot.load("kr6")


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A URDF whose name is no shipped robot's, whose shapes are meshes that are not there, and no drive data."""
    text = KR6.urdf.read_text(encoding="utf-8")
    mesh = '<geometry><mesh filename="package://nobody_has/this.stl"/></geometry>'
    text = re.sub(r"<geometry>.*?</geometry>", mesh, text, flags=re.S)
    path = tmp_path / "own_arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_planned_motion_is_played_in_a_world_in_proportion(own: Path) -> None:
    arm = Robot.load(own)
    planned = plan(arm, "joint", period=2.0)
    recording = play_plan(planned, arm, seed=1)
    assert recording.n == arm.n
    error = recording.joints("q") - recording.joints("q_c")
    assert 0 < np.max(np.abs(error)) < 0.5


def test_an_own_arm_of_a_shipped_name_does_not_get_the_shipped_world(own: Path) -> None:
    named = own.with_name("kr15.urdf")
    own.rename(named)
    assert World.default(Robot.load(named)).stiffness != World.default("kr15").stiffness
    assert World.default(Robot.load("kr15")) == World.default("kr15")


def test_the_rsi_controller_plays_it(own: Path, tmp_path: Path) -> None:
    arm = Robot.load(own)
    pd.DataFrame({"t": [0.0, 0.012], **{f"q_{i + 1}": [0.1, 0.1] for i in range(arm.n)}}).to_csv(tmp_path / "p.csv")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        heard = []
        listener = threading.Thread(target=lambda: heard.append(server.recv(4096)))
        listener.start()
        code = rsi_controller.main([str(tmp_path / "p.csv"), "--robot", str(own), "--port",
                                    str(server.getsockname()[1]), "--patience", "2"])
        listener.join(10)
    assert code == 1
    assert b"<AIPos" in heard[0]


def test_it_is_viewed_as_rods_where_its_meshes_are_missing(own: Path) -> None:
    viewer = Viewer(Robot.load(own), _free_port())
    try:
        assert len(viewer.shapes) >= 4
    finally:
        viewer.server.stop()


def test_the_address_said_is_the_one_served() -> None:
    """On a taken port the viewer moves to another; the command must not print the taken one."""
    _register()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = CliRunner().invoke(app, ["view", "kr6", "--once", "--port", str(port)])
    assert done.exit_code == 0, done.output
    found = re.search(r"http://127\.0\.0\.1:(\d+)", done.output.partition("open ")[2])
    assert found is not None
    assert int(found[1]) != port


def _free_port() -> int:
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


UR10E = Path(__file__).resolve().parents[3] / "shared" / "data" / "ur10e" / "ur10e.urdf"


@pytest.mark.skipif(not UR10E.is_file(), reason="needs the public data sets beside the repository")
def test_an_arm_whose_joints_turn_far_gets_a_motion() -> None:
    """Most random motions of such an arm hit the floor; with this seed the first search finds none."""
    assert len(plan(Robot.load(UR10E), "joint", seed=2).commands) > 1000
