"""Plans where the path is: reference paths, fusion of sensed deviations, desired joint path over a horizon."""

from __future__ import annotations

import math

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError

# What can go wrong while a path is planned or followed.

class PlanningError(IdealRobotError):
    """Root of the planning package's errors."""


class OutOfReachError(PlanningError):
    """The arm cannot reach a pose.

    Args:
        position: the TCP position that was to be reached ``(3,)`` [m].
        error: residual distance between arm and pose [m].
        joint: joint counted from 1 that is at its limit, 0 if the arm is simply too short or singular there.
        value, limit: the joint's angle and the limit it would leave [rad or m]; nan where no joint is meant.
    """

    def __init__(
        self,
        position: Array,
        error: float,
        joint: int = 0,
        value: float = float("nan"),
        limit: float = float("nan"),
    ) -> None:
        self.position, self.error, self.joint, self.value, self.limit = position, error, joint, value, limit
        place = "({:.3f}, {:.3f}, {:.3f}) m".format(*position)
        if joint:
            cause = f"joint {joint} would be at {value:.3f}, its limit is {limit:.3f}"
        else:
            cause = (f"the arm stays {1e3 * error:.1f} mm away" if error >= 1e-4 else
                     "the arm cannot turn the tool as it is wanted there")
        super().__init__(f"{place} is out of reach: {cause}; move the path nearer to the robot or turn the tool")


class LineLostError(PlanningError):
    """The sensor has not shown the line for longer than the follower may continue without it.

    Args:
        t, s: controller time when the follower gave up [s], arc length of the TCP on the reference then [m].
        last_t, last_s: the same when the line was last seen; nan if never.
        limit: distance that may be travelled without seeing the line [m].
        sigma: standard deviation of the line's predicted place at the TCP [m]; nan where it was not computed.
    """

    def __init__(self, t: float, s: float, last_t: float, last_s: float, limit: float,
                 sigma: float = float("nan")) -> None:
        self.t, self.s, self.last_t, self.last_s, self.limit, self.sigma = t, s, last_t, last_s, limit, sigma
        known = "" if math.isnan(sigma) else f", where it is known to {1e3 * sigma:.1f} mm"
        super().__init__(
            f"line lost at t = {t:.3f} s, s = {s:.3f} m{known}: last seen at t = {last_t:.3f} s, "
            f"s = {last_s:.3f} m, and only {1e3 * limit:.0f} mm may be travelled blind; check the camera, "
            "or allow more with max_gap"
        )


class LineNeverSeenError(LineLostError):
    """The line has not been seen once since the start of the path.

    Args:
        t, s: as for ``LineLostError``.
        limit: distance that may be travelled before the line is seen first [m].
    """

    def __init__(self, t: float, s: float, limit: float) -> None:
        super().__init__(t, s, float("nan"), float("nan"), limit)
        self.args = (
            f"line never seen: nothing until t = {t:.3f} s, s = {s:.3f} m, although {1e3 * limit:.0f} mm were "
            "travelled; check that the line is in the camera's view and near the reference path",
        )
