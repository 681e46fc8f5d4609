"""Tables that studies write into the pages."""

from __future__ import annotations

from pathlib import Path

import pytest

from ideal_robot.errors import InputError
from studies import report
from studies.faults import device_faults
from studies.report import marked_page, write_tables


@pytest.mark.parametrize("mark", ["stranger trials", "faults of force_wave"])
def test_a_table_that_is_written_has_its_place_on_a_page(mark: str) -> None:
    """The marks of a table were on no page, which was said when hours of plays had ended."""
    assert f"<!-- end of {mark} -->" in marked_page(mark).read_text(encoding="utf-8")


def test_a_table_without_a_place_is_refused_before_anything_is_played() -> None:
    with pytest.raises(InputError, match="no page has"):
        device_faults("camera", write=True)


def test_a_table_is_put_between_its_marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- a -->\nold\n<!-- end of a -->\nafter\n")
    monkeypatch.setattr(report, "DOCS", tmp_path)
    write_tables("a", "new")
    assert page.read_text() == "before\n<!-- a -->\nnew\n<!-- end of a -->\nafter\n"
