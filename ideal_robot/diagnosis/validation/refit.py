"""What refitting a given model's parameters alone explains: a cause that looks like them may hide in that.

A spring, moved little, is a shift of masses; a wrong gain is heavier links and more friction. Where parameters have to
move far from what was known for a joint's error to fall, that is no proof that nothing is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.result import ChannelResult
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import parameter_vector

_LARGE = 0.03
"""Share of a torque's spread that refitting has to explain: models of two healthy recordings of one arm differ by up to
1 %."""
_FALLS = 0.7
"""Error after over error before down to which refitting, or an effect, explains little."""
_FAR = 3.0
"""Standard deviations by which a parameter has moved."""
_FLOOR = 0.02
"""A parameter is never known better than this share of itself."""
_MOST = 4


@dataclass(frozen=True)
class MovedParameter:
    """A parameter of the given model that refitting has moved.

    Attributes:
        name, unit: e.g. ``Fc_2``.
        value, refitted: before and after.
        sigmas: the change over the standard deviation of before.
    """

    name: str
    unit: str
    value: float
    refitted: float
    sigmas: float


@dataclass(frozen=True)
class RefitExplains:
    """A joint whose error falls by refitting the given model alone.

    Attributes:
        joint: from 1.
        channel: its torque.
        rms_before, rms_refit: held-out error of the model as given, and refitted.
        moved: the parameters that moved far and count most for it.
        would_tell: what motion would decide.
    """

    joint: int
    channel: str
    rms_before: float
    rms_refit: float
    moved: tuple[MovedParameter, ...]
    would_tell: str

    @property
    def text(self) -> str:
        """In a sentence."""
        moved = ", ".join(f"{p.name} from {p.value:.3g} to {p.refitted:.3g} {p.unit} ({p.sigmas:+.0f} σ)"
                          for p in self.moved) or "none of them far"
        return (f"the error of {self.channel} falls from {self.rms_before:.3g} to {self.rms_refit:.3g} by refitting "
                f"the given model alone (moved: {moved}). Whether the arm has changed or a cause is missing, this "
                f"recording does not tell; a motion would in which {self.would_tell}")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"joint": self.joint, "channel": self.channel, "rms_before": self.rms_before,
                "rms_refit": self.rms_refit, "would_tell": self.would_tell,
                "moved": [{"name": p.name, "unit": p.unit, "value": p.value, "refitted": p.refitted,
                           "sigmas": p.sigmas} for p in self.moved]}


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
    result = []
    for j, c in enumerate(channels):
        explained = np.sqrt(max(c.rms_before**2 - c.rms_refit**2, 0.0))
        with_effects = float(levels[-1][j])
        if (j + 1 in regression.undecided or c.rms_refit > _FALLS * c.rms_before or explained < _LARGE * c.spread
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
    sigma = np.sqrt(np.diag(model.covariance) + (_FLOOR * value) ** 2 + (visible / np.maximum(size, 1e-300)) ** 2)
    weight = np.abs(change) * size
    far = [int(i) for i in np.argsort(-weight) if abs(change[i]) > _FAR * sigma[i] and weight[i] > 0.0]
    names = model.parameters
    return tuple(MovedParameter(names[i].name, names[i].unit, float(value[i]), float(value[i] + change[i]),
                                float(change[i] / sigma[i])) for i in far[:_MOST])
