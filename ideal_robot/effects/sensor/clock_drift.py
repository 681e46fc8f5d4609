"""A camera whose clock runs at another rate than the controller's."""

from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.sensor.seen_line import DRIFT, SeenLineEffect


class ClockDrift(SeenLineEffect):
    """An error of the time stamps that grows, ``delta(t) = rate t``, from none at the recording's first sample.

    Both clocks are quartzes, or one of them is not read when it should be. Beside ``camera_latency`` it is only
    known as far as the time is long in which the line is seen.
    """

    name = "clock_drift"
    needs = (DRIFT,)
    coefficient_names = ("rate",)
    coefficient_units = ("s/s",)
    source = "[L] (4), (5) with a time offset that grows"

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The pose of the exposure."""
        return LoopChange(latency_rate=coefficients[0])
