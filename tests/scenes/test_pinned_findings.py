"""What fuzzing found, each pinned by the call that broke."""

from __future__ import annotations

import gc
import io
import json
import multiprocessing
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_json, read_toml
from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.prior import same_arm
from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import design_excitation
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.message import RsiFormat
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording
from scenes import cli
from scenes.arms import model_at, shipped_model
from scenes.close_clamped import close_loop
from scenes.data_sets import fetch
from scenes.detection import pictures
from scenes.online.camera_process import calibrated_camera
from scenes.online.cycle import CycleLog, CycleSettings, play_cycles
from scenes.result import silent
from scenes.scene_file import load_scene
from scenes.scene_files.drawn_line import CameraTable, believed_camera
from scenes.serve import carried
from scenes.sweep import SweepFile
from scenes.undeclared import undeclared_effects
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from tests import sound

LONG = "x" * 300


@pytest.mark.parametrize("name", [LONG, f"{LONG}.json", f"{LONG}.toml", f"{LONG}/a.toml", "a\0b.toml"])
def test_a_name_that_no_file_can_have_is_no_file(name: str) -> None:
    for read in (Robot.load, Model.load, load_scene, lambda n: model_at(n, Robot.load("kr6")),
                 lambda n: list(pictures(n))):
        with pytest.raises(InputError):
            read(name)
    assert not os.path.isfile(name)


@pytest.mark.parametrize("period", [np.inf, np.nan, 0.0, -1.0, 1e300])
def test_a_period_that_is_none_is_refused(period: float) -> None:
    with pytest.raises(InputError, match="period"):
        design_excitation(Robot.load("kr6"), np.random.default_rng(0), period=period)


@pytest.mark.parametrize("cutoff", [1e-300, 1e-3])
def test_a_cutoff_below_one_oscillation_of_the_recording_is_refused(cutoff: float) -> None:
    t = 0.01 * np.arange(500)
    recording = Recording.from_arrays(t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None])
    with pytest.raises(InputError, match="one oscillation") as refused:
        preprocess(recording, cutoff=cutoff)
    assert refused.value.field == "cutoff"


def test_a_home_beyond_the_joints_limits_is_refused(tmp_path: Path) -> None:
    shipped = Robot.load("kr6")
    data = tmp_path / "arm.toml"
    data.write_text("[joints]\nhome = [0.0, 5e11, 0.0, 0.0, 0.0, 0.0]\n")
    with pytest.raises(InputError, match="joint 2 goes from") as refused:
        Robot.load(shipped.urdf, data)
    assert refused.value.field == "home"


class Drifting:
    """A task whose plan holds a NaN from a time on [s]; arm and task in one, each cycle a ``step`` further [rad]."""

    n_d, t_ipo = 8, 0.012

    def __init__(self, sound: float = 0.115, step: float = 1e-3) -> None:
        self.q_start = Robot.load("kr6").home
        self._sound, self._step = sound, step
        self.commands: list[Array] = []

    def plan(self, t: float, q_d: Array) -> Array:
        ahead = self.q_start + self._step * (round(t / self.t_ipo) + np.arange(8.0))[:, None]
        return ahead if t < self._sound else np.where(np.arange(8)[:, None] == 5, np.nan, ahead)

    def command(self, t: float, q_d: Array) -> Array:
        return q_d[0]

    def cycle(self, q_c: Array) -> RobotState:
        self.commands.append(q_c)
        return RobotState(0.0, q_c, q_c)

    def away(self, q_d: Array) -> None:
        """Nothing is pressed on."""

    def pacing(self, limits: Robot) -> None:
        """The arm never stands."""

    def speed(self, t: float) -> float:
        return 0.1

    def done(self, t: float) -> bool:
        return False

    def observe(self, *_: object) -> None:
        """Nothing is observed."""

    request = collect = observe


def test_a_plan_of_numbers_that_are_none_ends_in_a_stop_on_the_path() -> None:
    task, log = Drifting(), CycleLog()
    play_cycles(task, Robot.load("kr6"), task, log, CycleSettings(5.0, 0.1, 3.0, 3.0, ""), silent)
    assert log.failure is not None
    assert "not numbers" in log.failure
    commands = np.array(task.commands)
    assert np.isfinite(commands).all()
    assert np.ptp(commands[-5:], axis=0).max() < 1e-9
    assert np.all(np.diff(commands, axis=0) > -1e-12)


def test_what_a_play_put_aside_for_the_collector_is_given_back() -> None:
    before = gc.get_freeze_count()
    task = Drifting()
    play_cycles(task, Robot.load("kr6"), task, CycleLog(), CycleSettings(5.0, 0.1, 0.2, 0.2, ""), silent)
    assert gc.get_freeze_count() <= before


@pytest.mark.parametrize(("scene", "table"), [("force_wave", "sensor"), ("line", "camera")])
def test_a_rate_of_as_good_as_nothing_is_refused(scene: str, table: str) -> None:
    with pytest.raises(InputError, match=f"{table}.rate"):
        load_scene(scene).changed(**{table: {"rate": 1e-320}})


@pytest.mark.parametrize(("table", "key"), [("sensor", "lie"), ("trouble", "loss"), ("trouble", "garbage")])
def test_a_time_without_an_end_is_no_span(table: str, key: str) -> None:
    for times in ([1.0], [2.0, 1.0], [0.0, 1.0, 2.0], [-5.0, -1.0]):
        with pytest.raises(InputError, match="from and to") as refused:
            load_scene("glue").changed(**{table: {key: times}})
        assert refused.value.field == f"{table}.{key}"


@pytest.mark.parametrize(("table", "key", "value"), [
    ("displacement", "height_mm", 5.0), ("camera", "rate", 25.0), ("calibration", "by_moving", False),
    ("trouble", "loss", [1.0, 2.0]), ("assumed", "distance_ratio", 1.2)])
def test_what_only_a_camera_shows_counts_only_where_one_looks(table: str, key: str, value: object) -> None:
    changes: dict[str, Any] = {table: {key: value}}
    load_scene("glue").changed(**changes)
    for blind in ("force_wave", "contour"):
        with pytest.raises(InputError, match="leave it out") as refused:
            load_scene(blind).changed(**changes)
        assert refused.value.field == f"{table}.{key}"


@pytest.mark.parametrize(("changes", "field"), [
    ({"sensor": {"noise": [-0.3, 0.02]}}, "sensor.noise"), ({"box": {"middle": [0, 0, 0], "size": [1, 1, 1]}}, "box"),
    ({"line": {"svg_length": 0.5}}, "line"), ({"line": {"corner_radius": 0.01}}, "line")])
def test_what_cannot_be_or_has_no_effect_is_refused(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError, match=r"standard deviations|\[\[box\]\]|leave it out") as refused:
        load_scene("force_wave").changed(**changes)
    assert refused.value.field == field


@pytest.mark.parametrize("key", ["ambient_temperature", "start_temperature"])
def test_nothing_is_colder_than_absolute_zero(key: str) -> None:
    World.from_table("kr6", {key: -273.0})
    with pytest.raises(InputError, match=f"world.{key}: expected degrees Celsius"):
        World.from_table("kr6", {key: -500.0})


def test_gears_that_one_clamped_recording_loads_are_not_judged() -> None:
    with pytest.raises(InputError, match="two clamped recordings"):
        close_loop(load_scene("close_clamped").changed(clamp={"most": 1}))


def test_a_world_that_cannot_be_is_refused_before_it_is_compared_with_the_model(tmp_path: Path) -> None:
    place = tmp_path / "s.toml"
    place.write_bytes(sound.PATH + b'[world]\nstiffness = "/dev/zero"\n')
    with pytest.raises(InputError, match="stiffness"):
        undeclared_effects(load_scene(place), 6)


def test_a_world_with_another_number_of_joints_is_not_closed() -> None:
    with pytest.raises(InputError, match="one per joint"):
        undeclared_effects(load_scene("close_stribeck").changed(world={"stribeck": []}), 6)


def test_an_interrupt_before_a_verb_has_begun_ends_without_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(verb: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "declared", interrupted)
    monkeypatch.setattr(sys, "argv", ["ideal-robot", "run"])
    monkeypatch.setattr(cli.signal, "signal", lambda number, handler: None)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130


def test_a_matlab_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "emps.mat"
    place.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\x0e\x00\x00\x00\xff\x00\x00\x00")
    with pytest.raises(InputError, match="not readable as mat"):
        fetch("emps", tmp_path, file=place)


@pytest.mark.parametrize(("key", "value", "field", "says"), [
    pytest.param("filter_time", [0.001] * 5 + [True], "filter_time", "times of 0 to 0.1 s",
                 id="a command filter of a second, before its inverse takes minutes"),
    ("spread", [0.4, 0.4], "spread", ""), ("spread", {"gain": [0.4] * 6}, "spread.gain", ""),
    ("spread", {"position_gain": [0.4, None, 0.4, 0.4, 0.4, 0.4]}, "spread.position_gain", ""),
])
def test_a_cascade_that_cannot_be_is_refused_where_the_model_is_read(
        tmp_path: Path, key: str, value: object, field: str, says: str) -> None:
    values = json.loads(shipped_model("kr6").read_text(encoding="utf-8"))
    values["controller"][key] = value
    place = tmp_path / "m.json"
    place.write_text(json.dumps(values))
    with pytest.raises(InputError) as refused:
        Model.load(place)
    assert refused.value.field == f"controller.{field}"
    assert says in str(refused.value)


def test_a_camera_s_process_ends_without_a_word_where_its_parent_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(carried.signal, "signal", lambda number, handler: None)
    parent, pipe = multiprocessing.Pipe()
    os.write(parent.fileno(), b"\0\0\1\0cut off")
    parent.close()
    carried.draw_and_send(pipe)


def test_a_mat_file_that_its_reader_does_not_survive_is_refused(tmp_path: Path) -> None:
    """Numbers of no type end SciPy's compiled reader, and its process, by a segmentation fault."""
    buffer, place = io.BytesIO(), tmp_path / "emps.mat"
    savemat(buffer, {name: np.arange(200.0) for name in ("t", "qm", "qg", "vir")})
    content = bytearray(buffer.getvalue())
    assert content[176] == 9  # the first variable's numbers are doubles
    content[176] = 0
    place.write_bytes(content)
    with pytest.raises(InputError, match="reader crashes on this file"):
        fetch("emps", tmp_path, file=place)


def test_of_an_only_joint_no_cause_with_a_partner_is_asked(program, tmp_path: Path,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    t = 0.01 * np.arange(300)
    columns = {name: np.sin(3.0 * t) + 0.2 * np.sin(17.0 * t) for name in ("q_1", "q_c_1", "tau_1")}
    (tmp_path / "r.csv").write_bytes(sound.csv_bytes({"t": t, **columns}))
    links, _, rest = sound.URDF.partition(b'<link name="lower"')
    joint = rest[rest.index(b'<joint name="first"') : rest.index(b'<joint name="second"')]
    (tmp_path / "arm.urdf").write_bytes(links + joint + b"</robot>")
    (tmp_path / "d.json").write_text('{"effects": [], "undecided": [{"joint": 1, "reason": "rests"}]}')
    monkeypatch.setenv("IDEAL_ROBOT_DEBUG", "1")
    assert program("plan-diagnosis", "r.csv", "--urdf", "arm.urdf", "--result", "d.json", "--length", "4", "--z-min",
                   "-5", "--out", "m.csv").code in (0, 2)


def test_the_give_of_a_clamp_is_asked_of_six_joints_only(tmp_path: Path) -> None:
    """By default it is left out where it cannot be told apart; asked for, it is refused."""
    arm = sound.arm(tmp_path)
    pushed = [Recording(sound.pushes(tmp_path)) for _ in range(2)]
    assert {estimate.joint for estimate in analyse_stiffness(pushed, arm).joints} <= {1, 2}
    with pytest.raises(InputError, match="six joints"):
        analyse_stiffness(pushed, arm, clamp=True)


def test_an_arm_whose_file_has_moments_of_no_body_can_be_drawn(tmp_path: Path) -> None:
    """Stretched, they were negative (seed 679723)."""
    drawn = []
    for ixx in (b'"0.1"', b'"100000.0"'):
        (tmp_path / "arm.urdf").write_bytes(sound.URDF.replace(b'ixx="0.1"', b"ixx=" + ixx))
        robot = Robot.load(tmp_path / "arm.urdf")
        drawn.append(draw_specimen(robot, World.from_table(robot, {"inertia_tolerance": 0.15, "individual": 2})))
    masses = [specimen.model.inertias[2].mass for specimen in drawn]
    assert masses[0] == pytest.approx(masses[1])
    assert masses[0] != pytest.approx(3.0)


# What structural fuzzing found, each pinned: values of the wrong size, depth or kind where none was looked for.

@pytest.mark.parametrize("text", ["x" * 300_000, "\\\"" * 150_000, "'a" * 150_000, " ." * 150_000])
def test_long_words_are_read_in_one_pass(tmp_path: Path, text: str) -> None:
    """They took minutes: each place of a word was taken for the beginning of a key of many parts."""
    place = tmp_path / "model.json"
    place.write_text(json.dumps({"name": text}))
    assert read_json(place, "a model")["name"] == text
    place.write_text(f'name = "{text}')
    with pytest.raises(InputError, match="not a readable"):
        read_toml(place, "a scene")


def test_a_key_of_many_parts_and_deep_nesting_are_still_refused(tmp_path: Path) -> None:
    place = tmp_path / "scene.toml"
    for text, says in (("a." * 5000 + "b = 1", "parts"), ("a = " + "[" * 5000, "nested")):
        place.write_text(text)
        with pytest.raises(InputError, match=says):
            read_toml(place, "a scene")


def test_a_calibration_nested_without_end_is_no_calibration(tmp_path: Path) -> None:
    place = tmp_path / "camera.json"
    place.write_text('{"a":' * 3000 + "1" + "}" * 3000)
    with pytest.raises(InputError):
        calibrated_camera(believed_camera(CameraTable()), place)


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes there")
def test_a_pipe_that_nobody_writes_to_is_not_waited_for(tmp_path: Path) -> None:
    place = tmp_path / "pipe"
    os.mkfifo(place)
    for read in (lambda: RsiFormat.read(place, 6), lambda: SweepFile(place, resume=True),
                 lambda: read_json(place, "a model")):
        with pytest.raises(InputError):
            read()


@pytest.mark.parametrize("name", ["p.png", "p.jpg", "v.mp4"])
def test_what_libraries_say_of_broken_pictures_goes_nowhere(tmp_path: Path, name: str,
                                                             capfd: pytest.CaptureFixture[str]) -> None:
    raw = bytearray(cv2.imencode(".png", np.full((120, 160), 200, np.uint8))[1].tobytes())
    raw[20] ^= 0xFF
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError):
        list(pictures(str(tmp_path / name)))
    assert capfd.readouterr().err == ""


def test_of_a_parameter_without_a_finite_covariance_nothing_is_known(tmp_path: Path) -> None:
    """A hole (``null``) in the covariance of a model file ended a diagnosis in a singular value decomposition."""
    robot = sound.arm(tmp_path)
    columns = sound.motion(tmp_path)
    recording = Recording.from_arrays(columns["t"], **{
        name: np.column_stack([columns[f"{name}_{i}"] for i in (1, 2)]) for name in ("q", "tau")})
    nominal = Model.nominal(robot)
    covariance = np.diag(np.full(len(nominal.covariance), 1e-4))
    covariance[0, 3] = np.nan
    model = replace(nominal, covariance=covariance)
    root = same_arm(model)
    std = np.sqrt((root**2).sum(axis=1))
    assert np.isfinite(root).all()
    assert std[0] > 10.0
    assert std[3] > 10.0
    assert std[1] == pytest.approx(0.01, rel=0.01)
    assert diagnose(recording, robot, model=model).verdict
