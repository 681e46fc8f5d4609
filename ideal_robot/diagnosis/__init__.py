"""From a residual to the physical effect behind it."""

from __future__ import annotations

from ideal_robot.diagnosis.diagnose import diagnose
from ideal_robot.diagnosis.next_motion.plan import DiagnosisPlan, plan_diagnosis
from ideal_robot.diagnosis.next_motion.questions import Open, open_questions, read_questions
from ideal_robot.diagnosis.validation.result import Diagnosis, FoundEffect

__all__ = ["Diagnosis", "DiagnosisPlan", "FoundEffect", "Open", "diagnose", "open_questions",
           "plan_diagnosis", "read_questions"]
