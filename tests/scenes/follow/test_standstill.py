"""A job of camera or force waits for an arm that is paused, and goes on along its path from where the arm is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.force.contact import most_force
from scenes.scene_file import load_scene
from tests.scenes.follow.eye_on_bench import followed as followed_by_eye
from tests.scenes.follow.on_bench import followed


def largest_acceleration(bench: Any) -> float:
    """Of what is in force at the controller since the pause began, as a share of the arm's limits."""
    first = round(bench.paused[1] / bench.t_ipo) - 1
    q = np.array(bench.in_force[first:])
    return float(np.max(np.abs(np.diff(q, n=2, axis=0)) / bench.t_ipo**2 / bench.robot.a_max))


@pytest.mark.parametrize(("begins", "lasts"), [(1.3, 1.0), pytest.param(1.8, 3.0, marks=pytest.mark.slow),
                                               pytest.param(0.6, 1.0, marks=pytest.mark.slow)])
def test_a_line_goes_on_where_the_arm_was_paused(begins: float, lasts: float, tmp_path: Path) -> None:
    """It ended there, and the rest of the line was left."""
    run = followed_by_eye(load_scene("line"), tmp_path, pause=(begins, lasts))
    assert run.failure is None
    assert np.percentile(run.settled, 95) < 3e-4
    assert largest_acceleration(run.bench) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "begins", "lasts"), [("force_wave", 2.5, 1.0), ("contour", 2.5, 1.0),
                                                      ("contour", 4.5, 2.0)])
def test_a_surface_goes_on_where_the_arm_was_paused(name: str, begins: float, lasts: float, tmp_path: Path) -> None:
    scene = load_scene(name)
    run = followed(scene, tmp_path, pause=(begins, lasts))
    assert run.failure is None
    assert run.force <= most_force(scene.force)
    assert run.job.figures()["force_N"]["rms_error"] < 2.0
    assert largest_acceleration(run.bench) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("begins", [0.15, 0.6])
def test_pressing_begins_once_more_where_the_arm_was_paused(begins: float, tmp_path: Path) -> None:
    """It ended there, and the calibration with it."""
    scene = load_scene("force_wave").changed(line={"length": 0.3})
    run = followed(scene, tmp_path, pause_in=("search", begins, 1.0))
    assert run.failure is None
    assert run.bench.paused[1] < run.bench.arm.t
    assert run.force <= most_force(scene.force)
    assert run.job.contact.elasticity.stiffness == pytest.approx(3963.0, rel=0.02)
    assert largest_acceleration(run.bench) < 1.5


def test_an_arm_that_never_goes_on_is_left_where_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ideal_robot.execution.guard.PATIENCE", 2.0)
    run = followed_by_eye(load_scene("line"), tmp_path, pause=(1.3, np.inf))
    assert "stands still" in str(run.failure)
    in_force, commanded = run.bench.in_force[-1], run.bench.commanded
    assert np.abs(in_force - commanded).max() < np.radians(0.3)
