"""What users bring along, of their own or as the help, examples and how-to pages tell them to."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import typer
from PIL import Image, ImageDraw

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward import registry
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Setting
from ideal_robot.robots.robot import Robot
from scenes import Reading, compare_scene, load_scene, run_scene
from scenes.cli import THEMES, VERBS, function_of
from scenes.identification.plan import plan, play_plan
from scenes.kind import kind_of
from scenes.methods import compared, method_of
from scenes.view.viewer import Viewer
from sensing.camera.detector import EdgePairs
from sim.arm.world import World
from sim.devices import rsi_controller
from tests.conftest import Ended
from tests.scenes.line.test_line import short
from tests.sources import DATA, ROOT, free_port


class Ahead(Feedforward):
    """Commands where the arm shall be some cycles later."""

    t_ipo = 0.012

    def __init__(self, cycles: int = 1) -> None:
        self.n_d = cycles + 1

    def init(self, q0: Array) -> Any:
        return None

    def step(self, state: Any, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Any]:
        assert q_d.shape[0] == self.n_d
        return q_d[-1], state


def factory(setting: Setting) -> Feedforward:
    """Two cycles ahead."""
    return Ahead(2)


@pytest.fixture
def own_key() -> Iterator[str]:
    registry.register("mine", factory)
    yield "mine"
    registry.unregister("mine")


def test_feedforward_objects_and_factories_are_rows_of_the_table() -> None:
    comparison = compare_scene(short(), methods=["sensor_path", Ahead(), factory])
    assert [row[0] for row in comparison.table()[1]] == ["sensor_path", "Ahead", "factory"]
    errors = {key: run.path_errors.time_matched.E_car for key, run in comparison.runs.items()}
    # Each cycle of looking ahead takes away some of the arm's delay.
    assert errors["factory"] < errors["Ahead"] < errors["sensor_path"]


def test_a_registered_feedforward_is_a_key_everywhere(own_key: str) -> None:
    for name in ("line", "iso9283_1", "force_wave"):
        keys = kind_of(load_scene(name)).methods()
        assert own_key in keys
        assert own_key in [method.key for method in compared(None, keys)]
    assert run_scene(short(), method=own_key).method == own_key


def test_what_a_method_cannot_be_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="expected one of none, ideal"):
        method_of("idael", ("none", "ideal"))
    with pytest.raises(InputError, match="two methods have that name"):
        compared([Ahead(), Ahead(2)], ("none",))
    with pytest.raises(InputError, match="desired positions ahead, Ahead needs more"):
        run_scene(short(), method=Ahead(500))
    monkeypatch.setattr(Ahead, "observe", lambda *_: 1 / 0)
    for scene in (short(), load_scene("iso9283_1")):
        with pytest.raises(ZeroDivisionError, match="Ahead: observe"):
            run_scene(scene, method=Ahead())


class AllRows(Ahead):
    """Commands all rows of its horizon at once."""

    def step(self, state: Any, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Any]:
        return q_d, state


class Fast(Ahead):
    """Made for a controller three times as fast."""

    t_ipo = 0.004


@pytest.mark.parametrize("name", ["straight", "force_wave", "edge"])
@pytest.mark.slow
def test_a_feedforward_that_cannot_be_played_is_told_from_one_that_follows_badly(name: str) -> None:
    for wrong, says in ((AllRows(), r"step has to return a command of shape \(6,\)"),
                        (Fast(), "made for a cycle of 0.004 s, the arm has 0.01"),
                        (lambda setting: None, "expected a Feedforward")):
        with pytest.raises(InputError, match=says):
            run_scene(load_scene(name), method=wrong)


class Profile:
    """Sees the line 30 mm ahead, 20 ms late, at an angle to the path's normal; wrong by ``error`` [m].

    Its standard deviation holds what is not known of where the arm carries it: a tenth of a millimetre.
    """

    name = "profile"

    def __init__(self, error: float = 0.0, std: float = 1e-4) -> None:
        self.error, self.std = error, std

    def mount(self, world: Any) -> None:
        self.world = world

    def arrived(self, t: float) -> list[Reading]:
        stamp, place = max(t - 0.02, 0.0), (0.03, 0.0, 0.0)
        return [Reading(stamp, place, self.world.distance(stamp, place) + self.error, self.std**2)]


def test_an_own_sensor_is_fused_with_the_camera() -> None:
    """Where nine of ten fields are lost, a further sensor helps; one that is wrong leads the tool astray."""
    scene = short().changed(camera={"loss": 0.9}, max_gap=0.5)
    without = run_scene(scene)
    helped, led = (run_scene(scene, sensors=[Profile(error)]) for error in (0.0, 5e-4))
    values, used = helped.sensors["profile"]
    assert values > 40
    assert used > 0.9 * values
    assert helped.control_error.mean < without.control_error.mean
    assert led.control_error.mean > 2 * helped.control_error.mean


@pytest.mark.parametrize("variance", [0.0, -1e-8])
def test_a_reading_without_a_variance_is_refused(variance: float) -> None:
    sensor = Profile()
    sensor.arrived = lambda t: [Reading(t, (0.03, 0.0, 0.0), 0.0, variance)]  # type: ignore[method-assign]
    with pytest.raises(InputError, match="profile: variance: expected a variance above zero"):
        run_scene(short(), method="sensor_path", sensors=[sensor])


def test_what_own_sensors_and_detectors_do_wrong_is_named(monkeypatch) -> None:
    """Sensors of one name were counted together; who returned nothing was told of an attribute of ours."""
    silent = Profile()
    silent.arrived = lambda t: None  # type: ignore[assignment, method-assign, return-value]
    monkeypatch.setattr(EdgePairs, "detect", lambda self, *arguments: None)
    for sensors, says in (([Profile(), Profile()], "two sensors have that name"),
                          ([silent], "profile: arrived: expected a Sequence; return a list of Readings"),
                          ([Profile(None)], "sensor profile: arrived"),
                          ([], "detector edge_pairs: expected a LineField; return one from detect")):
        with pytest.raises((InputError, TypeError), match=says):
            run_scene(short(), method="sensor_path", sensors=sensors)


# An arm nobody wrote a world for: it is planned for, played, served over RSI and viewed, with meshes or without.

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
    recording = play_plan(plan(arm, "joint", period=2.0), arm, seed=1)
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
    pytest.importorskip("viser")
    viewer = Viewer(Robot.load(own), free_port())
    try:
        assert len(viewer.shapes) >= 4
    finally:
        viewer.server.stop()


def test_the_address_said_is_the_one_served(program: Callable[..., Ended]) -> None:
    """On a taken port the viewer moves to another; the command must not print the taken one."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        done = program("view", "kr6", "--once", "--port", str(port))
    assert done.code == 0, done.err
    address = re.search(r"http://127\.0\.0\.1:(\d+)", (done.out + done.err).partition("open ")[2])
    assert address is not None
    assert int(address[1]) != port


UR10E = DATA / "ur10e" / "ur10e.urdf"


@pytest.mark.skipif(not UR10E.is_file(), reason="needs the public data sets beside the repository")
def test_an_arm_whose_joints_turn_far_gets_a_motion() -> None:
    """Most random motions of such an arm hit the floor; with this seed the first search finds none."""
    assert len(plan(Robot.load(UR10E), "joint", seed=2).commands) > 1000


# Examples in the help: each verb has one, and it runs as printed in an empty folder, after those it names.

QUICK = {"list", "new", "fetch", "detect"}
"""Verbs whose example takes a second and needs no other."""
ADDITION = {"view": ["--once"]}
"""What keeps an example from waiting for the user."""


class Example(NamedTuple):
    """The first example of a verb.

    ``after``: verb whose example has to run before; ``beside``: the last command runs in another terminal.
    """

    after: str
    commands: tuple[tuple[str, ...], ...]
    beside: bool


def example(verb: str) -> Example:
    paragraphs = re.split(r"\n\n", inspect.getdoc(function_of(verb)) or "")
    text = next(" ".join(paragraph.split()) for paragraph in paragraphs if paragraph.startswith("Example"))
    head = re.match(r"Example(?:, after that of `([\w-]+)`|, with [\w ]+)?:", text)
    assert head is not None, text
    commands = re.findall(r"`(ideal-robot .*?)`", text)
    return Example(head[1] or "", tuple(tuple(shlex.split(line)[1:]) for line in commands), "another terminal" in text)


def chain(verb: str) -> list[str]:
    """A verb behind those whose examples come before it."""
    before = example(verb).after
    return [*(chain(before) if before else []), verb]


ENDS = sorted(set(VERBS) - QUICK - {example(verb).after for verb in VERBS} - {"simulate"})
"""Verbs after which no other one comes; the example of ``simulate`` is that of ``follow``."""


def test_six_verbs_come_first() -> None:
    assert len(next(iter(THEMES.values()))) == 6
    assert len(VERBS) == sum(map(len, THEMES.values()))


@pytest.mark.parametrize("verb", VERBS)
def test_the_first_example_of_a_verb_has_its_options(verb: str) -> None:
    printed = example(verb)
    assert verb in [words[0] for words in printed.commands]
    for name, *words in printed.commands:
        assert {word for word in words if word.startswith("-")} <= options_of(name)
    assert chain(verb)[-1] == verb
    assert printed.beside == (verb in ("follow", "simulate"))


@pytest.mark.parametrize("verb", sorted(QUICK))
def test_a_quick_example_runs_as_printed(verb: str, program: Callable[..., Ended], tmp_path: Path) -> None:
    if verb == "detect":
        picture = Image.new("L", (640, 480), 200)
        ImageDraw.Draw(picture).line([(0, 200), (640, 260)], fill=40, width=9)
        noise = np.random.default_rng(1).normal(0.0, 8.0, (480, 640))
        (tmp_path / "pictures").mkdir()
        Image.fromarray(np.clip(picture + noise, 0, 255).astype(np.uint8)).save(tmp_path / "pictures" / "line.png")
    for words in example(verb).commands:
        done = program(*words)
        assert done.code == 0, done.err


@pytest.mark.slow
@pytest.mark.parametrize("verb", [pytest.param(verb, marks=pytest.mark.real_time if example(verb).beside else ())
                                  for verb in ENDS])
def test_an_example_runs_as_printed(verb: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")  # A baseline is written beside its suite.
    environ = {**os.environ, "PYTHONPATH": str(ROOT), "IDEAL_ROBOT_CACHE": str(tmp_path / "cache")}

    def begun(words: tuple[str, ...]) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, "-m", "scenes.cli", *words, *ADDITION.get(words[0], [])],
                                cwd=tmp_path, env=environ, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    for step in chain(verb):
        printed = example(step)
        aside = [begun(words) for words in printed.commands[:-1]] if printed.beside else []
        for words in printed.commands[-1:] if printed.beside else printed.commands:
            process = begun(words)
            output, _ = process.communicate(timeout=1800)
            assert process.returncode == 0, f"{' '.join(words)}\n{output[-3000:]}"
        for process in aside:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
            assert process.returncode == 0


# How-to pages: a question and one screen each, with commands that run as printed.

INDEX = ROOT / "docs" / "howto" / "index.md"
PAGES = sorted(page for page in INDEX.parent.glob("*.md") if page != INDEX)
BLOCK = re.compile(r"```(sh|python)\n(.*?)```", re.DOTALL)


def options_of(verb: str) -> set[str]:
    """All options of a verb, as its own parser has them."""
    app = typer.Typer()
    app.command()(function_of(verb))
    return {option for param in typer.main.get_command(app).params for option in (*param.opts, *param.secondary_opts)}


def test_the_questions_are_a_click_from_the_index() -> None:
    linked = re.findall(r"^- \[(.*?)\]\((\w+\.md)\)$", INDEX.read_text(encoding="utf-8"), flags=re.MULTILINE)
    titles = {page.name: page.read_text(encoding="utf-8").splitlines()[0] for page in PAGES}
    assert {name: f"# {title}" for title, name in linked} == titles
    assert len(titles) >= 20
    assert all("?" in title for title in titles.values())


def test_the_doors_of_the_front_page_open_the_parts_of_the_index() -> None:
    doors = re.findall(r"\(howto/index\.md#([\w-]+)\)", (ROOT / "docs" / "index.md").read_text(encoding="utf-8"))
    parts = re.findall(r"^## (.*)$", INDEX.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert doors == [re.sub(r"\W+", "-", part.lower().replace("'", "")) for part in parts]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_of_commands_that_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert BLOCK.search(text)
    lines = [line for kind, code in BLOCK.findall(text) if kind == "sh" for line in code.splitlines() if line]
    for line in lines:
        program, *words = shlex.split(line.removesuffix("&"))
        if program == "ideal-robot":
            options = {word for word in words if word.startswith("-") and len(word) > 1}
            assert options <= options_of(words[0]), line


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs_as_printed(page: Path, tmp_path: Path) -> None:
    if "examples/" in page.read_text(encoding="utf-8"):
        (tmp_path / "examples").symlink_to(ROOT / "examples")
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, words in (("ideal-robot", "-m scenes.cli"), ("python", "")):
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n', encoding="utf-8")
        (programs / name).chmod(0o755)
    environ = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for kind, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        # A viewer waits for the user otherwise; what runs beside another command is waited for.
        script = re.sub(r"^(ideal-robot view .*)$", r"\1 --once", code, flags=re.MULTILINE) + "\nwait\n"
        call = ["bash", "-e", "-c", script] if kind == "sh" else [sys.executable, "-c", code]
        done = subprocess.run(call, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{code}\n{done.stdout[-1500:]}\n{done.stderr[-3000:]}"
