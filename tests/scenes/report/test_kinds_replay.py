"""Replays of paths and of methods side by side, and the film of ``run --video``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from scenes.cli import _register, app
from scenes.path.page import run_page
from scenes.path.replay import path_replay
from scenes.play import run_scene
from scenes.scene_file import load_scene


def test_a_paths_replay_shows_the_errors_of_its_table() -> None:
    scene = load_scene("iso9283_1")
    ideal, none = (run_scene(scene, method=method) for method in ("ideal", "none"))
    replay = path_replay(ideal, none)
    assert replay is not None
    assert np.sqrt(np.nanmean(replay.error**2)) == pytest.approx(1e3 * ideal.errors.time_matched.E_car, rel=0.02)
    assert replay.ghost is not None
    # The ghost is the arm without correction: late by its delay, so further away.
    assert np.max(np.abs(replay.ghost - replay.q)) > 1e-3
    kinds = [block["kind"] for block in run_page(ideal)._blocks]
    assert kinds.index("replay") < kinds.index("table")


def test_a_film_of_another_format_is_refused_before_the_run(tmp_path: Path) -> None:
    _register()
    done = CliRunner().invoke(app, ["run", "line", "--out", str(tmp_path / "o"), "--video", str(tmp_path / "x.avi")])
    assert done.exit_code != 0
    assert ".mp4 or .gif" in str(done.exception)
    assert not (tmp_path / "o").exists()
