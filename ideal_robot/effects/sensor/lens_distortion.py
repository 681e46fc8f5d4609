"""A lens whose distortion is not the one assumed."""

from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.sensor.seen_line import CUBIC, SeenLineEffect


class LensDistortion(SeenLineEffect):
    """Measured points lie too far out by the cube of their distance from the optical axis: ``du = k r² (u - u_axis)``.

    ``u`` is the point as measured. With a camera at height h above the surface ``k h²`` is the error of the first
    radial coefficient k1.
    """

    name = "lens_distortion"
    needs = (CUBIC,)
    coefficient_names = ("cubic",)
    coefficient_units = ("1/m²",)
    source = "D. C. Brown, Close-range camera calibration, 1971: radial distortion, first term"

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The points that the camera measures."""
        return LoopChange(picture=(0.0, coefficients[0], 0.0, 0.0, 0.0))
