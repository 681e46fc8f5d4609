"""Files of others are read, never run: formulas, names, SVG files and terminal markup that try more are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.commands.common import progress_bar, show_table
from scenes.scene_files.shape import FUNCTIONS, Shape, evaluated

SCENE = """
kind = "line"
title = "short"
[surface]
origin = [0.98, -0.6, 0.35]
[line]
"""

ATTACKS = (
    "f'{open(\"OPENED\", \"w\")}'", "__import__('os').system('touch OPENED')", "x.dtype", "(1).__class__", "eval(x)",
    "[y for y in (1, 2)]", "(lambda: 0)()", "(x := 3)", "sin(x=3)", "sin(*x)", "sin(x, x)", "where(x)", "x[0]",
    "x if x else x", "9**9**9", "1<<99999999999", "x*" + "9" * 400, "(" * 240 + "x" + ")" * 240, "-" * 490 + "x",
    "+".join(["x"] * 50_000), "ｓｉｎ(x)", "x\nimport os", "x\0", "2j*x", "(-1)**0.5*x", "True*x", "...", "",
    "0 < x < 1", "sin", "1e999*x", "1/0")
"""What is more than arithmetic, or has no value."""


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_formula_that_tries_more_than_arithmetic_is_refused(attack: str) -> None:
    with pytest.raises(InputError) as refused:
        evaluated(attack, np.linspace(0.0, 1.0, 7))
    assert refused.value.field == "line.formula"
    assert len(str(refused.value)) < 600


@given(st.text(alphabet="x0123456789.eipsnco()[]{}+-*/%<>=,:_'\" ", max_size=60))
def test_a_formula_is_numbers_or_refused(formula: str) -> None:
    x = np.linspace(0.0, 1.0, 7)
    try:
        y = evaluated(formula, x)
    except InputError:
        return
    assert y.shape == x.shape
    assert np.isfinite(y).all()


@given(st.recursive(
    st.sampled_from(["x", "pi", "e"]) | st.floats(-9, 9).map(lambda v: f"({v!r})"),
    lambda inner: st.tuples(inner, st.sampled_from(["+", "-", "*", "/"]), inner).map(lambda p: f"({p[0]}{p[1]}{p[2]})")
    | inner.map(lambda f: f"sin({f})") | inner.map(lambda f: f"-{f}"), max_leaves=12))
def test_arithmetic_means_what_it_means_in_numpy(formula: str) -> None:
    x = np.linspace(0.0, 1.0, 7)
    with np.errstate(all="ignore"):
        names = {"x": x, "pi": np.pi, "e": np.e, "sin": np.sin, "__builtins__": {}}
        try:
            truth = np.broadcast_to(np.asarray(eval(formula, names), dtype=float), x.shape)
        except ZeroDivisionError:
            truth = np.full_like(x, np.inf)
    if np.all(np.isfinite(truth)):
        assert np.allclose(evaluated(formula, x), truth, rtol=1e-9, atol=1e-12)
    else:
        with pytest.raises(InputError, match="not finite"):
            evaluated(formula, x)


def test_every_function_of_the_list_can_be_called() -> None:
    x = np.linspace(0.1, 0.9, 5)
    for name, function in FUNCTIONS.items():
        if name == "arccosh":
            continue
        count = getattr(function, "nin", 3)
        assert np.array_equal(evaluated(f"{name}({', '.join(['x'] * count)})", x), function(*[x] * count))
    assert np.array_equal(evaluated("where(x < 0.5, 0, 0.1)", x), np.where(x < 0.5, 0.0, 0.1))


@pytest.mark.parametrize("name", ["../elsewhere", "/etc/cron.d/job", "a/b", "a\\\\b", "..", ".hidden", "[/red]", "<b>",
                                  "a\\u001b[31m", "a\\nb", "", "x" * 90, "a\\u202eb", " a", "a "])
def test_a_scene_cannot_name_a_folder_elsewhere_nor_write_to_the_terminal(name: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(f'name = "{name}"\n{SCENE}points = [[0.0, 0.0], [0.4, 0.0]]\n', encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_scene(file)
    assert refused.value.field == "name"


@pytest.mark.parametrize("kind", ["[1]", "{a = 1}", "3", "true", '"lines"', "1979-05-27"])
def test_a_kind_that_is_not_one_is_refused(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(SCENE.replace('kind = "line"', f"kind = {kind}"), encoding="utf-8")
    with pytest.raises(InputError, match="expected one of line"):
        load_scene(file)


@pytest.mark.parametrize("change", ["speed = nan", "speed = inf", "seed = " + "9" * 30, "world = " + "[" * 5000,
                                    "x = " + "{a=" * 5000, "a." * 5000 + "b = 1"])
def test_numbers_that_are_none_and_endless_nesting_are_refused(change: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    changed = SCENE.replace('title = "short"', f'title = "short"\n{change}')
    file.write_text(changed + "points = [[0.0, 0.0], [0.4, 0.0]]\n", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_scene(file)
    assert refused.value.file == file


SVG = '<svg xmlns="http://www.w3.org/2000/svg">{}<path d="{}"/></svg>'


def test_the_svg_file_beside_the_scene_is_taken_wherever_the_program_runs(tmp_path: Path) -> None:
    (tmp_path / "wave.svg").write_text(SVG.format("", "M 0 0 L 300 0"))
    assert Shape(svg="wave.svg").curve(tmp_path)[-1] == pytest.approx([0.3, 0.0])
    (tmp_path / "scene.toml").write_text(SCENE + 'svg = "wave.svg"\n')
    assert load_scene(tmp_path / "scene.toml").folder == tmp_path


@pytest.mark.parametrize("name", ["../outside.svg", "/etc/passwd.svg", "link.svg", "a\0.svg", "x" * 5000 + ".svg"])
def test_no_svg_file_outside_the_scenes_folder_is_read(name: str, tmp_path: Path) -> None:
    (tmp_path / "outside.svg").write_text(SVG.format("", "M 0 0 L 300 0"))
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link.svg").symlink_to(tmp_path / "outside.svg")
    with pytest.raises(InputError):
        Shape(svg=name).curve(inner)


@pytest.mark.parametrize("text", [
    '<!DOCTYPE s [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + SVG.format("&a;", "M 0 0 L 300 0"),
    '<!DOCTYPE s [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]>' + SVG.format("", "&b;"),
    "<svg>" * 100_000, "", "\0", "<svg", "<svg/>", SVG.format("", "M 0 0 L 1e300 0"), SVG.format("", "M 0 0 L 1e9 0"),
    SVG.format("", "M 0 0 A 0 0 0 0 0 0 0"), SVG.format("", "L L L"), SVG.format("", "M 0 0" + " L 1 1 L 0 0" * 9000),
])
def test_svg_files_that_do_more_than_draw_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.svg").write_text(text)
    with pytest.raises(InputError) as refused:
        Shape(svg="a.svg").curve(tmp_path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("keys", [
    {"points": [(0.0, 0.0), (1e9, 0.0)]}, {"formula": "1e6*x", "length": 1.0}, {"svg": "M 0 0 L 1e12 0"},
])
def test_a_line_of_kilometres_is_refused_before_memory_is_filled(keys: dict) -> None:
    with pytest.raises(InputError, match="longer than"):
        Shape(**keys).curve()


def test_what_a_terminal_would_obey_is_spelt_out(capsys: pytest.CaptureFixture[str]) -> None:
    show_table("[/title]", ["[red]a[/red]"], [["[/cell]\x1b[31m\x07"]])
    out = capsys.readouterr().out
    assert "[/title]" in out
    assert "[red]a[/red]" in out
    assert "[/cell]\\x1b[31m\\x07" in out
    with progress_bar("[/bar]") as move:
        move(0.5, "[/text]")
