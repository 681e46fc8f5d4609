"""Calibrates the camera by moving, and then checks that it sees the line at one place from several poses.

A displaced camera, or pictures that are cropped or shifted, show the same segment of the line at other places when it
is seen from another height and from the other side; an arm that does not follow its commands is noticed meanwhile. The
load on the force sensor is checked where its tool is turned (``scenes.online.force_calibration``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.special import chdtrc, chdtri

from ideal_robot.arrays import Array, held
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.model.model import Model
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.path.joint_path import JointPath
from planning.path.joints_beside import JointsBeside
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from scenes.line_way import calibration_postures, middle_of_view
from scenes.online.line_known import FINE, REST, CalibrationView, piece_map
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, LiveCamera
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import PRIOR, HandEye
from sensing.camera.line_search import DetectionSettings

# The camera on the tool is calibrated by moving the real arm over a piece of the line ([L] 4.4).

_COMPUTING = 60.0
"""How long the computation may take; the arm is held meanwhile [s]."""


@dataclass(frozen=True)
class Piece:
    """The segment of the line that is viewed.

    Attributes:
        at: arc length of the reference around which the piece lies [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        clear: how far the tip keeps away from the reference at least [m].
        shapes: the arm in its cell.
        prior: of the calibration, see ``sensing.camera.hand_eye.calibrate``.
    """

    reference: ReferencePath
    at: float
    start: Array
    clear: float = 0.0
    shapes: Shapes | None = None
    prior: Mapping[str, float] = field(default_factory=lambda: PRIOR)


@dataclass(frozen=True)
class CalibrationMotion:
    """The motion from the start over a segment of the line and back, planned before the arm is connected.

    Attributes:
        out, over, back: commands ``(N, n)`` [rad] from rest to rest. Pictures from ``out`` and ``back`` are not used,
            as they show another segment of the line, or none.
        deflection: of the gears.
        view: of the camera as mounted by hand.
    """

    piece: Piece
    out: Array
    over: Array
    back: Array
    deflection: GearDeflection
    view: CalibrationView

    @classmethod
    def planned(cls, piece: Piece, by_hand: CameraModel, model: Model, robot: Robot, detection: DetectionSettings
             ) -> CalibrationMotion:
        """Plans the motion, and loads compiled code, so that neither delays a cycle.

        Args:
            piece: of the line.
            by_hand: the camera as mounted by hand.
            model: of the arm, for the gears' deflection.
            robot: the arm.
            detection: how the line looks.

        Raises:
            SceneError: too few of the poses can be reached, or the arm would touch something.
        """
        reference, start, at = piece.reference, piece.start, piece.at
        path = JointPath.of(robot, reference)
        postures = calibration_postures(robot, reference, path, by_hand, at, piece.clear, piece.shapes)
        for end in (postures[0], postures[-1]):
            if piece.shapes is not None and (touch := piece.shapes.touch_between(start, end)) is not None:
                raise SceneError(f"the camera cannot be calibrated: {touch} between the start and the calibration's "
                                 "poses; set calibration.by_moving = false")
        out, over, back = (moves(robot, some, REST) for some in ([start, postures[0]], postures, [postures[-1], start]))
        beside = JointsBeside(robot, path, at, float(middle_of_view(by_hand)[0]))
        imagined, view = (CalibrationView(robot, reference, by_hand, detection, FoundBefore(), start,
                                          piece_map(reference, at), beside) for _ in range(2))
        imagined.history.add(robot.t_ipo, start)
        camera, t = ImaginedCamera(), 0.5 * robot.t_ipo
        camera.predict = imagined.predicted
        camera.request(t, t, lambda _: None)
        for shown in camera.arrived(t):
            imagined.look(shown, imagined.predicted(t), 0.0)
        deflection = GearDeflection(model, robot.t_ipo)
        deflection.along(out)
        return cls(piece, out, over, back, deflection, view)


def calibrated_by_moving(motion: CalibrationMotion, arm: LiveArm, camera: LiveCamera) -> HandEye:
    """Moves over the segment of the line and back; returns the camera calibration that fits the pictures.

    Args:
        motion: as planned.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: too few of the fields show the line.
        FollowStoppedError: the arm has to stop, or is gone.
    """
    piece, view = motion.piece, motion.view
    ways = arm.timed(motion.out, motion.over, motion.back)
    commands = np.concatenate(ways)
    sag = arm.meanwhile(lambda: motion.deflection.along(commands))
    first, last = np.cumsum([len(way) for way in ways])[:2]
    arm.begin()
    camera.predict = view.predicted
    fields, begin, end = 0, np.inf, np.inf
    with arm.motion():
        for q_c, bent, row in arm.guard.steps(commands, sag, np.arange(float(len(commands)))):
            # If the arm is paused it waits, while its time goes on.
            begin = min(begin, arm.t) if row >= first else np.inf
            end = min(end, arm.t) if row >= last else np.inf
            arm.q_d = q_c
            q = arm.cycle(q_c).q
            view.history.add(arm.t, q - bent)
            for shown in camera.arrived(arm.t):
                if begin <= shown.t_stamp <= end:
                    fields += 1
                    view.look(shown, view.predicted(shown.t_stamp), 0.0)
        arm.check(arm.t)
    near, up = view.piece(piece.at, fields, "how it looks (line.gray, line.width_mm), and the camera")
    arm.meanwhile(lambda: camera.calibrate(view.believed, view.observations, near, up, piece.prior))
    for _ in range(int(_COMPUTING / arm.robot.t_ipo)):
        if camera.hand_eye is not None:
            break
        arm.check(arm.t)
        arm.cycle(piece.start)
    if not isinstance(camera.hand_eye, HandEye):
        raise SceneError(f"the camera could not be calibrated: {camera.hand_eye or 'it took too long'}")
    return camera.hand_eye


# Views the line from several poses, one of them turned.

POSES = ((0.04, 0.0), (0.09, 0.35))
"""Height of the tip above the surface [m] and turn about its normal [rad], from which the line is looked at."""
TURNS = (np.pi, 0.8 * np.pi, 0.65 * np.pi)
"""Turns [rad] of the tool about its own axis for a last look from the height of the first one; the first that the arm
can make is made. What a camera shows beside the line it then shows on the other side."""
AHEAD = 0.06
"""Way behind the begin of the line to the place that is looked at [m]."""
STILL = 0.5
"""Rest in each pose, in which pictures count [s]."""
FEWEST, PATIENCE = 5, 2.0
"""Pictures that have to show the line in each pose, and how long beyond the rest a slow camera is waited for [s]."""
BY_CHANCE = 1e-6
"""Probability with which a sound camera is refused."""
_WRIST = 0.5 * np.pi
"""Largest way of the other joints in a turn of the tool about its axis [rad]: more is another posture of the arm."""


@dataclass(frozen=True)
class Look:
    """The view that is checked before the task.

    Attributes:
        begin: arc length of the reference at which the line begins [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        camera: as it is calibrated.
        sigma: standard deviation of one place of the line from pose to pose after the calibration [m]; NaN where
            unknown, then ``FINE`` is used.
        shapes: the arm in its cell; None where they are unknown.
    """

    reference: ReferencePath
    begin: float
    start: Array
    camera: CameraModel
    model: Model
    sigma: float = float("nan")
    shapes: Shapes | None = None


@dataclass(frozen=True)
class Seen:
    r"""Places of the line as seen from several poses, and the test whether they agree.

    A displaced camera shows the line a distance :math:`e` beside its place in the view of the task, and from pose i
    :math:`e\, b_i`: more from farther away, with the other sign from the other side. The places :math:`p_i` of a
    correct camera differ only by its calibration's residual, so

    .. math:: \chi^2 = \sum_i \frac{(p_i - \bar p)^2}{\sigma^2}, \qquad
              e_{passes} = \sigma \sqrt{\frac{\chi^2_{k-1}(\alpha)}{\sum_i (b_i - \bar b)^2}}

    Attributes:
        places: how far beside the reference, from each pose ``(k,)`` [m].
        shown: b, share of a displacement that each pose shows ``(k,)``.
        sigma: standard deviation of each place [m].
        turned: by how much the last pose was turned [rad]; 0 where the arm cannot turn the tool there.
    """

    places: Array
    shown: Array
    sigma: float
    turned: float

    @property
    def apart(self) -> float:
        """Largest distance between the places seen [m]."""
        return float(np.ptp(self.places))

    @property
    def by_chance(self) -> float:
        """Probability that a correct camera shows places at least so different."""
        return float(chdtrc(len(self.places) - 1, np.sum(np.square(self.places - self.places.mean())) / self.sigma**2))

    @property
    def passes(self) -> float:
        """Displacement that the test would accept in half of the cases [m]."""
        spread = float(np.linalg.norm(self.shown - self.shown.mean()))
        return self.sigma * float(np.sqrt(chdtri(len(self.places) - 1, BY_CHANCE))) / spread

    @property
    def text(self) -> str:
        """The result of the check and the displacement that it would not notice, in words."""
        how = (f"one turned by {np.degrees(self.turned):.0f}°" if self.turned
               else "none of them turned: the arm cannot turn the tool there")
        return (f"seen within {1e3 * self.apart:.2f} mm from {len(self.places)} poses, {how}; a camera that shows up "
                f"to {1e3 * self.passes:.1f} mm beside the line would pass")

    def json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"apart_mm": 1e3 * self.apart, "sigma_mm": 1e3 * self.sigma, "by_chance": self.by_chance,
                "turned_deg": float(np.degrees(self.turned)), "passes_mm": 1e3 * self.passes, "text": self.text}


def check_line(look: Look, arm: LiveArm, camera: LiveCamera) -> Seen:
    """Views the line from several poses, turned by 180° about the tool's axis where the arm can.

    Args:
        look: the view to be checked.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: the line is not seen, or at places that no sound camera shows it at.
        FollowStoppedError: the arm does not follow, the camera is gone, or its stamps wander.
    """
    robot = arm.robot
    (postures, shown, turned), view = arm.meanwhile(lambda: (_postures(look, robot), CalibrationView(
        robot, look.reference, look.camera, camera.detection, FoundBefore(), look.start,
        piece_map(look.reference, look.begin + AHEAD))))
    arm.begin()
    camera.predict = view.predicted
    places, last = [], look.start
    for q in postures:
        places.append(_seen(look, arm, camera, view, moves(robot, [last, q], STILL)))
        last = q
    camera.predict = None
    arm.lead(moves(robot, [last, *reversed(postures[:-1]), look.start], 2 * robot.t_ipo))
    sigma = look.sigma if np.isfinite(look.sigma) else FINE
    seen = Seen(np.array(places), shown, sigma, turned)
    if not seen.by_chance > BY_CHANCE:
        raise SceneError(f"the line is seen {1e3 * seen.apart:.1f} mm apart from {len(places)} poses above it, where a "
                         f"camera whose calibration leaves {1e3 * sigma:.2f} mm shows that once in "
                         f"{1.0 / BY_CHANCE:.0f} times; calibrate the camera anew, or see docs/follow.md for what "
                         "--no-check leaves out")
    return seen


def _postures(look: Look, robot: Robot) -> tuple[list[Array], Array, float]:
    """Joint angles from which the optical axis meets the line where it is looked at.

    Returns them, what each shows of a distance beside the line ``(k,)``, and the turn of the last one [rad].
    """
    mount, q = look.camera.T_tool_camera, look.start
    axis, postures, shown = mount.rotation[:, 2], list[Array](), list[float]()

    def met(height: float) -> Array:
        """Where the axis meets the surface, in the tool frame, whose z axis points into it ``(3,)`` [m]."""
        return np.asarray(mount.translation + (height - mount.translation[2]) / axis[2] * axis)

    def shows(height: float, turn: float) -> float:
        return float(np.cos(turn) * (height - mount.translation[2]) / -mount.translation[2])

    for height, turn in POSES:
        try:
            q = InverseKinematics(robot).search(_pose(look, met(height), turn), q)
        except OutOfReachError as error:
            raise SceneError(f"the line cannot be looked at from above: {error}; or follow with --no-check") from error
        postures.append(q)
        shown.append(shows(height, turn))
    height, turn_0 = POSES[0]
    for turn in TURNS:
        for sign in (1.0, -1.0):
            turned = _turned(look, robot, _pose(look, met(height), turn_0 + sign * turn), postures[-1])
            if turned is not None:
                return [*postures, turned], np.array([*shown, shows(height, turn_0 + turn)]), turn
    return postures, np.array(shown), 0.0


def _pose(look: Look, met: Array, turn: float) -> pin.SE3:
    """The tool's pose, turned about the normal [rad], from which the axis, ``met (3,)`` [m], meets the line."""
    s = np.array([look.begin + AHEAD])
    rotation = pin.exp3(turn * look.reference.frames(s).up[0]) @ look.reference.rotation(float(s[0]))
    return pin.SE3(rotation, look.reference.position(s)[0] - rotation @ met)


def _turned(look: Look, robot: Robot, pose: pin.SE3, q: Array) -> Array | None:
    """Joint angles ``(n,)`` [rad] of a pose that differs from those of ``q`` by the last joint; None without such."""
    kinematics = InverseKinematics(robot)
    turn = float(np.linalg.norm(pin.log3(robot.fk()(q).rotation.T @ pose.rotation)))
    for way in (turn, -turn):
        guess = q.copy()
        guess[-1] += way
        if not robot.q_min[-1] < guess[-1] < robot.q_max[-1]:
            continue
        try:
            found = kinematics.search(pose, guess)
        except OutOfReachError:
            continue
        if np.max(np.abs(found - q)[:-1]) > _WRIST or np.abs(found - guess)[-1] > _WRIST:
            continue
        if look.shapes is None or (look.shapes.touch_between(q, found) or look.shapes.touch_between(found, look.start)
                                   ) is None:
            return found
    return None


def _seen(look: Look, arm: LiveArm, camera: LiveCamera, view: CalibrationView, commands: Array) -> float:
    """Leads the arm by commands ``(N, n)`` [rad]; how far beside the reference the line is seen at their end [m]."""
    commands = arm.timed(commands)
    sag = arm.meanwhile(lambda: GearDeflection(look.model, arm.t_ipo).along(commands))
    # In the last row the deflection is unknown; the arm rests before it and waits for a slow camera.
    sag[-1], last, waits = sag[-2], len(commands) - 1, round(PATIENCE / arm.t_ipo)
    rows = np.arange(float(len(commands) + waits))
    commands, sag = held(commands, after=waits), held(sag, after=waits)
    rests, beside = np.inf, list[float]()
    with arm.motion():
        for q_c, bent, row in arm.guard.steps(commands, sag, rows):
            if row > last and len(beside) >= FEWEST:
                break
            if row >= last - round((STILL - 0.1) / arm.t_ipo):
                rests = min(rests, arm.t)
            arm.q_d = q_c
            view.history.add(arm.t + arm.t_ipo, arm.cycle(q_c).q - bent)
            for shown in camera.arrived(arm.t):
                detected = view.detector.detect(shown, look.camera, view.predicted(shown.t_stamp), view.detection)
                if shown.t_stamp < rests or not detected.seen:
                    continue
                pose = view.history.pose(shown.t_stamp)
                points = detected.points_tcp[detected.used] @ pose.rotation.T + pose.translation
                beside.append(float(np.mean(look.reference.project(points, look.begin + AHEAD)[1])))
        arm.check(arm.t)
    if len(beside) < FEWEST:
        raise SceneError(f"only {len(beside)} pictures from above showed the line; check where it is, how it looks "
                         "(line.gray, line.width_mm) and whether the camera sends")
    return float(np.median(beside))
