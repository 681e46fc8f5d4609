"""The path of [L] 5 in the whole loop: points, polynomial, one measurement; and who chooses the detector."""

from __future__ import annotations

import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.line.cell import prepared
from scenes.line.kind import run
from scenes.line.play import methods
from tests.scenes.line.test_line_following import CALIBRATED, short


def test_polynomials_lead_as_well_as_all_their_points() -> None:
    scene = load_scene("gap")
    assert scene.measurement == "polynomial"
    with prepared(scene) as cell:
        polynomial = run(scene, method="ideal", shared=cell)
        points = run(scene, method="ideal_points", shared=cell)
        same = run(scene.changed(measurement="points"), method="ideal", shared=cell)
    assert "ideal_points" in methods()
    assert points.method == "ideal_points"
    assert points.control_error.mean == same.control_error.mean != polynomial.control_error.mean
    # Five points tell of bends that two numbers do not; docs/line_following.md has the table.
    assert polynomial.control_error.mean < 1.15 * points.control_error.mean


def test_the_line_is_followed_with_a_detector_of_opencv_alone() -> None:
    result = run(short(camera={"detector": "opencv"}))
    assert result.failure is None
    assert result.control_error.mean < 2e-4
    with pytest.raises(InputError, match="edge_pairs"):
        run(short(camera={"detector": "eyes"}))


def test_the_error_falls_with_the_horizon_until_it_covers_the_arm_s_lag() -> None:
    scene = load_scene("line").changed(calibration=CALIBRATED)
    with prepared(scene) as cell:
        one, four, all_planned = (run(scene.changed(n_d=n_d), shared=cell).control_error.mean
                                  for n_d in (1, 4, None))
        none = run(scene, method="none", shared=cell).control_error.mean
    # Four cycles are 48 ms: delay, low-pass and what the joint controllers lag behind.
    assert all_planned < 0.5 * one < 0.1 * none
    assert four < 1.5 * all_planned
