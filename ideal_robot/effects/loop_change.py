"""Changes that an effect makes to the identified loop and to the arm behind it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any


def _place(words: str, default: Any) -> Any:
    return field(default=default, metadata={"place": words})


@dataclass(frozen=True)
class LoopChange:
    """The change that an effect makes to the closed loop; parts that are not given stay unchanged.

    Attributes:
        torque: whether its torque is added to the motor torque.
        friction_curve: whether the effect's torque at constant speed adds to the friction over speed.
        friction_shares: relative changes of all joints' dry friction and of their speed-dependent friction [1].
        friction_per_load: added to the friction per torque at the gear output [1].
        friction_per_driven_load: the same where the motor drives the load, and nothing where the load drives it [1].
        presliding: displacement over which friction builds up after a reversal, at least [rad].
        offset: added to the constant torque [N m].
        rotor_inertia: added to the motor's inertia [kg m²].
        gain: by how much more torque is read than acts, as a share of it [1].
        ripple: order [1/rad], cosine and sine part [N m] of a torque that repeats with the motor's position.
        body: parameters added to the effect's link, to the last one for the whole arm: mass [kg], first moments [kg m],
            inertias [kg m²] as in [G] (5); those left out are zero.
        gravity: added to gravity along the base's x and y axes [m/s²].
        gear_compliance: of the whole gear, replacing the known one [rad/(N m)].
        further_compliance: of the gear in addition to the known one [rad/(N m)].
        from_arm_angle: whether a compliance follows from measured arm angles, which say it better than anything else.
        half_gap: half the backlash of the gear [rad].
        gap_load: load over which the gap is crossed [N m]; 0 where the direction of motion decides.
        uneven: order [1/rad], cosine and sine part [rad] of the arm angle relative to the motor angle.
        zero: true angle less the encoder's [rad].
        geometry: shifts ``a``, ``d`` [m] and turns ``alpha``, ``theta`` [rad] of all that is behind the joint.
        stamps: whether a camera's pictures were taken at other times than are stamped, see ``CameraErrors``.
        points: whether the points that a camera measures are off, see ``CameraErrors``.
        wrench: reading of a force sensor without contact [N, N m].
        give: compliance of tool, sensor and surface beyond the assumed one [m/N].
        nowhere: why it does not act; empty where it does.
    """

    torque: bool = _place("motor torque wanted", False)
    friction_curve: bool = _place("friction over speed", False)
    friction_shares: tuple[float, float] | None = _place("friction over speed", None)
    friction_per_load: float = _place("friction by load", 0.0)
    friction_per_driven_load: float = _place("friction by load that the motor drives", 0.0)
    presliding: float = _place("way over which friction turns", 0.0)
    offset: float = _place("constant motor torque", 0.0)
    rotor_inertia: float = _place("motor's inertia", 0.0)
    gain: float = _place("torque that the drive gives", 0.0)
    ripple: tuple[float, float, float] | None = _place("motor torque over position", None)
    body: tuple[float, ...] = _place("rigid body: gear torque, deflection, motor torque", ())
    gravity: tuple[float, float] | None = _place("rigid body: gear torque, deflection, motor torque", None)
    gear_compliance: float | None = _place("gear's stiffness", None)
    further_compliance: float | None = _place("gear's stiffness", None)
    from_arm_angle: bool = False
    half_gap: float = _place("gear's play: motor ahead of the arm", 0.0)
    gap_load: float = 0.0
    uneven: tuple[float, float, float] | None = _place("gear's transmission: motor angle for an arm angle", None)
    zero: float = _place("rigid body, and joint path by inverse kinematics of the corrected arm", 0.0)
    geometry: tuple[float, float, float, float] | None = _place(
        "joint path by inverse kinematics of the corrected arm", None)
    stamps: bool = _place("follower: time stamps", False)
    points: bool = _place("follower: points that the camera measures", False)
    wrench: tuple[float, ...] = _place("force controller: measured wrench", ())
    give: float = _place("force controller: contact compliance", 0.0)
    nowhere: str = ""

    @property
    def of_gear(self) -> bool:
        """Whether it changes the gear's compliance or backlash."""
        return self.gear_compliance is not None or self.further_compliance is not None or bool(self.half_gap)

    @property
    def places(self) -> tuple[str, ...]:
        """Where it acts, in words; empty where it does not."""
        words = (one.metadata["place"] for one in fields(self)
                 if "place" in one.metadata and getattr(self, one.name) != one.default)
        return tuple(dict.fromkeys(words))
