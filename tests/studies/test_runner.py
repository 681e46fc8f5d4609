"""One runner for all studies."""

from __future__ import annotations

import subprocess
import sys

import pytest

from studies.__main__ import GROUPS, STUDIES, main
from tests.sources import ROOT


def test_every_study_is_listed_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(GROUPS) + len(STUDIES)
    assert all(len(line.split()) > 4 for line in lines if line.startswith("  "))


def test_every_study_can_be_called(capsys: pytest.CaptureFixture[str]) -> None:
    for name in STUDIES:
        with pytest.raises(SystemExit) as ended:
            main([name, "--help"])
        assert ended.value.code == 0
        assert f"python -m studies {name}" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["dance"], ["closings", "none.jsonl", "--count", "0"], ["world", "--moon"]])
def test_what_cannot_be_played_is_said_in_a_line(words: list[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "studies", *words], cwd=ROOT, capture_output=True, text=True,
                          check=False)
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert done.stderr.strip()
