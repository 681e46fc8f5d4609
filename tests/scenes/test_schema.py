"""Keys of scene files: the commented file can be played, the schema accepts what the program accepts."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from scenes.commands.files import new
from scenes.kind import KINDS
from scenes.scene_file import library, load_scene
from scenes.scene_files.shape import STEP, Shape
from scenes.schema import catalogue, commented_scene, json_schema, keys_pages, scene_keys, world_keys
from tests.sources import ROOT

EXAMPLES = {"line": "line", "path": "iso9283_1", "force": "force_wave", "clamped": "clamped_kr500_1"}


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_a_commented_file_is_the_example_and_names_every_key(kind: str, tmp_path: Path) -> None:
    text = commented_scene("mine", kind, (library() / f"{EXAMPLES[kind]}.toml").read_text(encoding="utf-8"))
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    made, shipped = load_scene(path), load_scene(EXAMPLES[kind])
    same = {"name", "title"}
    assert made.model_dump(exclude=same) == shipped.model_dump(exclude=same)
    for key in scene_keys(kind):
        if key.name not in ("name", "kind", "world"):
            assert re.search(rf"^(# )?{key.name} = ", text, flags=re.M) or key.name in text, key


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_every_commented_default_is_accepted(kind: str, tmp_path: Path) -> None:
    """Taking the # away from keys that have a default changes nothing."""
    example = (library() / f"{EXAMPLES[kind]}.toml").read_text(encoding="utf-8")
    lines = commented_scene("mine", kind, example).splitlines()
    end = lines.index("# [world]")
    kept = []
    for line in lines[:end]:
        value = re.match(r"# ([a-z_0-9]+) = (?!…)", line)
        kept.append(line[2:] if value and not line.startswith("# [") else line)
    header = None
    alive = []
    for line in kept:
        if re.match(r"# \[+[a-z_.]+\]+$", line):
            header = line
        elif re.match(r"\[", line):
            header = None
        # A table that is only a comment keeps its keys as comments.
        alive.append(line if header is None or line.startswith("#") or not line else f"# {line}")
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(alive), encoding="utf-8")
    made, shipped = load_scene(path), load_scene(EXAMPLES[kind])
    assert made.model_dump(exclude={"name", "title"}) == shipped.model_dump(exclude={"name", "title"})


def test_the_pages_name_every_kind_and_key() -> None:
    pages = keys_pages()
    docs = ROOT / "docs"
    for name, text in pages.items():
        assert (docs / name).read_text(encoding="utf-8") == text, "python -m scenes.schema docs"
    for kind in KINDS.names():
        assert all(f"| `{key.name}` |" in pages[f"scene_keys/{kind}.md"] for key in scene_keys(kind))
    assert all(key.meaning for key in world_keys() if key.name != "robot"), \
        [key.name for key in world_keys() if not key.meaning]


def test_the_schema_is_one_and_has_the_limits() -> None:
    schema = json_schema("line")
    json.dumps(schema)
    assert schema["properties"]["speed"]["exclusiveMinimum"] == 0
    assert "stamps are wrong" in schema["properties"]["stamp_estimate"]["description"]
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize("what", ["scenes", "robots", "methods", "effects", "detectors", "keys"])
def test_lists_have_a_word_in_every_row(what: str) -> None:
    columns, rows = catalogue(what)
    assert rows
    assert all(len(row) == len(columns) and row[0] is not None for row in rows)


def test_new_writes_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(new)
    assert CliRunner().invoke(app, ["seam"]).exit_code == 0
    assert load_scene("seam").kind == "line"
    for words, message in ((["seam"], "already"), (["../up"], "letters"), (["other", "--kind", "dance"], "expected")):
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, InputError)
        assert message in str(done.exception)
    assert [one.name for one in tmp_path.iterdir()] == ["seam.toml"]


# Shapes of lines: lengths and roundings known in closed form, and clear words for broken ones.

def _length(curve: np.ndarray) -> float:
    return float(np.sum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))


@given(st.floats(0.05, 2.0), st.floats(-1.0, 1.0))
def test_points_are_evenly_spaced_and_start_at_the_origin(length: float, slope: float) -> None:
    curve = Shape(formula=f"{slope}*x + 0.1", length=length).curve()
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert np.allclose(curve[0], 0.0)
    assert np.allclose(steps, steps[0], rtol=1e-6)
    assert abs(steps[0] - STEP) < 0.1 * STEP
    assert _length(curve) == pytest.approx(length * np.hypot(1, slope), rel=1e-9)


def test_rounded_corner_replaces_the_tangents_by_a_quarter_circle() -> None:
    curve = Shape(points=[(0, 0), (0.5, 0), (0.5, 0.4)], corner_radius=0.1).curve()
    assert _length(curve) == pytest.approx(0.9 - 2 * 0.1 + np.pi / 2 * 0.1, abs=1e-4)
    centre = np.array([0.4, 0.1])
    distance = np.linalg.norm(curve - centre, axis=1)
    assert distance.min() == pytest.approx(0.1, abs=1e-4)


def test_svg_is_scaled_to_the_length_asked_for_and_y_points_up() -> None:
    curve = Shape(svg="M 0 0 L 100 0 L 100 -50", svg_length=0.6).curve()
    assert _length(curve) == pytest.approx(0.6, rel=1e-3)
    assert curve[-1] == pytest.approx([0.4, 0.2], abs=1e-3)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"svg": "M 0 0 Q zz"}, "broken SVG path"),
        ({"svg": ""}, "draws nothing"),
        ({"svg": "M 0 0 L 100 0 M 200 0 L 300 0"}, "several parts"),
        ({"svg": "not_there.svg"}, "no such SVG file"),
        ({"formula": "0.1*sinn(x)", "length": 1.0}, "cannot be evaluated"),
        ({"formula": "1/(x-x)", "length": 1.0}, "not finite"),
        ({"points": [(0, 0), (0, 0)]}, "two different points"),
        ({"points": [(0, 0), (0.1, 0), (0.1, 0.1)], "corner_radius": 0.2}, "too close"),
        ({"formula": "0", "length": 0.001}, "shorter than 10 mm"),
    ],
)
def test_broken_shapes_are_told_in_one_clear_line(keys: dict, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        Shape(**keys).curve()
    assert caught.value.field is not None
    assert "\n" not in str(caught.value)
