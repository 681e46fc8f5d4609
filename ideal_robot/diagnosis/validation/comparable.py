"""Whether another recording can judge: what the baseline of the first predicts worse than its mean decides nothing."""

from __future__ import annotations

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.validation.domain_diagnosis import rms
from ideal_robot.signals.recording import Recording


def unlike(case: Case, found: Findings, validate: Recording) -> tuple[str, ...]:
    """Channels of the validation recording that the first one's parameters miss by more than they vary.

    Short motions leave parameters open, above all in amperes, where each joint has its own. An error of many times the
    torque then falls by whatever moves these parameters, which no cause explains.

    Args:
        case: what is asked.
        found: about the recording, nothing fitted yet.
        validate: the other recording.
    """
    problem = found.problem
    other = case.torque_regression(validate, found.start, cutoff=problem.regression.filtered.cutoff)
    error = rms(problem.fit().residual(other, []), other.use)
    mean = (other.measured * other.use).sum(axis=0) / other.use.sum(axis=0).clip(min=1)
    spread = rms(other.measured - mean, other.use)
    still = {*problem.regression.undecided, *other.undecided}
    return tuple(name for j, name in enumerate(other.channels) if j + 1 not in still and error[j] > spread[j])
