"""What is wanted of a contact, the phases of a motion in contact, and the prior of the surface."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from ideal_robot.errors import InputError
from planning.line.deviation_model import PathDeviation
from planning.path.reference import ReferencePath

FORCE_ERRORS = (0.3, 0.002)
"""Standard deviations of what is estimated of the force sensor on the way: relative error of E, and the time constant
of damping or stamps [s]."""
STAMPS, DAMPING = 5e-4, 10.0
"""Standard deviations of what is left wrong in the sensor's stamps [s], and of a tip's damping [N s/m]."""

NOTICED = 0.08
"""Time from a touch until the arm answers it: the sensor's, two cycles, and the arm's own [s]."""

SLOPE, UNSEEN = 0.15, 0.15
"""Slope of a surface before it was felt, and the time until it is known under a tip that has begun to move [s]."""
TOLERATED = 2.5
"""Force that may go wrong meanwhile without a gentler start, which costs more than it gains on soft contacts [N]."""
BEGUN = 1.0
"""Force that may go wrong meanwhile where the start is made gentler [N]."""
GENTLEST = 0.2
"""Jerk with which a travel begins at least [m/s³]."""


class Phase(Enum):
    """Phases of a motion in contact, in their order."""

    APPROACH = "approach"
    SETTLE = "settle"
    TRAVEL = "travel"
    LIFT = "lift"
    DONE = "done"


@dataclass(frozen=True)
class ContactSettings:
    """What is wanted of the contact, and what errors its sensor is assumed to have.

    Attributes:
        force: F_r, wanted normal force [N].
        elasticity: E that is assumed, from calibration [N/m].
        descent: largest speed of the approach [m/s].
        plunge: force that may have built up when the touch has been noticed and answered [N].
        reach: distance the approach may take before there has to be contact [m].
        touch: force from which there is contact [N].
        settle: time for which the force has to be near F_r before the travel begins [s].
        clearance: how far the tip is lifted at the end [m].
        noise: standard deviation of a force sample [N].
        position_noise: standard deviation common to the samples of a cycle: position, what is not modelled [m].
        frozen: cycles from now on that a new sample does not change any more.
        cutoff: frequency up to which the estimate is followed [Hz].
        correction: acceleration that corrections may have [m/s²].
    """

    force: float = 20.0
    elasticity: float = 5000.0
    descent: float = 0.03
    plunge: float = 10.0
    reach: float = 0.05
    touch: float = 3.0
    settle: float = 0.15
    clearance: float = 0.01
    noise: float = 0.3
    position_noise: float = 3e-5
    frozen: int = 1
    cutoff: float = 25.0
    correction: float = 4.0

    def __post_init__(self) -> None:
        for key in ("force", "elasticity", "descent", "reach", "touch", "plunge", "cutoff", "correction", "clearance"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))

    @property
    def approach(self) -> float:
        """Speed of the approach [m/s]: the stiffer the contact, the slower."""
        return min(self.descent, self.plunge / (self.elasticity * NOTICED))

    @property
    def lateness(self) -> float:
        """Standard deviation of the time by which damping and stamps shift a force [s].

        The stiffer the contact, the less its damping counts. With more than it can be, the forecast takes the lie of a
        wave for it.
        """
        return min(FORCE_ERRORS[1], float(np.hypot(STAMPS, DAMPING / self.elasticity)))

    def jerk(self, acceleration: float, jerk: float) -> float:
        """Jerk of a travel [m/s³]: a tip at rest feels no slope, so the stiffer the contact, the gentler the start.

        Args:
            acceleration: of the travel [m/s²].
            jerk: where the contact is soft enough for that acceleration from the start [m/s³].
        """
        if 0.5 * acceleration * UNSEEN**2 * SLOPE * self.elasticity <= TOLERATED:
            return jerk
        return min(jerk, max(GENTLEST, 6.0 * BEGUN / (UNSEEN**3 * SLOPE * self.elasticity)))


def surface_model(
    reference: ReferencePath, ahead: float, *, shape: float = 0.006, length: float = 0.08
) -> PathDeviation:
    """Prior of a surface: near its nominal plane, and smooth.

    Args:
        reference: the path along the nominal surface.
        ahead: how far in front of the arm the deviation is needed [m].
        shape: standard deviation of the surface's shape [m].
        length: distance over which the shape becomes another [m].
    """
    return PathDeviation(
        reference,
        directions=2,
        ahead=ahead,
        behind=0.04,
        knot=0.02,
        displacement=0.02,
        rotation=0.05,
        shape=shape,
        length=length,
    )
