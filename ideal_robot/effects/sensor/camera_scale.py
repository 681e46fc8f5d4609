"""A camera at another distance, or of another focal length, than is assumed."""

from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.sensor.seen_line import SCALE, SeenLineEffect


class CameraScale(SeenLineEffect):
    """Measured points lie too far from the optical axis by a constant factor: ``du = epsilon (u - u_axis)``.

    ``u``, as measured, is ``d / f · pixel``: an error of the distance d and one of the focal length f are the same.
    """

    name = "camera_scale"
    needs = (SCALE,)
    coefficient_names = ("scale",)
    coefficient_units = ("1",)
    source = "[L] 4.4: distance and focal length of the camera"

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The points that the camera measures."""
        return LoopChange(picture=(coefficients[0], 0.0, 0.0, 0.0, 0.0))
