"""The arm to which a model belongs, and its elastic gears."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import joint_motions
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import model_of

_SAME_PLACE = 0.02
"""What joint placements may differ by [m, or of a direction cosine]: a calibrated URDF is still of the same arm, whose
links are right within millimetres; the joints of another arm are centimetres away."""


@dataclass(frozen=True)
class DescribedArm:
    """The arm as described by its URDF.

    Attributes:
        name: of the robot.
        urdf: text of the URDF; kinematics and nominal inertias.
        urdf_hash: SHA-256 of that file, first 16 hex digits.
    """

    name: str
    urdf: str = field(repr=False)
    urdf_hash: str

    @classmethod
    def of(cls, robot: Robot) -> DescribedArm:
        """The description of a robot."""
        return cls(robot.name, robot.description, robot.urdf_hash)

    @cached_property
    def kinematics(self) -> pin.Model:
        """Pinocchio model of the URDF with its nominal inertias."""
        return model_of(self.urdf, f"the URDF in the model of {self.name}")

    def difference(self, robot: Robot) -> str:
        """How another robot differs: other joints, or joints at other places; empty where it is the same."""
        mine, own = self.kinematics.jointPlacements, robot.pinocchio.jointPlacements
        if self.kinematics.nv != robot.n:
            return f"the model of {self.name} has {self.kinematics.nv} joints, the robot {robot.name} has {robot.n}"
        if len(mine) != len(own):
            return f"in the model of {self.name} others follow its joints than those of {robot.name}"
        elsewhere = [j for j, (one, other) in enumerate(zip(list(mine)[1:], list(own)[1:], strict=True), start=1)
                     if not np.allclose(one.homogeneous, other.homogeneous, atol=_SAME_PLACE)]
        if elsewhere:
            return f"joint {elsewhere[0]} of the model of {self.name} sits elsewhere than that of {robot.name}"
        one, other = (np.column_stack(joint_motions(model)) for model in (self.kinematics, robot.pinocchio))
        otherwise = np.flatnonzero(~np.isclose(one, other).all(axis=1))
        return (f"joint {otherwise[0] + 1} of the model of {self.name} moves otherwise than that of {robot.name}: "
                "about another axis, or with another joint" if len(otherwise) else "")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the model file."""
        return {"name": self.name, "urdf_hash": self.urdf_hash, "joints": int(self.kinematics.nv), "urdf": self.urdf}


@dataclass(frozen=True)
class Gears:
    """Elastic gears of ``n`` joints.

    Attributes:
        stiffness: ``(n,)`` [N m/rad]; ``inf`` where a gear is rigid, NaN where nobody knows.
        damping: ``(n,)`` [N m s/rad]; None where nobody knows.
    """

    stiffness: Array
    damping: Array | None = None

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping"):
            if getattr(self, name) is not None:
                array = np.array(getattr(self, name), dtype=float)
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    @property
    def rigid_if_unknown(self) -> Array:
        """Stiffness, ``inf`` where it is unknown ``(n,)`` [N m/rad]."""
        return np.where(np.isnan(self.stiffness), np.inf, self.stiffness)

    @property
    def compliance(self) -> Array:
        """Compliance, zero where a gear is rigid or its stiffness unknown ``(n,)`` [rad/(N m)]."""
        return np.asarray(1.0 / self.rigid_if_unknown)

    @property
    def known_damping(self) -> Array:
        """Damping, zero where it is unknown ``(n,)`` [N m s/rad]."""
        return np.zeros(len(self.stiffness)) if self.damping is None else np.nan_to_num(self.damping)

    def to_dict(self) -> dict[str, Any]:
        """Values for the model file: an infinite stiffness is ``"inf"``, an unknown one None."""
        return {"stiffness": ["inf" if np.isinf(k) else k for k in self.stiffness], "damping": self.damping}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Gears | None:
        """Reads what ``to_dict`` wrote into a model file; None for a model without a stiffness."""
        stiffness, damping = (None if values.get(key) is None else
                              np.array([np.nan if v is None else v for v in values[key]], dtype=float)
                              for key in ("stiffness", "damping"))
        return None if stiffness is None else cls(stiffness, damping)
