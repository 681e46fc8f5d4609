"""What a person sees in a terminal: tables that lose nothing, the version, one meaning of an option in every verb."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import get_args, get_type_hints

import pytest
from typer.testing import CliRunner

from scenes.cli import VERBS, _register, app
from scenes.commands.common import show_table
from scenes.progress_bar import progress_bar

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
    said = capsys.readouterr().out
    words = {word for row in ROWS for cell in row if isinstance(cell, str) for word in cell.split()}
    for word in {*words, "12.3", "0.0679", "1.23e+05", "1.5e-09", "depends", "held-out"}:
        assert word in said, (word, said)
    if width is not None:
        assert max(map(len, said.splitlines())) <= width
    else:
        assert "position and velocity of that joint" in said


def test_many_columns_become_blocks_of_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
                                             ) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    show_table("", [f"column{i}" for i in range(12)], [[f"name{i}" for i in range(12)]])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "name0"
    assert lines[-1].strip() == "column11: name11"


def test_version_is_the_packages() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert done.exit_code == 0
    assert re.fullmatch(r"ideal-robot \d+\.\d+\.\d+\S*\n", done.stdout)


def test_completion_can_be_installed() -> None:
    _register()
    assert "--install-completion" in CliRunner().invoke(app, ["--help"]).stdout


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_robot_means_the_same_in_every_verb(verb: str) -> None:
    """A name or a path of an arm; drive data have their own option."""
    command = importlib.import_module(f"scenes.commands.{VERBS[verb]}").command
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
    found = next(line for line in lines if "presliding_4" in line)
    assert all(word in found for word in ("4", "0.000346", "130", "3.77e+07", "rad"))
    assert ("│" in found) == (width == 70)
    assert found.rstrip().endswith("│") == (width == 70)


@pytest.mark.parametrize("width", [40, 60, 120])
def test_the_bar_keeps_its_numbers_whatever_its_text(width: int, monkeypatch: pytest.MonkeyPatch,
                                                     capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in {"COLUMNS": str(width), "TTY_COMPATIBLE": "1", "FORCE_COLOR": "1", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    with progress_bar("line") as move:
        move(0.42, "searching the gain at which direct feedback overshoots, in words for which there is no room")
    said = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)
    line = next(one for one in re.split(r"[\r\n]+", said) if "42 %" in one)
    assert line.startswith("line: s")
    assert re.search(r"42 % \d:\d\d:\d\d ", line)
    assert len(line) <= width
