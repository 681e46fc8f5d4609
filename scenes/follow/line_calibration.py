"""The camera on the tool is calibrated by moving the real arm over a piece of the line ([L] 4.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.model.model import Model
from planning.path.reference import ReferencePath
from scenes.follow.live_arm import LiveArm, moves
from scenes.follow.live_camera import FoundBefore, LiveCamera
from scenes.line.calibration_view import CalibrationView, calibration_postures
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import HandEye

REST = 0.16
"""Rest at each pose, in which vibrations die out [s]."""
_PIECE, _STEP = 0.25, 0.001
_PATIENCE = 60.0
"""How long the computation may take; the arm is held meanwhile [s]."""


@dataclass(frozen=True)
class Piece:
    """The piece of the line that is looked at.

    Attributes:
        reference: the reference path.
        at: arc length of it around which the piece lies [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        clear: how far the tip keeps away from the reference at least [m].
    """

    reference: ReferencePath
    at: float
    start: Array
    clear: float = 0.0


def calibrated_by_moving(piece: Piece, by_hand: CameraModel, model: Model, arm: LiveArm, camera: LiveCamera) -> HandEye:
    """Moves from the start over the piece of the line and back; returns the camera that explains what was seen.

    Args:
        piece: of the line.
        by_hand: the camera as mounted by hand.
        model: of the arm, for the gears' deflection.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: too few of the poses can be reached, or of the fields show the line.
        FollowStoppedError: the arm has to stop, or is gone.
    """
    robot, reference, start, at = arm.robot, piece.reference, piece.start, piece.at
    postures = calibration_postures(robot, reference, by_hand, at, piece.clear)
    way, over, back = (moves(robot, some, REST) for some in ([start, postures[0]], postures, [postures[-1], start]))
    commands = np.concatenate([way, over, back])
    # On the way there and back another piece of the line is seen, or none: that fits no common curve.
    begin, end = robot.t_ipo * len(way), robot.t_ipo * (len(way) + len(over))
    sag = GearDeflection(model, robot.t_ipo).along(commands)
    view = CalibrationView(robot, reference, by_hand, camera.detection, FoundBefore(), start)
    arm.begin()
    camera.predict = view.predicted
    fields = 0
    for k, q_c in enumerate(commands):
        arm.check(arm.t)
        arm.q_d = q_c
        q = arm.cycle(q_c).q
        view.history.add(arm.t, q - sag[k])
        for field in camera.arrived(arm.t):
            if begin <= field.t_stamp <= end:
                fields += 1
                view.look(field, view.predicted(field.t_stamp), 0.0)
    if len(view.observations) < max(fields // 2, 3):
        raise SceneError(f"the camera could not be calibrated: only {len(view.observations)} of {fields} fields showed "
                         "the line; check where the line is, how it looks (line.gray, line.width_mm), and the camera")
    near = reference.position(np.arange(at - _PIECE, at + _PIECE, _STEP))
    camera.calibrate(by_hand, view.observations, near, reference.frames(np.array([at])).up[0])
    for _ in range(int(_PATIENCE / robot.t_ipo)):
        if camera.hand_eye is not None:
            break
        arm.check(arm.t)
        arm.cycle(start)
    if not isinstance(camera.hand_eye, HandEye):
        raise SceneError(f"the camera could not be calibrated: {camera.hand_eye or 'it took too long'}")
    return camera.hand_eye
