"""The slow tests in parts: each is in exactly one, and the Makefile goes through all of them."""

from __future__ import annotations

import re
from pathlib import Path

from tests.conftest import in_part

ROOT = Path(__file__).resolve().parents[1]


def test_every_test_is_in_one_part() -> None:
    names = [f"tests/test_{i}.py::test" for i in range(500)]
    found = [[part for part in range(20) if in_part(name, part, 20)] for name in names]
    assert all(len(one) == 1 for one in found)
    assert {one[0] for one in found} == set(range(20))
    assert in_part(names[0], found[0][0] + 20, 20)


def test_continuous_integration_runs_both_targets_and_the_part_changes_with_the_commit() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert re.findall(r"^make ([\w-]+)", script, flags=re.MULTILINE) == ["test", "test-part"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^test-part:.*\n(?:\t.*\n)*\t.*--part \$\$\(git rev-list --count HEAD", makefile,
                     flags=re.MULTILINE)
