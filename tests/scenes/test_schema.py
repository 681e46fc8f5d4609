"""Keys of scene files: the commented file can be played, the schema accepts what the program accepts."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from scenes.catalogue import catalogue
from scenes.commands.new import command as new
from scenes.kind import KINDS
from scenes.scene_file import library, load_scene
from scenes.schema import commented_scene, json_schema, keys_page, scene_keys, world_keys

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


def test_the_page_names_every_kind_and_key() -> None:
    page = keys_page()
    written = Path(__file__).resolve().parents[2] / "docs" / "scene_keys.md"
    assert written.read_text(encoding="utf-8") == page, "python -m scenes.schema > docs/scene_keys.md"
    for kind in KINDS.names():
        assert f"## {kind}" in page
        for key in scene_keys(kind):
            assert f"| `{key.name}` |" in page
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
