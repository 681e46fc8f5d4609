"""Parameters of a model that are not bent by a lag of all torques, where no search was free to name it."""

from __future__ import annotations

from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.estimate import Estimate
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.effects.drive import TorqueFilter

_ITERATIONS = 3
"""Fits after which the chord of the delay has become the delay."""
_CLEAR = 3.0
"""Standard deviations by which the lag has to differ from none."""
_START = 1e-3
"""Chord to begin with [s]."""


def beside_lag(torque: DomainDiagnosis) -> Estimate:
    """The fit of everything together, beside a lag of all torques where there clearly is one.

    A late torque turns inertia into friction, by as much as the motion is fast: a model that holds that is wrong in
    every other motion. The lag belongs to the recording, not to the arm, so only the parameters are of use.

    Args:
        torque: the domain of the motor torques, settled.
    """
    effects, signals = torque.effects, torque.problem.regression.signals
    lag = TorqueFilter()
    if not lag.usable(signals, 0) or any(c.effect.name == lag.name for c in effects):
        return torque.final
    candidate = Candidate(lag, 0, (_START,))
    for _ in range(_ITERATIONS):
        found = torque.problem.on_all_blocks().fit([*effects, candidate], uncertainty=True)
        theta = lag.consistent_theta(found.coefficients[-1], candidate.theta)
        candidate = Candidate(lag, 0, theta)
    own, std = found.coefficients[-1], found.std[-1]
    if not abs(own[0]) > _CLEAR * std[0] or not lag.plausible(own, candidate.theta, signals, 0):
        return torque.final
    return found
