"""What an effect changes in the simulated drive of its joint."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveChange:
    """Changes of the parameters that the simulation of the closed loop has for one joint; what is not given stays.

    Attributes:
        friction_curve: whether the effect's torque at constant speed adds to the friction over speed.
        friction_per_load: added to the friction per torque at the gear output [1].
        presliding: displacement over which friction builds up after a reversal, at least [rad].
        offset: added to the constant torque [N m].
        rotor_inertia: added to the motor's inertia [kg m²].
        gear_compliance: of the whole gear, in place of what was known [rad/(N m)].
        further_compliance: of the gear beyond what was known [rad/(N m)].
        from_arm_angle: whether a compliance follows from measured arm angles, which say it better than anything else.
        ripple: order [1/rad], cosine and sine part [N m] of a torque that repeats with the motor's position.
    """

    friction_curve: bool = False
    friction_per_load: float = 0.0
    presliding: float = 0.0
    offset: float = 0.0
    rotor_inertia: float = 0.0
    gear_compliance: float | None = None
    further_compliance: float | None = None
    from_arm_angle: bool = False
    ripple: tuple[float, float, float] | None = None
