"""From a residual to the physical effect behind it."""

from __future__ import annotations

from ideal_robot.diagnosis.diagnose import diagnose
from ideal_robot.diagnosis.search.choice import Options
from ideal_robot.diagnosis.validation.result import Diagnosis, FoundEffect

__all__ = ["Diagnosis", "FoundEffect", "Options", "diagnose"]
