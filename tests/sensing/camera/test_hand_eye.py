"""Calibration of the camera from the line itself: recovers a known wrong camera, and says how sure it is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.joint_path import JointPath
from planning.path.joints_beside import JointsBeside
from planning.path.kinematics import InverseKinematics
from sensing import SensingError
from sensing.camera.camera_model import CalibrationError, CameraModel
from sensing.camera.hand_eye import (
    BEND,
    BENT,
    PRIOR,
    RISE,
    TILT,
    UNCALIBRATED,
    HandEye,
    Observation,
    calibrate,
    calibration_poses,
)
from sensing.camera.line_polynomial import Polyline

UP = np.array([0.0, 0.0, 1.0])
ORIGIN = np.array([0.9, 0.0, 0.3])
ERROR = CalibrationError(roll=0.0035, pitch=0.0035, yaw=0.0035, height=0.001, lateral=0.0005, focal=0.003,
                         principal_point=1.0, distortion=0.01)  # fmt: skip
X = np.arange(-0.25, 0.25, 0.0005)
REFERENCE = np.column_stack([X, 0.04 * np.sin(8.0 * X), 0.0 * X]) + ORIGIN
# 8 mm beside the reference, turned by 1°, and of a slightly different shape.
DRAWN = Polyline((pin.exp3(0.017 * UP) @ np.column_stack([X, 0.041 * np.sin(8.1 * X) + 0.008, 0.0 * X]).T).T + ORIGIN)


def observations(true: CameraModel, rng: np.random.Generator, noise: float = 0.02, pose_noise: float = 0.0,
                 poses: list[pin.SE3] | None = None, moving: tuple[float, float] = (0.0, 0.0),
                 surface: tuple[float, float] = (0.0, 0.0)) -> list[Observation]:
    """What a true camera sees of the drawn line, with pixel noise; ``pose_noise`` in the reported poses.

    ``moving``: at which speed the tool moves, and by how much too early its pose is reported. ``surface``: by
    how much it is higher than its reference [m], and its bend along x [1/m].
    """
    views, (speed, delay), (rise, bend) = [], moving, surface
    if poses is None:
        poses = calibration_poses(ORIGIN, np.array([1.0, 0.3, 0.0]) / math.hypot(1.0, 0.3), UP, 0.065)
    for pose in poses:
        middle = DRAWN.nearest(pose.act(np.array([0.065, 0.0, 0.0]))[None], UP).s
        points = DRAWN.at(middle + np.linspace(-0.07, 0.07, 9))[0]
        points = points + (rise + 0.5 * bend * (points[:, :1] - ORIGIN[0]) ** 2) * UP
        pixels = true.project_tool((points - pose.translation) @ pose.rotation)
        inside = np.all((pixels > 5) & (pixels < (true.width - 5, true.height - 5)), axis=1)
        velocity = speed * pin.exp3(rng.uniform(0, 2 * math.pi) * UP)[:, 0]
        reported = pose * pin.SE3(pin.exp3(pose_noise * rng.standard_normal(3)), pose_noise * rng.standard_normal(3))
        reported.translation = reported.translation - delay * velocity
        views.append(Observation(reported, pixels[inside] + noise * rng.standard_normal((inside.sum(), 2)),
                                 np.full(inside.sum(), 2e-5), velocity))
    return views


def measuring_error(true: CameraModel, believed: CameraModel | HandEye, aside: float = 0.03) -> Array:
    """Lateral error [m] of points where the line is looked for: 20 to 110 mm ahead, and up to ``aside`` [m].

    The tip is on the surface; what a calibration has found of the surface's height belongs to its camera.
    """
    camera, rise = believed, 0.0
    if isinstance(believed, HandEye):
        camera, rise = believed.camera, believed.parameters.get(RISE, 0.0)
    x, y = np.meshgrid(np.linspace(0.02, 0.11, 5), np.linspace(-aside, aside, 5))
    points = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()])
    return np.asarray((camera.on_plane(true.project_tool(points), -UP, rise) - points)[:, 1])


def wrong(seed: int) -> tuple[np.random.Generator, CameraModel, CameraModel]:
    """A camera as it is believed, and as it is."""
    rng, believed = np.random.default_rng(seed), CameraModel.default()
    return rng, believed, believed.perturbed(**ERROR.signed(rng))


def run(seed: int, **options: float) -> tuple[CameraModel, CameraModel, HandEye]:
    rng, believed, true = wrong(seed)
    return true, believed, calibrate(believed, observations(true, rng, **options), REFERENCE, UP)  # type: ignore[arg-type]


def test_without_noise_the_camera_is_found() -> None:
    true, believed, result = run(0, noise=0.0)
    assert np.abs(measuring_error(true, believed)).mean() > 1e-4
    # What is left is the spline's error in describing the line, and what the prior holds back.
    assert np.abs(measuring_error(true, result)).max() < 5e-6
    assert result.residual_after < 2e-6
    assert result.residual_before > 1e-4


@pytest.mark.parametrize("seed", range(6))
def test_with_pixel_noise_the_measuring_error_falls_below_twenty_micrometres(seed: int) -> None:
    true, believed, result = run(seed)
    before, after = (np.abs(measuring_error(true, camera)).mean() for camera in (believed, result))
    assert before > 1e-4
    assert after < 2e-5


def test_stated_uncertainty_is_honest() -> None:
    """Well determined parameters and the poorly determined ones alike: estimates spread as much as is stated."""
    scaled = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        believed = CameraModel.default()
        wrong = {"roll": rng.normal(0, 0.01), "pitch": rng.normal(0, 0.01), "yaw": rng.normal(0, 0.01),
                 "height": rng.normal(0, 0.003), "lateral": rng.normal(0, 0.002), "forward": rng.normal(0, 0.002),
                 "focal": rng.normal(0, 0.01), "principal_u": rng.normal(0, 2), "principal_v": rng.normal(0, 2),
                 "k1": rng.normal(0, 0.03)}  # fmt: skip
        rise = rng.normal(0, 0.01)
        result = calibrate(believed, observations(believed.perturbed(**wrong), rng, surface=(rise, 0.0)), REFERENCE, UP)
        wrong[RISE] = rise
        scaled.append([(result.parameters[key] - wrong[key]) / result.sigma[key] for key in wrong])
    assert 0.6 < np.sqrt(np.mean(np.square(scaled))) < 1.5


def seen_by_an_arm(true: CameraModel, rng: np.random.Generator, known: bool) -> list[Observation]:
    """What a camera sees on an arm whose joints are not as drawn, half of the poses with its wrist turned over.

    ``known``: whether it is told how such joints carry the tool.
    """
    robot, data = Robot.load("kr6"), Robot.load("kr6").pinocchio.createData()
    arm, off = robot.pinocchio.copy(), rng.standard_normal((robot.n, 6)) * np.repeat(UNCALIBRATED, 3)
    for joint, (place, turn) in enumerate(zip(off[:, :3], off[:, 3:], strict=True), start=1):
        arm.jointPlacements[joint] = pin.SE3(pin.exp3(turn) @ arm.jointPlacements[joint].rotation,
                                             arm.jointPlacements[joint].translation + place)
    kinematics, views = InverseKinematics(robot), list[Observation]()
    down = np.diag([1.0, -1.0, -1.0])
    followed = kinematics.search(pin.SE3(down, ORIGIN), robot.home)
    beside = JointsBeside(robot, JointPath.through(np.arange(2.0), np.tile(followed, (2, 1))), 0.0)
    poses = calibration_poses(ORIGIN, np.array([1.0, 0.0, 0.0]), UP, 0.065)
    for k, pose in enumerate(poses):
        q = kinematics.search(pose, followed)
        if k % 2:
            half = np.copysign(np.pi, q)
            q = kinematics.solve(pose, np.array([*q[:3], q[3] - half[3], -q[4], q[5] - half[5]]))
        pin.framesForwardKinematics(arm, data, q)
        stands = data.oMf[robot.tool_id]
        middle = DRAWN.nearest(stands.act(np.array([0.065, 0.0, 0.0]))[None], UP).s
        points = DRAWN.at(middle + np.linspace(-0.07, 0.07, 9))[0]
        pixels = true.project_tool((points - stands.translation) @ stands.rotation)
        pixels = pixels[np.all((pixels > 5) & (pixels < (true.width - 5, true.height - 5)), axis=1)]
        views.append(Observation(robot.fk()(q), pixels + 0.02 * rng.standard_normal(pixels.shape),
                                 np.full(len(pixels), 2e-5)))
        if known:
            views[-1] = replace(views[-1], carried=beside.carried(q, 0.0))
    return views


def test_what_joints_that_are_not_as_drawn_do_to_a_calibration_is_in_its_standard_deviations() -> None:
    """Also where the wrist turns over between the poses, which carries the tool to another side."""
    scaled: dict[bool, list[float]] = {True: [], False: []}
    for known, seed in product(scaled, range(12)):
        rng, believed, true = wrong(200 + seed)
        result = calibrate(believed, seen_by_an_arm(true, rng, known), REFERENCE, UP)
        lateral = (true.T_tool_camera.translation - believed.T_tool_camera.translation)[1]
        scaled[known].append((result.parameters["lateral"] - lateral) / result.sigma["lateral"])
    assert 0.5 < np.sqrt(np.mean(np.square(scaled[True]))) < 1.6
    assert np.sqrt(np.mean(np.square(scaled[False]))) > 1.5


def test_pose_errors_of_the_arm_cost_little_and_raise_the_residual() -> None:
    true, _, result = run(2, pose_noise=1e-4)
    assert np.abs(measuring_error(true, result)).mean() < 1.5e-4
    assert result.residual_after > 3e-5


def test_time_stamp_error_shows_while_moving() -> None:
    rng = np.random.default_rng(5)
    believed = CameraModel.default()
    result = calibrate(believed, observations(believed, rng, moving=(0.3, 0.0012)), REFERENCE, UP)
    assert result.time_offset == pytest.approx(0.0012, abs=4 * result.sigma["time_offset"])
    assert result.sigma["time_offset"] < 1e-4


def test_outliers_are_dropped() -> None:
    rng, believed, true = wrong(7)
    views = observations(true, rng)
    for k in (3, 11):
        views[k].pixels[2] += (3.0, -2.0)
    result = calibrate(believed, views, REFERENCE, UP)
    assert result.used <= sum(len(o.pixels) for o in views) - 2
    assert np.abs(measuring_error(true, result)).mean() < 3e-5


def test_parameters_left_out_stay_as_they_are() -> None:
    rng = np.random.default_rng(1)
    believed = CameraModel.default()
    result = calibrate(believed, observations(believed, rng), REFERENCE, UP, prior={"roll": 0.01, "yaw": 0.01})
    assert set(result.parameters) == {"roll", "yaw"}
    np.testing.assert_array_equal(result.camera.K, believed.K)


def test_one_pose_tells_nothing() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(SensingError, match="too few"):
        calibrate(CameraModel.default(), observations(CameraModel.default(), rng)[:1], REFERENCE, UP)


def test_calibration_poses_look_at_the_line() -> None:
    tangent = np.array([0.0, 1.0, 0.0])
    for pose in calibration_poses(ORIGIN, tangent, UP, 0.065):
        np.testing.assert_allclose(pose.rotation.T @ pose.rotation, np.eye(3), atol=1e-12)
        assert pose.rotation[2, 2] == pytest.approx(-1.0)
        look = pose.act(np.array([0.065, 0.0, 0.0])) - ORIGIN
        assert np.linalg.norm(look[:2]) < 0.041
        assert 0.0 <= look[2] <= 0.0451


def test_the_slope_of_the_surface_is_told_from_the_camera_that_looks_at_it() -> None:
    rng, believed, true = wrong(9)
    # All of the cell turned about the base's y axis: the line rises by 1°, the poses stay as they are.
    slope = math.radians(1.0)
    R = pin.exp3(slope * np.array([0.0, 1.0, 0.0]))
    poses = calibration_poses(ORIGIN, np.array([1.0, 0.3, 0.0]) / math.hypot(1.0, 0.3), UP, 0.065)
    views = observations(true, rng, poses=[pin.SE3(R.T @ p.rotation, R.T @ (p.translation - ORIGIN) + ORIGIN)
                                           for p in poses])  # fmt: skip
    reported = [Observation(pose, view.pixels, view.sigma) for pose, view in zip(poses, views, strict=True)]
    result = calibrate(believed, reported, REFERENCE, UP)
    assert abs(result.parameters["surface_tilt"]) == pytest.approx(slope, abs=4 * result.sigma["surface_tilt"])
    # Across the line nothing is told of it.
    np.testing.assert_allclose(result.surface.rotation @ UP, R @ UP, atol=3e-3)
    assert np.abs(measuring_error(true, result)).mean() < 1e-4
    flat = calibrate(believed, reported, REFERENCE, UP, {key: value for key, value in PRIOR.items() if key != TILT})
    assert flat.residual_after > 2.0 * result.residual_after


def test_a_height_is_the_surface_s_more_than_the_camera_s() -> None:
    """Pictures show the difference of both; by hand a camera is mounted more exactly than a surface is placed."""
    believed, high, mounted = CameraModel.default(), 5e-3, 0.5e-3
    true = believed.perturbed(height=mounted)
    views = observations(true, np.random.default_rng(4), surface=(high, 0.0))
    result = calibrate(believed, views, REFERENCE, UP)
    np.testing.assert_allclose(result.surface.act(ORIGIN)[2] - ORIGIN[2], result.parameters[RISE], atol=1e-4)
    assert result.parameters[RISE] == pytest.approx(high, abs=result.sigma[RISE])
    known = calibrate(believed, views, REFERENCE, UP, {key: value for key, value in PRIOR.items() if key != RISE})
    difference = known.parameters["height"]
    assert difference == pytest.approx(mounted - high, abs=4 * known.sigma["height"])
    assert result.parameters["height"] - result.parameters[RISE] == pytest.approx(difference, rel=0.02)
    assert result.parameters[RISE] > 0.9 * abs(difference)
    # Over all of what they rise by together nothing is told.
    assert result.sigma[RISE] == pytest.approx(result.sigma["height"], rel=0.01)
    assert result.sigma[RISE] > 2.5e-3 > 5.0 * known.sigma["height"]


@pytest.mark.parametrize("bend", [-0.9, 0.6])
def test_the_bend_of_the_surface_is_told_from_lens_and_distance(bend: float) -> None:
    """A surface that rises or falls by 4 mm over 0.1 m: taken for flat it is found as focal length."""
    rng, believed, true = wrong(9)
    views = observations(true, rng, surface=(0.0, bend))
    result = calibrate(believed, views, REFERENCE, UP, BENT)
    assert result.parameters[BEND] == pytest.approx(bend, abs=4 * result.sigma[BEND])
    assert np.abs(measuring_error(true, result)).mean() < 2e-5
    flat = calibrate(believed, views, REFERENCE, UP)
    assert abs(result.camera.K[0, 0] - true.K[0, 0]) < 1.0 < 3.0 < abs(flat.camera.K[0, 0] - true.K[0, 0])
