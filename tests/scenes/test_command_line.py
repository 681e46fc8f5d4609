"""The command line: exit codes, one clear line for bad input, and what --json holds."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from itertools import accumulate, pairwise
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import ideal_robot
import scenes
from ideal_robot.identification import whole_model
from ideal_robot.progress import Steps
from ideal_robot.signals.recording import Recording
from scenes.cli import VERBS, function_of
from scenes.closing import result as closing
from scenes.commands import recordings
from scenes.commands.common import completed, methods_of, progress_bar, show_table
from scenes.path import kind
from scenes.scene_file import load_scene
from studies.sweeps import SCENES
from tests.ideal_robot.test_door import ROBOT, frame

SHORT = SCENES["short"]


def test_run_writes_what_json_names(program, tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    done = program("run", "short", "--json", "figures.json", "--seed", "4")
    assert done.code == 0, done.err
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["scene"] == "short"
    assert figures["seed"] == 4
    assert figures["method"] == "adapted"
    assert set(figures["control_error_mm"]) == {"mean", "p95", "max"}
    for alignment in ("time_matched", "aligned", "geometric"):
        assert set(figures["path_error_mm"][alignment]) == {"E_car", "E_max"}
    assert {"seen", "used"} <= set(figures["fields"])
    times, files = figures["times"], figures["files"]
    assert {"median", "p99", "max"} <= set(times["cycle_time_ms"])
    assert times["real_time_factor"] > 0
    assert (tmp_path / files["recording"]).is_file()
    assert Path(files["urdf"]).is_file()
    assert not {*times, *files} & set(figures)


@pytest.mark.parametrize(
    ("change", "words", "says"),
    [
        (("[surface]", "[surface]\ntilt = 3"), (), ("surface.tilt", "unknown key", "tilt_deg")),
        (("[surface]", "[world]\nstifness = 3\n[surface]"), (), ("short.toml: world.stifness", "unknown key")),
        (("[surface]", "[world]\ndamping = -1\n[surface]"), (), ("short.toml: world.damping", "negative")),
        (("[line]", "[line]\nsvg = 'M 0 0 L 1 1'"), (), ("short.toml: line: expected exactly one",)),
        (("speed = 0.7", "speed = -1"), (), ("speed", "greater than 0")),
        (("[surface]", "[camera]\nlatency = -0.02\n[surface]"), (), ("camera.latency", "greater than or equal")),
        (("0.98", "9.98"), (), ("out of reach", "kr6")),
        (("kind", "kind = 'line'\nkind"), (), ("not a readable scene",)),
        (("", ""), ("--speed", "9"), ("speed",)),
        (("", ""), ("--speed", "-2"), ("--speed", "positive")),
        (("", ""), ("--method", "magic"), ("method", "expected one of")),
    ],
)
def test_bad_input_ends_with_two_and_one_clear_line(program, tmp_path: Path, change: tuple[str, str],
                                                    words: tuple[str, ...], says: tuple[str, ...]) -> None:
    (tmp_path / "short.toml").write_text(SHORT.replace(*change) if change[0] else SHORT)
    done = program("run", "short", *words)
    assert done.code == 2
    (line,) = done.lines
    assert all(word in line for word in says)
    assert not (tmp_path / "out").exists()


def test_two_scenes_of_one_name_are_refused(program, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text('name = "twin"\n' + SHORT)
    done = program("run", "twin")
    assert done.code == 2
    assert all(word in done.err for word in ("two scenes", "a.toml", "b.toml"))


def test_a_scene_that_does_not_exist_names_those_that_do(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "scenes.cli", "run", "lime"], cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 2
    assert "straight" in done.stderr


@pytest.mark.slow
def test_a_run_that_loses_the_line_ends_with_one_and_keeps_its_recording(program, tmp_path: Path) -> None:
    lost = SHORT.replace("[0.8, 0.0]]", "[1.1, 0.0]]") + '[[feature]]\nkind = "gap"\nat_mm = 450\nlength_mm = 500\n'
    (tmp_path / "lost.toml").write_text(lost)
    done = program("run", "lost")
    assert done.code == 1
    assert "line lost" in done.err
    assert {"recording.parquet", "report.html"} <= {path.name for path in (tmp_path / "out" / "lost").iterdir()}


@pytest.mark.parametrize("verb", ["rsi", "precorrect"])
def test_the_help_lists_the_methods_of_the_registry(program, verb: str) -> None:
    text = " ".join(program(verb, "--help").out.replace("│", " ").split())
    # Settings behind a method have a hyphen; they are named where they are compared.
    assert all(key in text for key in methods_of(verb) if "-" not in key)
    assert "Example" in text
    assert completed(verb, "id") == ["ideal"]


def test_a_corrected_path_does_not_take_the_place_of_the_path(program, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("t,q_d_1\n0,0\n")
    done = program("precorrect", "p.csv", "--model", "m.json", "-o", str(tmp_path / "p.csv"))
    assert done.code == 2
    assert "--output: is the path that is to be corrected" in done.err
    assert (tmp_path / "p.csv").read_text() == "t,q_d_1\n0,0\n"


def test_no_recording_validates_what_was_found_in_it(program, tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t,q_1,tau_1\n0,0,1\n")
    done = program("diagnose", "a.csv", "--robot", "kr6", "--validate", "b.csv")
    assert done.code == 2
    assert "b.csv: recording: holds the same samples as a.csv" in done.err


TOO_LONG, NO_NUMBER = "no file can have so long a name", "no finite number"


@pytest.mark.parametrize(("words", "says"), [
    (("fetch", "emps", "--file", "x" * 300), TOO_LONG), (("run", "line", "--out", "y/" * 3000), TOO_LONG),
    (("diagnose", "z" * 300 + ".csv", "--robot", "kr6"), TOO_LONG),
    (("identify", "r.csv", "--robot", "kr6", "--decimate-to", "nan"), NO_NUMBER),
    (("run", "line", "--speed", "inf"), NO_NUMBER)])
def test_what_is_no_name_or_no_number_is_refused_by_every_verb(program, words: tuple[str, ...], says: str) -> None:
    done = program(*words)
    assert done.code == 2
    assert says in done.err


# What a person sees in a terminal: tables that lose nothing, the version, one meaning of an option in every verb.

COLUMNS = ["channel", "before", "after", "noise", "depends on"]
ROWS = [["torque of joint_with_a_long_name", 12.345, 0.06789, None, "position and velocity of that joint"],
        ["b", 123456.0, 1.5e-9, 3, "nothing"]]


@pytest.mark.parametrize("width", [None, 40, 60, 80, 120])
def test_tables_lose_no_word_and_no_number(width: int | None, monkeypatch: pytest.MonkeyPatch,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if width is not None:
        monkeypatch.setenv("COLUMNS", str(width))
    show_table("errors on held-out data", COLUMNS, ROWS)
    printed = capsys.readouterr().out
    words = {word for row in ROWS for cell in row if isinstance(cell, str) for word in cell.split()}
    for word in {*words, "12.3", "0.0679", "1.23e+05", "1.5e-09", "depends", "held-out"}:
        assert word in printed, (word, printed)
    if width is not None:
        assert max(map(len, printed.splitlines())) <= width
    else:
        assert "position and velocity of that joint" in printed


def test_many_columns_become_blocks_of_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
                                             ) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    show_table("", [f"column{i}" for i in range(12)], [[f"name{i}" for i in range(12)]])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "name0"
    assert lines[-1].strip() == "column11: name11"


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_that_comes_within_a_callback_ends_the_program(name: str, code: int) -> None:
    """While numba compiled, it was shown as a traceback, and the program went on."""
    text = ("import ctypes, os, signal, time; from scenes import cli\n"
            "signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell\n"
            "def app():\n"
            f"    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.{name}))()\n"
            "    time.sleep(60.0)\n"
            "cli.app = app; cli.main()")
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, "")


@pytest.mark.parametrize("error", ["RuntimeError", "ImportError", "SystemError"])
def test_an_interrupt_that_compiled_code_makes_another_error_of_is_one(error: str) -> None:
    """Ctrl-C during imports was "cannot be computed from this input (RuntimeError …)"."""
    text = ("import os, signal, time; from scenes import cli\n"
            "signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell\n"
            "def app():\n"
            "    try:\n        os.kill(os.getpid(), signal.SIGINT); time.sleep(60.0)\n"
            f"    except KeyboardInterrupt:\n        raise {error}('numpy.core failed to import')\n"
            "cli.app = app; cli.main()")
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "")


def test_version_is_the_packages_and_completion_can_be_installed(program) -> None:
    assert re.fullmatch(r"ideal-robot \d+\.\d+\.\d+\S*\n", program("--version").out)
    assert "--install-completion" in program("--help").out


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"], ["run", "nothing"], ["sweep", "line", "nothing"],
                                   ["diagnose", "nothing.csv", "--robot", "kr6"], *(
                                       pytest.param(words, marks=pytest.mark.slow) for words in (
                                           ["check", "nothing.toml"], ["view", "nothing"], ["view", "nothing.csv"],
                                           ["new", "mine", "--robot", "nothing"]))])
def test_a_first_answer_loads_nothing_that_computes(words: list[str]) -> None:
    """It comes in a third of a second; NumPy alone would take a fifth more."""
    code = ("import atexit, sys; atexit.register(lambda: print({'numpy', 'scenes.workers'} & {*sys.modules})); "
            f"sys.argv[1:] = {words}; from scenes.cli import main; main()")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "set()"
    assert done.returncode == (0 if "--help" in words else 2)
    assert "--help" in words or "nothing" in done.stderr


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_robot_means_the_same_in_every_verb(verb: str) -> None:
    """A name or a path of an arm; drive data have their own option."""
    command = function_of(verb)
    hints = get_type_hints(command, include_extras=True)
    assert "urdf" not in inspect.signature(command).parameters
    if "robot" in hints:
        kind, option = get_args(hints["robot"])
        assert kind in (str, str | None)
        assert {"--robot", "--urdf"} <= {option.default, *option.param_decls}
        assert "name of a shipped robot, or path of a URDF" in option.help


@pytest.mark.parametrize("width", [60, 70])
def test_a_parameter_is_a_line_where_its_longest_words_fit(width: int, monkeypatch: pytest.MonkeyPatch,
                                                           capsys: pytest.CaptureFixture[str]) -> None:
    """Without borders at 60 columns; at 70 with borders, none of which is cut off."""
    monkeypatch.setenv("COLUMNS", str(width))
    show_table("", ["name", "joint", "value", "σ", "σ [%]", "unit"],
               [["presliding_4", 4, 0.000346, 130.0, 3.77e7, "rad"], ["a4_1", 1, 300.0, 2891.0, 962.0, "1 / (rad/s)"]])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    row = next(line for line in lines if "presliding_4" in line)
    assert all(word in row for word in ("4", "0.000346", "130", "3.77e+07", "rad"))
    assert ("│" in row) == (width == 70)
    assert row.rstrip().endswith("│") == (width == 70)


@pytest.mark.parametrize("width", [40, 60, 120])
def test_the_bar_keeps_its_numbers_whatever_its_text(width: int, monkeypatch: pytest.MonkeyPatch,
                                                     capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in {"COLUMNS": str(width), "TTY_COMPATIBLE": "1", "FORCE_COLOR": "1", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    with progress_bar("line") as move:
        move(0.42, "searching the gain at which direct feedback overshoots, in words for which there is no room")
    printed = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)
    line = next(text for text in re.split(r"[\r\n]+", printed) if "42 %" in text)
    assert line.startswith("line: s")
    assert re.search(r"42 % \d:\d\d:\d\d ", line)
    assert len(line) <= width


# The bar goes by measured shares of the time: they are declared, add up to the whole, and are what is told.

diagnosing = importlib.import_module("ideal_robot.diagnosis.diagnose")


class Heard:
    """A progress that remembers what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, str]] = []

    def __call__(self, fraction: float, text: str) -> None:
        self.told.append((fraction, text))

    def begins_as(self, shares: dict[str, float]) -> None:
        """Every step is told of where the shares before it end, and nothing goes back."""
        begun = dict(reversed([(text, fraction) for fraction, text in self.told]))
        for step, start in zip(shares, accumulate([0.0, *shares.values()]), strict=False):
            assert begun[step] == pytest.approx(start), step
        assert all(a <= b for (a, _), (b, _) in pairwise(self.told))


def declared() -> list[tuple[str, dict[str, float]]]:
    tables = []
    for package in (ideal_robot, scenes):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            tables += [(f"{module.name}.{name}", shares) for name, shares in
                       vars(importlib.import_module(module.name)).items()
                       if name.startswith("SHARES") and isinstance(shares, dict)]
    return tables


@pytest.mark.parametrize(("where", "shares"), declared())
def test_shares_add_up_to_the_whole(where: str, shares: dict[str, float]) -> None:
    assert sum(shares.values()) == pytest.approx(1.0), where
    assert min(shares.values()) > 0.0


def test_steps_begin_where_those_before_end_and_never_go_back() -> None:
    heard = Heard()
    steps = Steps(heard, {"first": 0.2, "second": 0.5, "third": 0.3})
    steps.begin("first")(0.5, "half")
    part = steps.begin("second", "in other words")
    part(0.8, "far")
    part(0.1, "again from the beginning")
    steps.begin("third")(1.0, "")
    assert [text for _, text in heard.told] == ["first", "half", "in other words", "far", "again from the beginning",
                                                "third", ""]
    assert [fraction for fraction, _ in heard.told] == pytest.approx([0.0, 0.1, 0.2, 0.6, 0.6, 0.7, 1.0])


def test_diagnosis_goes_by_its_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(diagnosing.SHARES)[1:] == list(diagnosing.STAGES)

    def stage(case, found):  # type: ignore[no-untyped-def]
        case.progress(1.0, "done")
        return found

    monkeypatch.setattr(diagnosing, "STAGES", dict.fromkeys(diagnosing.STAGES, stage))
    monkeypatch.setattr(diagnosing, "diagnosis_of", lambda case, found: None)
    recording = Recording.from_arrays(0.01 * np.arange(3000.0), q=np.column_stack(
        [0.8 * np.sin((0.7 + 0.2 * j) * 0.01 * np.arange(3000.0)) for j in range(6)]), tau=np.random.default_rng(
            0).normal(size=(3000, 6)))
    heard = Heard()
    diagnosing.diagnose(recording, ROBOT, progress=heard)
    heard.begins_as(diagnosing.SHARES)
    assert heard.told[-1] == (pytest.approx(1.0), "done")


def test_identification_and_a_played_path_go_by_their_shares() -> None:
    heard = Heard()
    whole_model.identify_model(Recording.from_frame(frame()), ROBOT, friction="viscous_coulomb", cascade=False,
                               progress=heard)
    heard.begins_as(whole_model.SHARES)
    played = Heard()
    kind.run(load_scene("iso9283_1"), progress=played)
    begun = {text: fraction for fraction, text in played.told}
    assert begun["report"] == pytest.approx(1.0 - kind.SHARES["report"])
    assert all(a <= b for (a, _), (b, _) in pairwise(played.told))


def test_drawing_the_page_is_no_last_moment() -> None:
    """It takes a third of the time or more, so that the bar has room left for it."""
    for shares in (recordings.SHARES, recordings.SHARES_OF_DIAGNOSIS, recordings.SHARES_WITH_CASCADE):
        assert list(shares)[-1] == "drawing"
        assert shares["drawing"] > 0.25
    assert closing.SHARES["rounds"] > 0.5


# Words that are nearly right, and a tolerance that is missed: the answer says what helps, and whose doing it is.

@pytest.mark.parametrize(("words", "code", "says"), [
    (("run", "strait"), 2, "did you mean 'straight'?"),
    (("run", "line", "--world", "mars"), 2,
     "--world: scenes of kind 'line' play in workshop or bench or cell (got 'mars')"),
    (("run", "iso9283_1", "--world", "workshop"), 2, "--world: scenes of kind 'path' play in bench or cell"),
    pytest.param(("run", "short", "--tolerance", "1um"), 1, "--tolerance 0.001 mm is not kept", marks=pytest.mark.slow),
])
def test_one_line_says_what_helps(program, tmp_path: Path, words: tuple[str, ...], code: int, says: str) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    done = program(*words)
    assert done.code == code
    (line,) = done.lines
    assert says in line
    assert "library" not in line


def test_the_door_of_scenes_lists_what_it_offers() -> None:
    assert set(scenes.__all__) <= set(dir(scenes))
