"""The data of a line scene that are known before the motion, without those of the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.line.deviation_model import COPIED, SHAPES, Expected, PathDeviation, fitting_shape, shape_likelihoods
from planning.line.fusion import DeviationFilter
from planning.line.line_follower import FollowerSettings, LineFollower, line_ahead
from planning.line.measurement import Measurement
from planning.path.joints_beside import JointsBeside
from planning.path.pose_history import PoseHistory
from planning.path.reference import ReferencePath
from scenes.line_way import FOUND, line_way, middle_of_view
from scenes.online.known import Known
from scenes.placing import where_it_fits
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_device import Field, Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.hand_eye import Observation
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows

HORIZON = 0.3
"""Time for which desired positions are handed to the ideal robot, several of its main time constants ([L] 2.2) [s]."""
EDGE = 4
"""Pixels at the edge of a picture in which no line is looked for: half a window, and what the tool sways."""
START = 0.48
"""Time at rest before the path begins, in which the ideal robot takes up the gears' deflection under gravity [s]."""


@dataclass(kw_only=True)
class KnownLine(Known):
    """Data for a follower of a line: the camera's place and the line's, and how both may change."""

    scene: LineScene
    follower: LineFollower


def line_follower(scene: LineScene, robot: Robot, points: Array, camera: CameraModel, surface: pin.SE3 | None = None,
                  latency: float = FollowerSettings.latency, shape: tuple[float, float] | None = None
                  ) -> tuple[ReferencePath, LineFollower]:
    """Reference path and follower of a scene.

    Args:
        scene: speed, limits and measured quantities.
        robot: the arm with the controller's cycle.
        points: of the reference ``(N, 3)`` [m].
        camera: as it is believed.
        surface: motion of the surface from its nominal place to its calibrated one, by which the reference is moved;
            the follower estimates the rest.
        latency: usual age of a field when it arrives [s].
        shape: one of ``SHAPES``; if None, the first where the reference has the line's own shape, else the last.

    Raises:
        InputError: line out of reach, unreachable speed, a motion longer than the scene allows.
    """
    height, tilt = (FollowerSettings.height, FollowerSettings.tilt) if surface is None else FOUND
    shape = shape or SHAPES[0 if scene.reference.shape is None else -1]
    try:
        way = line_way(scene, robot, points, surface)
        reference, profile = way.reference, way.travel()
        follower = LineFollower(
            robot, reference, profile, round(HORIZON / robot.t_ipo), t_start=START,
            settings=FollowerSettings(measurement=scene.measurement, height=height, tilt=tilt, view=view_of(camera),
                                      max_gap=scene.max_gap, max_search=scene.max_gap + 0.05, latency=latency,
                                      shape=shape[0], length=shape[1], line_span=span_of(scene, reference),
                                      eye=tuple(camera.T_tool_camera.translation), points=scene.points,
                                      stamp=FollowerSettings.stamp if scene.stamp_estimate else 0.0))
    except (InputError, OutOfReachError) as error:
        if isinstance(error, InputError) and error.field != "path":
            raise
        reason = error.message if isinstance(error, InputError) else str(error)
        if surface is not None:
            raise SceneError("calibration by moving found the surface where the line cannot be followed: "
                             f"{reason}") from error
        raise InputError(f"{reason}; {where_it_fits(scene)}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    return reference, follower


def view_of(camera: CameraModel) -> tuple[float, float]:
    """Nearest and farthest distance ahead of the tool in this camera's view [m], at most the default ones."""
    ahead = np.linspace(*FollowerSettings.view, 151)
    pixels = camera.project_tool(np.column_stack([ahead, np.zeros((len(ahead), 2))]))
    size = np.array([camera.width, camera.height])
    shown = ahead[np.all((pixels >= EDGE) & (pixels <= size - 1 - EDGE), axis=1)]
    return (float(shown[0]), float(shown[-1])) if len(shown) > 1 else FollowerSettings.view


def span_of(scene: LineScene, reference: ReferencePath) -> tuple[float, float]:
    """Arc lengths of the reference between which the line ought to be [m]."""
    return scene.reference.run_up, reference.length - scene.reference.run_out


# Moves the camera over one segment of the line: motion, predicted line, points seen.

SPREAD = np.linspace(-0.07, 0.07, 9)
"""Places on the line looked for in each field, around the middle of the view [m]."""
BY_HAND = 0.002
"""What a camera that is mounted by hand shows beside the line, another from pose to pose, standard deviation [m]."""
ROUGH = 0.001
"""How exactly a whole picture shows the line, standard deviation [m]."""
FINE = 0.0003
"""The same of a calibrated camera: what two pictures of one place differ by where gears bend otherwise [m]."""
STRAY, ANYWHERE = 0.05, 0.05
"""Probability with which a picture shows something else for the line, and where that lies, standard deviation [m]."""
FOLLOWED, STEEP = 0.05, float(np.tan(np.radians(30.0)))
"""How far beside its reference and how steep against it a line is followed [m] (``python -m studies line-shapes``)."""
REACH = 0.2
"""How far from the middle of the piece the line's deviation from its reference is kept [m]."""
PER_SPEED = 1e-3
"""Uncertainty of a moving tool's place: a millisecond's way, standard deviation [m per m/s]."""
REST = 0.16
"""Rest at each pose of the calibration, in which vibrations die out [s]."""


@dataclass(frozen=True)
class SeenBefore:
    """Where whole pictures from above the reference showed the line, two points of each.

    Attributes:
        detection: the line's appearance, for its detection.
        s: arc lengths of the reference ``(2 k,)`` [m].
        deviation: deviations from the reference there ``(2 k,)`` [m].
        pictures: all of them, with the poses of the tool.
        shape: the likeliest of ``SHAPES``; None where nothing was seen.
    """

    detection: DetectionSettings = field(default_factory=DetectionSettings)
    s: Array = field(default_factory=lambda: np.empty(0))
    deviation: Array = field(default_factory=lambda: np.empty(0))
    pictures: tuple[tuple[Gray, pin.SE3], ...] = ()
    shape: tuple[float, float] | None = None

    @classmethod
    def of(cls, detection: DetectionSettings, places: Array, pictures: Sequence[tuple[Gray, pin.SE3]],
           reference: ReferencePath) -> SeenBefore:
        """Makes the deviations of the line from the points of each picture in the tool frame.

        Args:
            detection: how the line looks.
            places: ``(k, 2, 3)`` [m]; NaN where a picture did not show the line.
            pictures: each with the pose of the tool, as the controller knows it, ``k``.
            reference: the reference path.
        """
        points = [np.array([pose.act(point) for point in two]) for two, (_, pose) in zip(places, pictures, strict=True)]
        seen = [reference.project(two, _nearest(reference, two.mean(axis=0)))[:2] for two in points
                if np.isfinite(two).all()]
        # A line that runs more across than along the reference is not the line to be followed, but crosses it.
        seen = [(s, deviation) for s, deviation in seen if abs(np.diff(deviation)[0]) < abs(np.diff(s)[0])]
        s, deviation = (np.concatenate(one) for one in zip(*seen, strict=True)) if seen else (np.empty(0), np.empty(0))
        before = cls(detection, s, deviation, tuple(pictures))
        return replace(before, shape=before._likeliest(reference))

    @property
    def covariance(self) -> Array:
        """Covariance of the deviations ``(2 k, 2 k)`` [m²]: the two of a picture share the camera's error."""
        return np.kron(np.eye(len(self.s) // 2), np.full((2, 2), BY_HAND**2)) + ROUGH**2 * np.eye(len(self.s))

    def _likeliest(self, reference: ReferencePath) -> tuple[float, float] | None:
        """See ``shape``; one picture may show something else."""
        pictures = np.repeat(np.arange(len(self.s) // 2), 2)
        if not len(pictures):
            return None
        scores = [self._likelihoods(reference, pictures != out) for out in (-1, *np.unique(pictures))]
        return SHAPES[int(np.argmax(np.max(scores, axis=0)))]

    def _likelihoods(self, reference: ReferencePath, line: NDArray[np.bool_]) -> Array:
        """Log-likelihoods of ``SHAPES``, if these of the points ``(2 k,)`` are the line's and others lie anywhere."""
        stray = self.deviation[~line]
        density = -0.5 * (stray / ANYWHERE) ** 2 - np.log(ANYWHERE * np.sqrt(2.0 * np.pi))
        wrong = len(stray) // 2 * np.log(STRAY) + float(density.sum())
        if not line.any():
            return np.full(len(SHAPES), wrong)
        return wrong + shape_likelihoods(reference, self.s[line], self.deviation[line], self.covariance[line][:, line])

    def too_far(self) -> str:
        """A warning on a line that leaves its reference by more than can be followed; empty where it does not."""
        aside = np.abs(self.deviation)
        steep = np.abs(np.diff(self.deviation.reshape(-1, 2)) / np.diff(self.s.reshape(-1, 2)))[:, 0]
        if not np.any(aside > FOLLOWED) and not np.any(steep > STEEP):
            return ""
        far, turned = float(aside.max()), float(np.degrees(np.arctan(steep.max())))
        return (f"pictures from above show the line up to {1e3 * far:.0f} mm beside its reference and turned by up to "
                f"{turned:.0f}° against it; {1e3 * FOLLOWED:.0f} mm and {np.degrees(np.arctan(STEEP)):.0f}° are "
                "followed surely: draw reference.shape or surface.origin nearer to the line, or go slower")


def looked_again(known: KnownLine, camera: CameraModel, before: SeenBefore, span: tuple[float, float]
                 ) -> tuple[float, float] | None:
    """How far the line's shape leaves the reference's, by the pictures before the run and the calibrated camera.

    That camera is accurate enough to follow the line from picture to picture, and to distinguish a copy of its
    reference from narrow bends. Returns None where no picture shows the line, or no shape fits.

    Args:
        known: reference, detector, and the camera as it was believed to be when the pictures were taken.
        camera: as calibrated.
        before: the pictures with their deviations.
        span: arc lengths of the reference between which the line ought to be [m].
    """
    if (shape := before.shape) is None:
        return None
    line = piece_map(known.reference, 0.5 * known.reference.length, before, 0.5 * known.reference.length)
    projections = [(np.empty(0), np.empty(0))]
    for picture, pose in before.pictures:
        s = _nearest(known.reference, pose.act(middle_of_view(camera)))
        prediction = line_ahead(known.reference, line, s + SPREAD).seen_from(pose)
        shown = Field.cut(0.0, picture, search_windows(camera, prediction, before.detection))
        detected = known.detector.detect(shown, camera, prediction, before.detection)
        if not detected.seen:
            continue
        points = detected.points_tcp[detected.used] @ pose.rotation.T + pose.translation
        projections.append(known.reference.project(points, s)[:2])
        line.update(Measurement(0.0, *projections[-1], FINE**2 * np.eye(len(points))))
    places, beside = np.concatenate(projections, axis=1)
    if np.diff(np.sort(np.concatenate([places, span]))).max() > COPIED[1]:
        return shape
    order = np.argsort(places)
    return fitting_shape(known.reference, places[order], beside[order], FINE, shape)


def _nearest(reference: ReferencePath, point: Array) -> float:
    """Arc length of the reference's place nearest to a point [m]."""
    table = np.arange(0.0, reference.length, 0.005)
    return float(table[np.argmin(np.sum((reference.position(table) - point) ** 2, axis=1))])


def piece_map(reference: ReferencePath, at: float, before: SeenBefore = SeenBefore(), reach: float = REACH
              ) -> DeviationFilter:
    """Map of the line's deviation from the reference around one segment of it.

    Args:
        reference: the reference path.
        at: arc length of it around which the piece lies [m].
        before: places of the line in earlier pictures.
        reach: distance from there up to which it is kept [m].
    """
    shape, length = before.shape or SHAPES[0]
    across = Expected(shape=shape, length=length)
    fusion = DeviationFilter(PathDeviation(reference, across=across, ahead=reach, behind=reach), confirm=0)
    fusion.travel(at)
    if len(before.s):
        fusion.update(Measurement(0.0, before.s, before.deviation, before.covariance))
    return fusion


class CalibrationView:
    """Data of arm and line while the camera is calibrated by moving, with the fields seen so far.

    Place and shape of the line are estimated during the motion: fields are fused into a map of its deviation from the
    reference, as in a run.

    Args:
        robot: the arm.
        reference: the reference path.
        believed: the camera as mounted by hand.
        detection: how the line looks.
        detector: finds the line's points.
        q: where the arm rests at first ``(n,)`` [rad].
        fusion: the map, see ``piece_map``.
        beside: effects of wrong joint places on a calibration; None without a calibration.
    """

    def __init__(self, robot: Robot, reference: ReferencePath, believed: CameraModel, detection: DetectionSettings,
                 detector: LineDetector, q: Array, fusion: DeviationFilter, beside: JointsBeside | None = None) -> None:
        self.reference, self.believed, self.detection, self.detector = reference, believed, detection, detector
        self.history = PoseHistory(robot)
        self.history.add(0.0, q)
        self.observations, self._map, self._beside = list[Observation](), fusion, beside

    def predicted(self, t: float) -> PredictedLine:
        """The line around the middle of the view at ``t`` [s], as the fields so far have shown it."""
        line = line_ahead(self.reference, self._map, self._at(self.history.row_pose(t)) + SPREAD)
        return line.seen_by(self.believed, t, self.history.row_pose)

    def _at(self, pose: pin.SE3) -> float:
        """Arc length of the reference in the middle of the view [m]."""
        return _nearest(self.reference, pose.act(middle_of_view(self.believed)))

    def look(self, shown: Field, prediction: PredictedLine, ahead: float) -> None:
        """Stores the line points of a field.

        Args:
            shown: as it arrived.
            prediction: where the line should be in it.
            ahead: by how much the stamps run ahead of the arm's time [s].
        """
        detected = self.detector.detect(shown, self.believed, prediction, self.detection)
        if not detected.seen:
            return
        t, pose = shown.t_stamp - ahead, self.history.row_pose(shown.t_stamp - ahead)
        points = detected.points_tcp[detected.used] @ pose.rotation.T + pose.translation
        s, deviation, _ = self.reference.project(points, self._at(pose))
        self._map.update(Measurement(t, s, deviation, np.diag(detected.sigma[detected.used] ** 2) + BY_HAND**2))
        velocity, angular = self.history.velocity(t)
        carried = np.zeros((6, 0))
        if self._beside is not None:
            carried = self._beside.carried(self.history.row_q(t), float(np.mean(s)))
        sigma = np.hypot(detected.sigma[detected.used], PER_SPEED * np.linalg.norm(velocity))
        self.observations.append(Observation(pose, detected.pixels[detected.used], sigma, velocity, angular, carried))

    def piece(self, at: float, fields: int, remedy: str) -> tuple[Array, Array]:
        """Points of the reference about a place ``(N, 3)`` [m], and the surface's normal there ``(3,)``.

        Args:
            at: arc length of the place [m].
            fields: the fields that were taken.
            remedy: advice in ``SceneError`` where fewer than half of the fields showed the line.
        """
        if (count := len(self.observations)) < max(fields // 2, 3):
            raise SceneError(f"the camera could not be calibrated: only {count} of {fields} fields showed the line; "
                             f"check where the line is, {remedy}")
        return (self.reference.position(np.arange(at - 0.25, at + 0.25, 0.001)),
                self.reference.frames(np.array([at])).up[0])
