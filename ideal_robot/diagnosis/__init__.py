"""From a residual to the physical effect behind it."""

from __future__ import annotations

from ideal_robot.diagnosis.choice import Options
from ideal_robot.diagnosis.diagnose import diagnose
from ideal_robot.diagnosis.result import Diagnosis, FoundEffect

__all__ = ["Diagnosis", "FoundEffect", "Options", "diagnose"]
