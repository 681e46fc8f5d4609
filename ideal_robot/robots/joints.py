"""Which kind of joint a Pinocchio model has where."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray


def prismatic_joints(model: pin.Model) -> NDArray[np.bool_]:
    """Which joints slide along their axis instead of turning about it ``(n,)``; one degree of freedom each."""
    return np.array([joint.shortname().startswith("JointModelP") for joint in list(model.joints)[1:]], dtype=bool)
