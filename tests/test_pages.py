"""Pages and notebooks: each notebook runs from the first cell to the last, and its exercise knows right from wrong."""

from __future__ import annotations

import ast
import doctest
import importlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from docs import published_numbers
from tests.sources import DATA, ROOT

PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes")
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))

ANSWERS = {
    "controller": ("min(np.geomspace(0.001, 3.0, 300), key=with_gain)", "0.001"),
    "force": ("1 - 1 / 1.6", "0.6"),
    "friction": ("friction_at('kr15', 3, 0.25, ARMS['kr15'][1].replace(start_temperature=22.0))"
                 " / friction_at('kr15', 3, 0.25)", "1.0"),
    "identification": ("float(unseen_errors.iloc[1])", "float(unseen_errors.iloc[0])"),
    "latency": ("2.8", "4"),
    "learning": ("next((n for n, key in enumerate(METHODS[-4:], 1) if circle.runs[key].errors.time_matched.E_car"
                 " < circle.runs['precorrected-printed'].errors.time_matched.E_car), 0)", "5"),
    "line_following": ("0.7 * 1000 * scene.camera.latency", "0.7"),
    "precorrection": ("min(np.arange(0.0, 40.5, 0.5), key=off_by)", "0.0"),
    "residual_to_effect": ("100 * (before - error) / before", "100 * (before - error) / error"),
    "stiffness": ("100 * (both.loc[1, 'wrench'] - both.loc[1, 'motor']) / both.loc[1, 'motor']",
                  "100 * (both.loc[1, 'motor'] - both.loc[1, 'wrench']) / both.loc[1, 'wrench']"),
}
"""A right and a wrong answer to the exercise of each notebook, of what its cells have made."""
SHOWN = {
    "controller": ["left['(16)'] < 0.6 * left['(15)']"],
    "force": ["runs['ideal'].figures.rms < 0.5 * runs['direct_feedback'].figures.rms"],
    "friction": ["all(max(errors[name, 'arctan'], errors[name, 'cube_root']) < errors[name, 'viscous_coulomb'] "
                 "for name in CASES)",
                 # Of the simulated KR 15 the main axes alone are degressive at the lowest speed.
                 "all(curve > line for (name, joint), (curve, line) in middle.items() "
                 "if name == 'manutec_r15' or joint < 3)",
                 "friction[after_break[0] - 1] < 0.95 * friction[0]",
                 "all(friction[k] > 1.02 * friction[k - 1] for k in after_break)",
                 "low.argmin() not in (0, len(low) - 1)"],
    "identification": ["unseen_errors.max() < 30"],
    "latency": ["max(late.values()) < 2 * min(late.values())", "wrong[4.0] > 2 * wrong[0.0]"],
    "learning": ["all(less['circle'][key] > value for key, value in paper['circle'].items())"],
    "line_following": ["all(table[table.method == 'ideal']['mean [mm]'].to_numpy() "
                       "< table[table.method == 'sensor_path']['mean [mm]'].to_numpy())"],
    "precorrection": ["less['ideal'] > less['precorrected'] > 50",
                      "alone['ideal'] < alone['precorrected'] < 0.5 * alone['none']"],
    "residual_to_effect": ["found.effects[0].fitted.name == 'asymmetric_friction'", "error < before",
                           "held_out.rms_after < 0.8 * held_out.rms_before"],
    "stiffness": ["(table['error against the truth [%]'].abs() < 12).all()"],
}
"""What each notebook shows, of what its cells have made."""


def read(path: Path) -> list[dict[str, str]]:
    """Kind and source of each cell; a notebook's own library takes longer to load than these tests."""
    return [{**cell, "source": "".join(cell["source"])} for cell in json.loads(path.read_text("utf-8"))["cells"]]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_question_slider_exercise_and_what_the_paper_shows(path: Path) -> None:
    cells = read(path)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
    # The answer stands elsewhere, and what a test would ask does not stand among the steps.
    assert not any("assert " in cell["source"] or "def check" in cell["source"] for cell in cells)
    assert re.match(r"# .*\n\n\*\*.*\?\*\*\n", cells[0]["source"])
    parts = [cell["source"].partition("\n")[0] for cell in cells if cell["source"].startswith("## ")]
    assert parts[-2:] == ["## Exercise", "## Beside the paper"]
    assert any("ipywidgets.interactive(" in cell["source"] for cell in cells if cell["cell_type"] == "code")
    assert path.stem in ANSWERS


def test_the_course_has_eight_lessons_with_a_notebook_each() -> None:
    text = (ROOT / "docs" / "course.md").read_text(encoding="utf-8")
    lessons = text.split("\n## ")[1:9]
    assert [lesson[:2] for lesson in lessons] == [f"{k}." for k in range(1, 9)]
    for lesson in lessons:
        assert all(word in lesson for word in ("**Goal:**", "**Notebook:**", "**Exercise:**", "**Scene to play:**"))
    assert {path.name for path in NOTEBOOKS} <= set(re.findall(r"notebooks/(\w+\.ipynb)", text))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_a_notebook_imports_exists(path: Path) -> None:
    """Also what it takes of the program by name: a figure that was renamed ended a lesson unnoticed."""
    for cell in read(path):
        if cell["cell_type"] != "code":
            continue
        for node in ast.walk(ast.parse(re.sub(r"(?m)^%.*", "", cell["source"]))):
            if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] in PACKAGES:
                module = importlib.import_module(str(node.module))
                assert [name.name for name in node.names if not hasattr(module, name.name)] == []


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_knows_right_from_wrong(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from docs import execute_notebooks

    # Whether the measured recordings are there or not.
    monkeypatch.setenv("IDEAL_ROBOT_DATA", str(DATA))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("MPLBACKEND", "agg")
    right, wrong = ANSWERS[path.stem]
    asked = [f"check({right})", f"not check({wrong})", "not check(None)", *SHOWN[path.stem]]
    added = "\n".join(f"assert {one}" for one in asked)
    execute_notebooks.played(path, added)


# The tutorial, typed as printed: on the shipped arm and on arms of one's own, with robot data and without.

PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
UR10E = DATA / "ur10e" / "ur10e.urdf"
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.S) for line in block.splitlines() if line]


def test_the_page_leads_from_a_recording_to_a_corrected_path() -> None:
    verbs = [shlex.split(line)[1] for line in COMMANDS]
    assert verbs == ["plan-identification", "plan-identification", "identify", "diagnose", "precorrect", "view"]
    assert all(line.startswith("ideal-robot ") and "--robot kr6" in line for line in COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["kr6", "own_robot", "ur10e"])
def test_every_command_works_as_printed(arm: str, tmp_path: Path) -> None:
    robot = "kr6"
    if arm == "own_robot":
        for name in ("own_robot.urdf", "own_robot.toml"):
            shutil.copy(ROOT / "examples" / name, tmp_path)
        robot = "own_robot.urdf"
    if arm == "ur10e":
        if not UR10E.is_file():
            pytest.skip("needs the public data sets beside the repository")
        robot = str(UR10E)
    for line in COMMANDS:
        words = [robot if word == "kr6" else word for word in shlex.split(line)[1:]]
        # A viewer waits for the user otherwise; figures are read from the file that every verb writes on request.
        words += ["--once"] if words[0] == "view" else ["--json", f"{words[0]}.json"]
        done = subprocess.run([sys.executable, "-m", "scenes.cli", *words], cwd=tmp_path, capture_output=True,
                              text=True, check=False, env={**os.environ, "PYTHONPATH": str(ROOT)})
        assert done.returncode == 0, f"{line}\n{done.stdout[-1500:]}\n{done.stderr[-3000:]}"
    figures = json.loads((tmp_path / "precorrect.json").read_text(encoding="utf-8"))["played_rms_error_mrad"]
    assert (tmp_path / "out" / "corrected.parquet").is_file()
    # Seen on the simulated arm, which is not the model.
    for before, after in zip(figures["uncorrected"], figures["corrected"], strict=True):
        assert after < 0.1 * before
    if arm == "kr6":
        assert_table_of_diagnosis(json.loads((tmp_path / "diagnose.json").read_text(encoding="utf-8")))


def assert_table_of_diagnosis(made: dict[str, Any]) -> None:
    """The tutorial's table of what was found is what its command finds: names, and errors to two per cent."""
    named = {effect["joint"]: effect["effect"].replace("_", " ") for effect in made["effects"]}
    named |= {finding["joint"]: "`unknown`" for finding in made["unknown"]}
    errors = {channel["channel"]: channel for channel in made["channels"]}
    rows = re.findall(r"^\| (\d) \| ([^|:]+)[^|]*" + 3 * r"\| ([\d.]+) N m " + r"\|$", PAGE, flags=re.MULTILINE)
    assert {int(joint): name.strip() for joint, name, *_ in rows} == named
    for joint, _, *printed in rows:
        figures = [errors[f"tau_{joint}"][key] for key in ("rms_before", "rms_after", "noise_floor")]
        assert [float(text) for text in printed] == pytest.approx(figures, rel=0.02, abs=0.005)


# The documentation site is built without a warning, and holds tutorial, scene keys and API.

@pytest.mark.slow
@pytest.mark.parametrize("rooms", [{"SITE_ROOMS": "ideal_robot.friction"}, {}], ids=["one room's API", "whole"])
def test_the_site_is_built_without_warnings(rooms: dict[str, str], tmp_path: Path) -> None:
    # The command of ``make docs``, which has no path to the root but the one that it gives itself.
    recipe = re.search(r"^docs:.*\n\t(\w+)=1 \$\(BIN\)/(.+)$", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    assert recipe is not None
    program, *words = recipe[2].split()
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([Path(sys.executable).parent / program, *words, "-d", str(tmp_path / "site")], cwd=ROOT,
                          capture_output=True, text=True, check=False, env={**inherited, **rooms, recipe[1]: "1"})
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    pages = {str(path.relative_to(tmp_path / "site")) for path in (tmp_path / "site").rglob("index.html")}
    assert {"index.html", "tutorial/index.html", "scene_keys/index.html", "howto/index.html"} <= pages
    assert {f"notebooks/{path.stem}/index.html" for path in NOTEBOOKS} <= pages
    api = tmp_path / "site" / "api"
    modules = (api / "modules" / "ideal_robot.friction" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'id="ideal_robot\.friction\.laws\.Arctan"', modules)
    # What a user needs stands on one page; what only the program needs does not.
    door = (api / "index.html").read_text(encoding="utf-8")
    assert all(re.search(rf'id="[\w.]+\.{name}"', door) for name in ("Robot.load", "precorrect", "run_scene"))
    assert "MAX_BYTES" not in door + modules
    # Nothing is fetched from elsewhere when a page is read.
    first = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="https?://', first)


# Examples in docstrings say what the program does.

MODULES = [".".join(path.relative_to(ROOT).with_suffix("").parts) for package in PACKAGES
           for path in sorted((ROOT / package).rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_hold(name: str) -> None:
    module = importlib.import_module(name)
    written = len(re.findall(r"^\s*>>> ", Path(str(module.__file__)).read_text(encoding="utf-8"), flags=re.MULTILINE))
    done = doctest.testmod(module)
    assert done.failed == 0
    # An example that is not found, behind a decorator say, would never be run.
    assert done.attempted == written


def test_each_package_that_users_import_has_examples() -> None:
    assert {name.partition(".")[0] for name in MODULES} >= {"ideal_robot", "sensing", "sim", "scenes"}
    assert len(MODULES) >= 10


# Published numbers: each names its command, stands on its page as the table says, and a changed one is found.

def test_every_entry_finds_its_numbers_on_its_page_and_names_a_verb() -> None:
    from scenes.cli import VERBS
    from studies.__main__ import STUDIES

    numbers = published_numbers.published()
    assert len(numbers) > 150
    printing = {number.command for number in numbers if number.command.startswith("python ")}
    assert all(command.startswith("python -m studies ") for command in printing)
    assert {command.split()[3] for command in printing} <= set(STUDIES)
    assert {number.command.split()[0] for number in numbers if number.command not in printing} <= set(VERBS)
    assert {number.page for number in numbers} >= {"README.md", "docs/ideal_robot.md", "docs/line_following.md",
                                                   "docs/contact.md"}
    assert any(number.quick for number in numbers)


def test_numbers_are_read_out_of_json_by_path() -> None:
    content = {"runs": [{"speed": 0.7, "e": {"mean": 2.0}}, {"speed": 0.7, "e": {"mean": 3.0}},
                        {"speed": 1.0, "e": {"mean": None}}], "a": {"b": [4.0, 5.0]}}
    assert published_numbers.value_of(content, "a.b.1") == 5.0
    assert published_numbers.value_of(content, "max(runs[speed=0.7].e.mean)") == 3.0
    assert published_numbers.value_of(content, "mean(runs[speed=0.7].e.mean)") == 2.5
    with pytest.raises(ValueError, match="2 numbers"):
        published_numbers.value_of(content, "runs[speed=0.7].e.mean")


def numbers_of(folder: Path, page: str, entry: str) -> list[published_numbers.Published]:
    """Numbers of a page that an entry names."""
    (folder / "page.md").write_text(page)
    (folder / "numbers.toml").write_text(f'[[entry]]\npage = "page.md"\n{entry}')
    return published_numbers.published(folder / "numbers.toml", folder)


def test_a_study_prints_the_table_of_its_page(tmp_path: Path) -> None:
    table = "| arm | mm | far |\n| --- | --- | --- |\n| a | 0.5 | 7 (9) |\n| b | 2.0 | |\n| b | −3.0 | 4 |\n"
    numbers = numbers_of(tmp_path, table, 'header = "| arm | mm"\nfirst = true\ncommand = "python -m studies it"\n')
    assert [cell.text for cell in numbers] == ["0.5", "7", "2.0", "−3.0", "4"]
    printed = {"printed": table.replace("| 2.0 |", "| 2.5 |").replace("| 4 |", "| |")}
    values = [published_numbers.value_of(printed, cell.value) for cell in numbers]
    assert [cell.holds(value) for cell, value in zip(numbers, values, strict=True)] == [True, True, False, True, False]


def test_numbers_are_read_out_of_what_a_study_prints(tmp_path: Path) -> None:
    numbers = numbers_of(tmp_path, "| arm | mm |\n| --- | --- |\n| `a` | 0.5 / 7 |\n| `b` | 2.0 / 9 |\n", """
header = "| arm | mm |"
rows = { "`a`" = "a", "`b`" = "b" }
command = "python -c 'print(\\"a: 0.52 mm, 7 ms\\\\nb: 2.3 mm, 9 ms\\")'"
printed = ['{row}: ([0-9.]+) mm', '{row}: .* ([0-9]+) ms']
""")
    assert [(value, word) for _, value, word in published_numbers.compare(numbers)] == [
        (0.52, "same"), (7.0, "same"), (2.3, "DIFFERS"), (9.0, "same")]
    with pytest.raises(ValueError, match="nothing printed"):
        published_numbers.value_of({"printed": "words"}, "~c: ([0-9]+)")


def test_a_number_that_changed_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                       capsys: pytest.CaptureFixture[str]) -> None:
    numbers = numbers_of(tmp_path, "| what | mm |\n| --- | --- |\n| `a` | 0.50 / 7 |\n| `b` | 2.0 / 9 |\n", """
header = "| what | mm |"
rows = { "`a`" = "a", "`b`" = "b" }
command = "run it"
values = ["{row}.first", "{row}.second"]
""")
    assert [number.text for number in numbers] == ["0.50", "7", "2.0", "9"]
    figures = {"a": {"first": 0.504, "second": 7.2}, "b": {"first": 2.3, "second": None}}
    monkeypatch.setattr(published_numbers, "made", lambda command, folder: figures)
    assert [word for *_, word in published_numbers.compare(numbers)] == ["same", "same", "DIFFERS", "DIFFERS"]
    monkeypatch.setattr(published_numbers, "published", lambda: numbers)
    assert published_numbers.main([]) == 1
    assert "4 numbers, 2 differ" in capsys.readouterr().out


def test_a_table_without_the_row_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("| what | mm |\n| --- | --- |\n| `a` | 0.50 |\n")
    entry = {"page": "page.md", "header": "| what | mm |", "rows": {"`c`": "c"}, "command": "run it", "values": ["x"]}
    with pytest.raises(ValueError, match="no row '`c`'"):
        list(published_numbers._numbers(entry, tmp_path))


@pytest.mark.slow
def test_a_quick_number_is_made_anew() -> None:
    """One command from the table, run as `make docs-figures` runs it: the paths lead to these figures, in this unit."""
    numbers = [number for number in published_numbers.published() if number.command == "run contour"]
    assert len(numbers) == 3
    for number, value, _ in published_numbers.compare(numbers):
        assert value == pytest.approx(number.number, rel=0.3), number.what
