"""Twins of recordings: what a recording tells comes back, and what it does not is drawn."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch
from typer.testing import CliRunner

from ideal_robot.dynamics import link_parameters
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes import cli
from scenes.identification.twin import played_again
from scenes.identification.twin_play import TwinResult, make_twin, twin_text
from scenes.scene_file import load_scene
from scenes.scene_files.line_scene import LineScene
from sim.arm.residual import octave_edges, residual_torque
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from tests.sources import DATA

AXIS = """<robot name="axis"><link name="rail"/><link name="carriage"><inertial><mass value="50"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="500" velocity="1"/></joint></robot>"""
TRUTH = {"elasticity": False, "thermal": False, "quantisation": False, "coulomb": 15.0, "stribeck": 4.0,
         "stribeck_velocity": 0.02,
         "viscous": 120.0, "degressive": 5.0, "degressive_velocity": 0.05, "extra_rotor_inertia": 0.0,
         "position_gain": 30.0, "velocity_gain": 6000.0, "integral_time": 0.05, "velocity_feedforward": 0.9,
         "torque_ripple": 0.0, "correction_delay": False, "drive_gain_error": 0.0, "current_noise": 0.004,
         "residual": [[0.0], [0.0], [1.0], [1.5], [1.0]]}


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("axis") / "axis.urdf"
    path.write_text(AXIS, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recording(axis: Path) -> Recording:
    robot, world = Robot.load(axis), World.from_table(str(axis), TRUTH)
    t = np.arange(0.0, 20.0, world.t_ipo)
    q = np.clip(t, 0.0, 1.0)[:, None] ** 3 * (
        0.2 * np.sin(1.1 * t) + 0.06 * np.sin(4.3 * t) + 0.01 * np.sin(14.0 * t))[:, None]
    return played_again(world, robot, Recording.from_arrays(t, q_c=q, q=q), seed=3)


@pytest.fixture(scope="module")
def made(axis: Path, recording: Recording) -> TwinResult:
    return make_twin([recording], str(axis))


def test_a_twin_plays_the_recorded_torque(made: TwinResult) -> None:
    np.testing.assert_allclose(made.rms[1], made.rms[0], rtol=0.05)
    assert np.all(made.spectrum < 0.1)
    np.testing.assert_allclose(made.left[1], made.left[0], rtol=0.3)


def test_what_the_recording_tells_comes_back(made: TwinResult) -> None:
    found = made.twin.table
    assert found["current_noise"][0] == pytest.approx(0.004, rel=0.2)
    # Of one sliding joint motion tells the mass and the rotor together.
    assert found["body"][0] + found["body"][10] == pytest.approx(made.analysis.model.base_values[0], rel=0.01)
    assert found["spread"] == {}
    residual = np.sqrt(np.sum(np.square(found["residual"])))
    assert residual == pytest.approx(np.sqrt(1.0 + 1.5**2 + 1.0), rel=0.4)


def test_without_commands_the_controller_is_of_a_class_and_each_individual_draws_its_own(
        axis: Path, recording: Recording) -> None:
    silent = Recording({name: values for name, values in recording.columns.items() if not name.startswith("q_c")},
                       dict(recording.meta), recording.source)
    found = make_twin([silent], str(axis))
    assert any(text.startswith("controllers") for text in found.twin.assumed)
    gains = {found.twin.world(str(axis), k).per_joint("position_gain", 1)[0] for k in (1, 2, 2, 3)}
    assert len(gains) == 3
    np.testing.assert_allclose(found.rms[1], found.rms[0], rtol=0.2)


def test_a_file_of_one_axis_holds_its_world_and_says_what_was_assumed(made: TwinResult, axis: Path) -> None:
    text = twin_text(made.twin, str(axis), "axis")
    assert "gear: rigid" in text
    values = tomllib.loads(text)
    assert World.from_table(values["robot"], values["world"]).table() == made.twin.world(str(axis)).table()


def test_the_twin_of_a_shipped_arm_is_a_scene_whose_model_is_its_own(made: TwinResult, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(twin_text(made.twin, "kr6", "mine"), encoding="utf-8")
    scene = load_scene(str(file))
    assert isinstance(scene, LineScene)
    assert (scene.robot, scene.model) == ("kr6", "own")
    assert scene.arm_world["residual"] == made.twin.table["residual"]


def test_the_verb_refuses_what_is_no_name_of_a_file(axis: Path) -> None:
    cli._register()
    answer = CliRunner().invoke(cli.app, ["twin", "none.parquet", "--robot", str(axis), "-o", "twin.json"])
    assert isinstance(answer.exception, InputError)
    assert "ends in .toml" in str(answer.exception)


# The world behind it: bodies, residual, spread.

def test_bodies_take_the_place_of_the_data_sheets() -> None:
    robot = Robot.load("kr6")
    sheet = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(6)])
    plain, same = World.default("kr6"), World.default("kr6").replace(body=tuple(sheet))
    for one, other in zip(draw_specimen(robot, plain).model.inertias, draw_specimen(robot, same).model.inertias,
                          strict=True):
        np.testing.assert_allclose(one.toDynamicParameters(), other.toDynamicParameters(), atol=1e-12)
    with pytest.raises(InputError, match="expected 72 numbers"):
        draw_specimen(robot, plain.replace(body=(1.0, 2.0)))


def test_a_residual_has_its_spectrum_and_is_another_one_each_time() -> None:
    world = World.default("kr6").replace(residual=((0.0,) * 6, (0.0,) * 6, (0.5,) * 6, (0.0,) * 6, (2.0,) * 6))
    t = np.arange(0.0, 400.0, 0.02)
    drawn = []
    for seed in (1, 2):
        torque = residual_torque(world, 6, np.random.default_rng(seed))
        assert torque is not None
        drawn.append(np.array([torque(at, t[:6], t[:6], t[:6]) for at in t]))
    f, density = welch(drawn[0], 50.0, nperseg=5000, axis=0)
    for (low, high), size in zip(np.column_stack([octave_edges(5)[:-1], octave_edges(5)[1:]]), (0, 0, 0.5, 0, 2.0),
                                 strict=True):
        inside = (f >= 0.98 * low) & (f < 1.02 * high)
        found = np.sqrt(np.sum(density[inside], axis=0) * f[1])
        np.testing.assert_allclose(found, size, rtol=0.15, atol=0.3)
    assert abs(np.corrcoef(drawn[0][:, 0], drawn[1][:, 0])[0, 1]) < 0.2
    assert residual_torque(World.default("kr6"), 6, np.random.default_rng(1)) is None


def test_the_individual_draws_what_nobody_measured() -> None:
    spread = {"stiffness": 0.4, "velocity_feedforward": 0.5}
    one, same, other = (World.from_table("kr6", {"spread": spread, "individual": k}) for k in (1, 1, 2))
    assert one == same
    assert one.stiffness != other.stiffness
    assert np.all((one.per_joint("velocity_feedforward", 6) >= 0) & (one.per_joint("velocity_feedforward", 6) <= 1))
    assert World.from_table("kr6", {"spread": {}}) == World.default("kr6")
    for wrong in ({"stiffness": -1.0}, {"thermal": 0.1}, {"colour": 0.1}, 3.0):
        with pytest.raises(InputError, match=r"world\.spread"):
            World.from_table("kr6", {"spread": wrong})


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="measured data (../shared/data) are not there")
@pytest.mark.parametrize(("urdf", "file"), [
    ("emps/emps.urdf", "emps/emps_estimation.parquet"), ("ur10e/ur10e.urdf", "ur10e/free_12harm_50s.parquet"),
    ("panda/panda.urdf", "panda/panda_a.parquet")])
def test_twins_of_measured_arms_play_their_torques(urdf: str, file: str) -> None:
    found = make_twin([Recording.read(DATA / file)], str(DATA / urdf))
    np.testing.assert_allclose(found.rms[1], found.rms[0], rtol=0.2)
    assert np.all(found.spectrum < 0.2)
