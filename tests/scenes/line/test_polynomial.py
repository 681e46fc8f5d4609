"""The path of [L] 5 in the whole loop: points, polynomial, one measurement; and who chooses the detector."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.line.cell import prepared
from scenes.line.kind import run
from scenes.line.play import methods
from sim.equipment.equipped_arm import CarriedCamera
from tests.scenes.line.test_line_following import CALIBRATED, short


def test_polynomials_lead_as_well_as_all_their_points() -> None:
    scene = load_scene("gap").changed(world="bench")
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
    scene = load_scene("line").changed(world="bench", calibration=CALIBRATED)
    with prepared(scene) as cell:
        one, four, all_planned = (run(scene.changed(n_d=n_d), shared=cell).control_error.mean
                                  for n_d in (1, 4, None))
        none = run(scene, method="none", shared=cell).control_error.mean
    # Four cycles are 48 ms: delay, low-pass and what the joint controllers lag behind.
    assert all_planned < 0.5 * one < 0.1 * none
    assert four < 1.5 * all_planned


@pytest.mark.parametrize(("width", "gray", "background"), [(6.0, 40, 200), (2.5, 210, 70)])
def test_width_and_polarity_are_found_not_given(width: float, gray: int, background: int) -> None:
    scene = short(line={"width_mm": width, "gray": gray, "background": background})
    with prepared(scene) as cell:
        result = run(scene, shared=cell)
    # Half a pixel is 0.4 mm on the surface.
    assert cell.detection.line_width == pytest.approx(1e-3 * width, abs=4e-4)
    assert cell.detection.dark is (gray < background)
    assert result.failure is None
    assert result.control_error.mean < 2e-4


def test_windows_are_asked_for_at_the_camera_s_own_time() -> None:
    scene = short(camera={"stamp_offset": 0.03})
    asked: list[float] = []
    with prepared(scene) as cell:
        carried = CarriedCamera(cell.camera, cell.camera)  # type: ignore[arg-type]
        carried.request(0.1, 0.2, lambda t: asked.append(t))  # type: ignore[func-returns-value]
        exposed = cell.camera.due(0.1, 0.2)
    assert len(asked) == len(exposed) == 5
    np.testing.assert_allclose(asked, np.array(exposed) + 0.03, atol=5e-4)
