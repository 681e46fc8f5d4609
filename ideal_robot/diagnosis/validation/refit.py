"""What refitting a given model's parameters alone explains: a cause that looks like them may hide in that.

A spring, moved little, is a shift of masses; a wrong gain is heavier links and more friction. Where parameters have to
move far from what was known for a joint's error to fall, that is no proof that nothing is missing. What the recordings
that the model was made of had left open is no such move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.statistics.prior import torque_left_open
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.refit_explains import MovedParameter, RefitExplains
from ideal_robot.diagnosis.validation.result import ChannelResult
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import parameter_vector

_LARGE = 0.03
"""Share of a torque's spread that refitting has to explain: models of two healthy recordings of one arm differ by up to
1 %."""
_FALLS = 0.7
"""Error after over error before down to which refitting, or an effect, explains little."""
_FAR = 3.0
"""Standard deviations by which a parameter, or the torque that refitting changes, has moved."""
_FLOOR = 0.02
"""A parameter is never known better than this share of itself."""
_ROUNDING = 1e-12
"""Size of a derivative over the largest below which it is rounding."""
_MOST = 4


def explained_by_refitting(model: Model, torque: DomainDiagnosis,
                           channels: Sequence[ChannelResult]) -> tuple[RefitExplains, ...]:
    """Joints whose error falls by refitting alone, and not by an effect that was found.

    Args:
        model: as given.
        torque: the domain of the motor torques, settled.
        channels: its results.
    """
    levels = torque.levels_with_held_parameters()
    regression, estimate = torque.problem.regression, torque.problem.fit(torque.effects)
    left_open = torque_left_open(model, torque.problem)
    result = []
    for j, c in enumerate(channels):
        explained = np.sqrt(max(c.rms_before**2 - c.rms_refit**2, 0.0))
        with_effects = float(levels[-1][j])
        least = max(_LARGE * c.spread, _FAR * left_open[j])
        if (j + 1 in regression.undecided or c.rms_refit > _FALLS * c.rms_before or explained < least
                or (with_effects < _FALLS * c.rms_before and torque.problem.prior is not None)):
            continue
        result.append(RefitExplains(
            j + 1, c.channel, c.rms_before, c.rms_refit,
            _moved(model, estimate.change, regression.W[:, j] * regression.use[:, j, None], 2e-3 * c.spread),
            f"joint {j + 1} uses more of its range, at other speeds and loads"))
    return tuple(result)


def _moved(model: Model, change: Array, W: Array, visible: float) -> tuple[MovedParameter, ...]:
    """Parameters that moved far, those first that change the joint's torque most.

    Args:
        model: as given.
        change: of its parameters ``(P,)``.
        W: derivative of the joint's torque by them ``(N, P)``.
        visible: torque that says nothing [N m]; a parameter is not known better than that either.
    """
    value = parameter_vector(model.base_values, model.friction)
    size = np.sqrt(np.mean(W**2, axis=0))
    # A parameter that moves nothing here may be anything.
    seen = size > _ROUNDING * np.max(size, initial=0.0)
    unseen = np.divide(visible, size, out=np.full_like(size, np.inf), where=seen)
    sigma = np.sqrt(np.diag(model.covariance) + (_FLOOR * value) ** 2 + unseen**2)
    weight = np.abs(change) * size
    far = [int(i) for i in np.argsort(-weight) if abs(change[i]) > _FAR * sigma[i] and weight[i] > 0.0]
    names = model.parameters
    return tuple(MovedParameter(names[i].name, names[i].unit, float(value[i]), float(value[i] + change[i]),
                                float(change[i] / sigma[i])) for i in far[:_MOST])
