"""Five commands make arms ideal that others simulate: as a user types them, to what was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.five_commands import ARMS, chain, command, identified, left, write_path
from studies.other_arms import crx


@pytest.mark.slow
@pytest.mark.parametrize(("name", "package", "most"), [("crx", "airo_fanuc", 0.8), ("rsi", "ideal_robot", 0.3)])
def test_five_commands_leave_what_was_asked_for(name: str, package: str, most: float, tmp_path: Path) -> None:
    pytest.importorskip(package)
    done = chain(ARMS[name], tmp_path, "path", seed=2, period=20.0)
    assert done["before"]["joints"] > 5.0
    assert done["after"]["joints"] < most
    # What precorrect expects is what is left, within a factor of two.
    assert 0.5 < done["after"]["joints"] / done["expected"] < 2.0


@pytest.mark.slow
def test_adaptation_follows_a_lag_that_drifts(tmp_path: Path) -> None:
    """Half a minute, in which the lag goes by a quarter of what was measured in the emulator's makers' arm."""
    pytest.importorskip("airo_fanuc")
    identified(ARMS["crx"], tmp_path, 20.0)
    robot = str(tmp_path / "crx10ial.urdf")
    write_path(tmp_path / "path.csv", robot, 3, 30.0)
    errors = {}
    for method in ("ideal", "adapted"):
        with crx(tmp_path, slowed=0.0, lag=(0.11, 0.134), drifts=30.0) as (address, _):
            command(tmp_path, "play", "path.csv", "--robot", robot, "--arm", address, "--method", method, "--model",
                    "model.json", "-o", f"{method}.parquet")
        errors[method] = left(tmp_path / f"{method}.parquet")
    assert errors["adapted"] < 2.0 < errors["ideal"]
