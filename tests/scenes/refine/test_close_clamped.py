"""From the clamped flange to the path, without any device on the arm side."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.close_clamped.close_loop import close_loop, stiffness_of
from scenes.close_clamped.scene import CloseClampedScene


def said(joint: int, stiffness: float, width: float) -> SimpleNamespace:
    return SimpleNamespace(joint=joint, stiffness=stiffness, interval=(stiffness - width, stiffness + width))


def test_of_two_methods_the_surer_one_is_taken():
    analysis = SimpleNamespace(joints=(said(1, 90.0, 9.0), said(1, 100.0, 1.0), said(2, 50.0, 5.0)))
    np.testing.assert_array_equal(stiffness_of(analysis, 2), [100.0, 50.0])


def test_joint_that_no_recording_loads_is_named():
    analysis = SimpleNamespace(joints=(said(1, 90.0, 9.0), said(3, 50.0, 5.0)))
    with pytest.raises(InputError, match="loads these joints") as caught:
        stiffness_of(analysis, 3)
    assert caught.value.value == [2]


def test_clamped_arm_has_no_arm_angles_to_measure():
    with pytest.raises(InputError, match="motor"):
        close_loop(load_scene("close_clamped"), measured="arm")


@pytest.mark.slow
def test_path_is_nearly_as_good_as_with_a_tracker():
    scene = load_scene("close_clamped")
    assert isinstance(scene, CloseClampedScene)
    result = close_loop(scene)
    aligned = result.json()["E_car_aligned_mm"]
    assert aligned["after"] <= 1.3 * aligned["tracker"]
    assert aligned["after"] <= 1.1 * aligned["oracle"]
    assert aligned["after"] < 0.1 * aligned["before"]
    # An error of the data sheet's drive gains goes into it in full, and the interval says so.
    low, high = np.array([one.interval for one in sorted(result.analysis.joints, key=lambda one: one.joint)]).T
    assert np.all((low < result.stiffness["oracle"]) & (result.stiffness["oracle"] < high))


@pytest.mark.slow
def test_wrench_at_the_clamp_tells_the_stiffness_without_the_drives() -> None:
    scene = load_scene("close_clamped")
    assert isinstance(scene, CloseClampedScene)
    result = close_loop(scene, measured="tcp")
    np.testing.assert_allclose(result.stiffness["after"], result.stiffness["oracle"], rtol=0.03)
