"""The camera on the tool is calibrated by moving the real arm over a piece of the line ([L] 4.4)."""

from __future__ import annotations

import numpy as np

from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.model.model import Model
from scenes.follow.live_arm import LiveArm, moves
from scenes.follow.live_camera import LiveCamera
from scenes.line.calibration_view import CalibrationView, calibration_postures
from scenes.line.known import Known
from scenes.scene_error import SceneError
from sensing.camera.hand_eye import HandEye

REST = 0.16
"""Rest at each pose, in which vibrations die out [s]."""
SPARING = 4
"""One field in so many is looked at: neighbours tell the same."""
_PIECE, _STEP = 0.25, 0.001
_PATIENCE = 60.0
"""How long the computation may take; the arm is held meanwhile [s]."""


def calibrated_by_moving(known: Known, model: Model, arm: LiveArm, camera: LiveCamera, at: float) -> HandEye:
    """Moves from the start over the piece of the line and back; returns the camera that explains what was seen.

    Args:
        known: what is known of the scene; its camera is the one mounted by hand.
        model: of the arm, for the gears' deflection.
        arm: at the start of the reference, and again when this returns.
        camera: on the arm.
        at: arc length of the reference around which the piece lies [m].

    Raises:
        SceneError: too few of the poses can be reached, or of the fields show the line.
        FollowStoppedError: the arm has to stop, or is gone.
    """
    robot, reference, start = known.robot, known.reference, known.follower.q_start
    postures = calibration_postures(robot, reference, known.camera, at)
    commands = moves(robot, [start, *postures, start], REST)
    sag = GearDeflection(model, robot.t_ipo).along(commands)
    view = CalibrationView(robot, reference, known.camera, camera.detection, known.detector, start)
    arm.begin()
    camera.predict = view.predicted
    fields = 0
    for k, q_c in enumerate(commands):
        arm.check(arm.t)
        arm.q_d = q_c
        q = arm.cycle(q_c).q
        view.history.add(arm.t, q - sag[k])
        for field in camera.arrived(arm.t):
            fields += 1
            if fields % SPARING == 0:
                view.look(field, view.predicted(field.t_stamp), 0.0)
    looked = fields // SPARING
    if len(view.observations) < max(looked // 2, 3):
        raise SceneError(f"the camera could not be calibrated: only {len(view.observations)} of {looked} fields showed "
                         "the line; check where the line is, how it looks (line.gray, line.width_mm), and the camera")
    near = reference.position(np.arange(at - _PIECE, at + _PIECE, _STEP))
    camera.calibrate(known.camera, view.observations, near, reference.frames(np.array([at])).up[0])
    for _ in range(int(_PATIENCE / robot.t_ipo)):
        if camera.hand_eye is not None:
            break
        arm.check(arm.t)
        arm.cycle(start)
    if not isinstance(camera.hand_eye, HandEye):
        raise SceneError(f"the camera could not be calibrated: {camera.hand_eye or 'it took too long'}")
    return camera.hand_eye
