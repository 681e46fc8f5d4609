"""The tutorial, typed as printed: on the shipped arm and on arms of one's own, with robot data and without."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
UR10E = ROOT.parent / "shared" / "data" / "ur10e" / "ur10e.urdf"
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
