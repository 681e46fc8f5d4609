"""What a model expects of a recording, beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.results import Summarised, listed


@dataclass(frozen=True, repr=False)
class Prediction(Summarised):
    """Predicted and measured torque of a recording, both through the same decimation filter.

    Attributes:
        t: ``(M,)`` [s].
        tau: predicted motor torque ``(M, n)`` [N m].
        std: standard deviation of a measured value about it: parameters and noise together ``(M, n)`` [N m].
        measured: measured motor torque ``(M, n)`` [N m].
    """

    t: Array
    tau: Array
    std: Array
    measured: Array

    def summary(self) -> list[tuple[str, str]]:
        """How far the model is from what was measured."""
        samples, joints = self.tau.shape
        return [("torques", f"{joints} joints, {samples} samples"),
                ("relative error", listed(self.relative_error_percent, "%"))]

    @property
    def relative_error_percent(self) -> Array:
        """``100 ‖y - ŷ‖ / ‖y‖`` per joint ``(n,)``; NaN for a joint without torque."""
        norm = np.linalg.norm(self.measured, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.linalg.norm(self.measured - self.tau, axis=0) / norm)

    @property
    def residual_std_percent(self) -> Array:
        """Standard deviation of the residual over that of the torque per joint ``(n,)`` [%]."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.std(self.measured - self.tau, axis=0) / np.std(self.measured, axis=0))
