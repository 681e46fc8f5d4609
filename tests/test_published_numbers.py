"""Published numbers: each names its command, stands on its page as the table says, and a changed one is found."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("published_numbers", ROOT / "docs" / "published_numbers.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


NUMBERS = script()


def test_every_entry_finds_its_numbers_on_its_page_and_names_a_verb() -> None:
    from scenes.cli import VERBS

    found = NUMBERS.published()
    assert len(found) > 150
    printing = {one.command for one in found if one.command.startswith("python ")}
    assert all((ROOT / command.split()[1]).is_file() for command in printing)
    assert {one.command.split()[0] for one in found if one.command not in printing} <= set(VERBS)
    assert {one.page for one in found} >= {"README.md", "docs/ideal_robot.md", "docs/line_following.md",
                                           "docs/contact.md"}
    assert any(one.quick for one in found)


def test_numbers_are_read_out_of_json_by_path() -> None:
    content = {"runs": [{"speed": 0.7, "e": {"mean": 2.0}}, {"speed": 0.7, "e": {"mean": 3.0}},
                        {"speed": 1.0, "e": {"mean": None}}], "a": {"b": [4.0, 5.0]}}
    assert NUMBERS.value_of(content, "a.b.1") == 5.0
    assert NUMBERS.value_of(content, "max(runs[speed=0.7].e.mean)") == 3.0
    assert NUMBERS.value_of(content, "mean(runs[speed=0.7].e.mean)") == 2.5
    with pytest.raises(ValueError, match="2 numbers"):
        NUMBERS.value_of(content, "runs[speed=0.7].e.mean")


def test_numbers_are_read_out_of_what_a_benchmark_prints(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("| arm | mm |\n| --- | --- |\n| `a` | 0.5 / 7 |\n| `b` | 2.0 / 9 |\n")
    (tmp_path / "numbers.toml").write_text("""[[entry]]
page = "page.md"
header = "| arm | mm |"
rows = { "`a`" = "a", "`b`" = "b" }
command = "python -c 'print(\\"a: 0.52 mm, 7 ms\\\\nb: 2.3 mm, 9 ms\\")'"
printed = ['{row}: ([0-9.]+) mm', '{row}: .* ([0-9]+) ms']
""")
    numbers = NUMBERS.published(tmp_path / "numbers.toml", tmp_path)
    assert [(found, word) for _, found, word in NUMBERS.compare(numbers)] == [
        (0.52, "same"), (7.0, "same"), (2.3, "DIFFERS"), (9.0, "same")]
    with pytest.raises(ValueError, match="nothing printed"):
        NUMBERS.value_of({"printed": "words"}, "~c: ([0-9]+)")


def test_a_number_that_changed_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                       capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "page.md").write_text("| what | mm |\n| --- | --- |\n| `a` | 0.50 / 7 |\n| `b` | 2.0 / 9 |\n")
    (tmp_path / "numbers.toml").write_text("""[[entry]]
page = "page.md"
header = "| what | mm |"
rows = { "`a`" = "a", "`b`" = "b" }
command = "run it"
values = ["{row}.first", "{row}.second"]
""")
    numbers = NUMBERS.published(tmp_path / "numbers.toml", tmp_path)
    assert [one.text for one in numbers] == ["0.50", "7", "2.0", "9"]
    made = {"a": {"first": 0.504, "second": 7.2}, "b": {"first": 2.3, "second": None}}
    monkeypatch.setattr(NUMBERS, "made", lambda command, folder: made)
    assert [word for *_, word in NUMBERS.compare(numbers)] == ["same", "same", "DIFFERS", "DIFFERS"]
    monkeypatch.setattr(NUMBERS, "published", lambda: numbers)
    assert NUMBERS.main([]) == 1
    assert "4 numbers, 2 differ" in capsys.readouterr().out


def test_a_table_without_the_row_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("| what | mm |\n| --- | --- |\n| `a` | 0.50 |\n")
    entry = {"page": "page.md", "header": "| what | mm |", "rows": {"`c`": "c"}, "command": "run it", "values": ["x"]}
    with pytest.raises(ValueError, match="no row '`c`'"):
        list(NUMBERS._numbers(entry, tmp_path))


def test_a_quick_number_is_made_anew() -> None:
    """One command from the table, run as `make docs-figures` runs it: the paths lead to these figures, in this unit."""
    numbers = [one for one in NUMBERS.published() if one.command == "run contour"]
    assert len(numbers) == 3
    for one, found, _ in NUMBERS.compare(numbers):
        assert found == pytest.approx(one.number, rel=0.3), one.what
