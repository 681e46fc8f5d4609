"""A camera on the tool or in the cell, found from pictures of a target: known truth, honest covariance, bad input."""

from __future__ import annotations

import cv2
import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from sensing import SensingError
from sensing.camera.camera_model import CameraModel
from sensing.camera.target_hand_eye import CameraPose, TargetView, april_tags, checkerboard, locate_camera

BOARD = np.column_stack([*(axis.ravel() * 0.02 for axis in np.meshgrid(np.arange(8.0), np.arange(5.0))), np.zeros(40)])


def pose_of(rng: np.random.Generator, turn: float, shift: float) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(0.0, turn, 3)), rng.normal(0.0, shift, 3))


def views_of(rng: np.random.Generator, mounted: str, count: int = 12, *, pixel: float = 0.1, shift: float = 0.0,
             turn: float = 0.0) -> tuple[list[TargetView], CameraModel, pin.SE3, pin.SE3]:
    """Pictures of a board from random poses of any tilt, with noise; camera and target as they are."""
    camera = CameraModel.default(1280, 960)
    X = pin.SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-0.2, 0.2, 3))
    Y = pin.SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-0.5, 0.5, 3))
    middle = BOARD.mean(axis=0)
    views: list[TargetView] = []
    while len(views) < count:
        # Target before the camera: 0.3 to 0.5 m away, tilted by up to 35 degrees.
        R = pin.exp3(rng.uniform(-0.6, 0.6, 3))
        T = pin.SE3(R, np.r_[rng.uniform(-0.05, 0.05, 2), rng.uniform(0.3, 0.5)] - R @ middle)
        pixels = camera.project(BOARD @ T.rotation.T + T.translation)
        if not ((pixels > 0.0).all() and (pixels < [1279, 959]).all()):
            continue
        mover = Y * T.inverse() * X.inverse()
        told = mover * pin.SE3(pin.exp3(rng.normal(0.0, turn, 3)), rng.normal(0.0, shift, 3))
        views.append(TargetView(told if mounted == "tool" else told.inverse(), BOARD,
                                pixels + rng.normal(0.0, pixel, pixels.shape)))
    return views, camera, X, Y


def error_of(found: CameraPose, X: pin.SE3) -> Array:
    """Translation [m] and rotation [rad] in the camera's frame ``(6,)``."""
    off = X.actInv(found.camera)
    return np.r_[off.translation, pin.log3(off.rotation)]


@pytest.mark.parametrize("mounted", ["tool", "cell"])
@pytest.mark.parametrize("seed", range(4))
def test_a_camera_anywhere_is_found(mounted: str, seed: int) -> None:
    views, camera, X, Y = views_of(np.random.default_rng(seed), mounted, pixel=0.0)
    found = locate_camera(views, camera, mounted)
    assert np.abs(error_of(found, X)).max() < 1e-5
    assert np.linalg.norm(found.target.translation - Y.translation) < 1e-5
    assert found.used.all()


@pytest.mark.parametrize("mounted", ["tool", pytest.param("cell", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("shift", "turn"), [(0.0, 0.0), pytest.param(3e-4, 3e-4, marks=pytest.mark.slow)])
def test_the_covariance_is_honest(mounted: str, shift: float, turn: float) -> None:
    squares = []
    for seed in range(8):
        views, camera, X, _ = views_of(np.random.default_rng(100 + seed), mounted, 14, pixel=0.15, shift=shift,
                                       turn=turn)
        found = locate_camera(views, camera, mounted)
        e = error_of(found, X)
        squares.append(float(e @ np.linalg.solve(found.covariance, e)))
    # Mean of a chi-square of six over 8: 6 ± 1.2. Of arms without any error a variance above none is found at times,
    # which errs to the safe side; the tails of 14 poses widen it.
    assert 2.5 < float(np.mean(squares)) < 10.5


def test_a_picture_that_contradicts_is_left_out() -> None:
    views, camera, X, _ = views_of(np.random.default_rng(7), "tool", 14, shift=1e-4, turn=1e-4)
    wrong = views[5].pose * pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
    views[5] = TargetView(wrong, views[5].points, views[5].pixels)
    found = locate_camera(views, camera)
    assert not found.used[5]
    assert found.used.sum() >= 12
    assert np.linalg.norm(error_of(found, X)[:3]) < 5e-4


def test_poses_that_turn_about_one_axis_are_refused() -> None:
    rng = np.random.default_rng(3)
    views, camera, *_ = views_of(rng, "tool")
    turned = [TargetView(pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.2 * k])), rng.normal(0.0, 0.1, 3)), BOARD, view.pixels)
              for k, view in enumerate(views)]
    with pytest.raises(SensingError, match="axis"):
        locate_camera(turned, camera)
    with pytest.raises(SensingError, match="needed"):
        locate_camera(views[:3], camera)


def test_a_drawn_checkerboard_is_found_where_it_is() -> None:
    side, columns, rows = 40, 7, 4
    board = np.kron(np.indices((rows + 1, columns + 1)).sum(axis=0) % 2, np.ones((side, side)))
    picture = np.full((400, 520), 230, np.uint8)
    picture[60:60 + board.shape[0], 70:70 + board.shape[1]] = np.where(board > 0, 230, 30).astype(np.uint8)
    found = checkerboard(cv2.GaussianBlur(picture, (0, 0), 1.0), columns, rows, 0.02)
    assert found is not None
    points, pixels = found
    expected = points[:, :2] / 0.02 * side + [70 + side - 0.5, 60 + side - 0.5]
    either = min(np.abs(pixels - expected).max(), np.abs(pixels[::-1] - expected).max())
    assert either < 0.1
    assert checkerboard(np.full((200, 200), 128, np.uint8), columns, rows, 0.02) is None


def test_drawn_april_tags_are_found_where_they_are() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = np.full((400, 600), 255, np.uint8)
    places = {}
    for number, (u, v) in {3: (60, 80), 8: (350, 150)}.items():
        picture[v:v + 160, u:u + 160] = cv2.aruco.generateImageMarker(dictionary, number, 160)
        places[number] = np.array([[u, v, 0], [u + 160, v, 0], [u + 160, v + 160, 0], [u, v + 160, 0]]) * 1e-3
    found = april_tags(picture, places)
    assert found is not None
    points, pixels = found
    assert len(points) == 8
    assert np.abs(pixels - (points[:, :2] * 1e3 - 0.5)).max() < 0.6
    assert april_tags(picture, {5: places[3]}) is None
