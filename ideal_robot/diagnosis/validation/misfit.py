"""Standard deviations that hold what the model class leaves, not only what scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.estimate import Estimate
from ideal_robot.diagnosis.statistics.problem import Problem


def with_misfit(problem: Problem, effects: Sequence[Candidate], found: Estimate) -> Estimate:
    """An estimate whose standard deviations hold the misfit, and what the numbers differ by in half of the band.

    Vibrations, filters and the way friction goes through standstill bend numbers in the same way in every block of
    time, so no scatter over blocks shows it; but they fade towards slow motion, and so does what they do to a number.
    A law of speed errs by no more than it errs in the lower half and differs from there: where vibrations are most of
    what is left, that is far less than all that is left could bend it by.

    Args:
        problem: in which the effects were fitted.
        effects: of the fit, in its order.
        found: the fit to all blocks, with uncertainty.
    """
    if not effects:
        return found
    whole = problem.on_all_blocks()
    wide = whole.fit(effects, uncertainty=True, misfit=True)
    slow = whole.slow().fit(effects, uncertainty=True, misfit=True)
    hidden = [candidate.effect.of_slow_motion for candidate in effects]
    own_std, own_theta = ([np.minimum(here, there) if less else here for here, there, less in
                           zip(*stds, hidden, strict=True)]
                          for stds in ((wide.std, slow.std), (wide.theta_std, slow.theta_std)))
    std = [np.hypot(own, there - here) for own, here, there in
           zip(own_std, found.coefficients, slow.coefficients, strict=True)]
    theta_std = [np.where(own > 0.0, np.hypot(own, there - here), own) for own, here, there in
                 zip(own_theta, wide.theta_step, slow.theta_step, strict=True)]
    return replace(found, std=tuple(std), theta_std=tuple(theta_std))
