"""``ideal-robot export`` writes what its options say, and nothing for names that cannot be."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from scenes.commands.export import command as export_command
from scenes.export.rerun_file import write_rerun

exporting = typer.Typer()
exporting.command()(export_command)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    t = 0.012 * np.arange(40.0)
    q = np.random.default_rng(0).normal(size=(40, 3))
    return Recording.from_arrays(t, q=q, tau=q, x=t, y=t, z=t).write(tmp_path / "in.parquet")


def test_several_formats_at_once(recording: Path, tmp_path: Path) -> None:
    words = ["--csv", str(tmp_path / "o.csv"), "--mcap", str(tmp_path / "o.mcap"), "--rosbag2", str(tmp_path / "bag")]
    done = CliRunner().invoke(exporting, [str(recording), *words])
    assert done.exit_code == 0, done.output
    expected = Recording.read(recording).joints("q")
    for name in ("o.csv", "o.mcap", "bag"):
        np.testing.assert_allclose(Recording.read(tmp_path / name).joints("q"), expected, atol=1e-12)


@pytest.mark.parametrize("words", [[], ["--csv", "o.txt"], ["--rerun", "o.txt"], ["--mcap", "o.bag"],
                                   ["--csv", "o.csv", "--rosbag2", "o", "--rerun", "o.txt"]])
def test_no_format_or_another_ending_is_refused(words: list[str], recording: Path, tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(exporting, [str(recording), *words])
    assert isinstance(done.exception, InputError)
    assert [one.name for one in tmp_path.iterdir()] == ["in.parquet"]


def test_without_the_extra_of_one_format_none_is_written(recording: Path, tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    words = ["--mcap", str(tmp_path / "o.mcap"), "--csv", str(tmp_path / "o.csv"), "--rerun", str(tmp_path / "o.rrd")]
    done = CliRunner().invoke(exporting, [str(recording), *words])
    assert isinstance(done.exception, InputError)
    assert [one.name for one in tmp_path.iterdir()] == ["in.parquet"]


def test_rerun_reads_its_file_back(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the optional package rerun-sdk")
    path = write_rerun(Recording.read(recording), tmp_path / "o.rrd")
    tool = [sys.executable, "-m", "rerun_cli", "rrd"]
    checked = subprocess.run([*tool, "verify", str(path)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    printed = subprocess.run([*tool, "print", "-v", str(path)], capture_output=True, text=True, check=True).stdout
    for entity in ("/q/1", "/tau/3", "/tool/path", "/tool/now"):
        assert entity in printed
