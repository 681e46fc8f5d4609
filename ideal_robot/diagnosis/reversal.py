"""How sharply dry friction changes sign at a reversal: a nuisance that no effect may be built on.

Filters, sampling and bearings round the step of the sign; where the model has a hard one, each reversal leaves a
spike that looks like Stribeck or presliding. The width is fitted for each joint, up to a hundredth of its top speed.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.diagnosis.candidates import prepared
from ideal_robot.diagnosis.experiment import Experiment
from ideal_robot.diagnosis.gram import Data
from ideal_robot.diagnosis.regression import Design, Fit, channel_weights
from ideal_robot.interface import Array

_WIDTHS = (0.0003, 0.001, 0.002, 0.004, 0.008)
"""Shares of the top speed that are tried."""


def fitted_blur(experiment: Experiment, data: Data, prior: Array | None = None) -> Array:
    """Speeds over which the sign changes ``(n,)``: those that explain most, else what the position's noise asks for."""
    design = Design(data)
    weights = channel_weights(Fit(design, ["W"], np.ones(data.c), prior).squares(), data.count)
    fit = Fit(design, ["W"], weights, prior)
    signals = experiment.signals
    sharp = np.zeros(signals.n) if signals.v_small is None else np.array(signals.v_small)
    blur = sharp.copy()
    for j in range(signals.n):
        if j + 1 in experiment.undecided:
            continue
        qd = signals.qd[:, j]
        top = float(np.percentile(np.abs(qd), 99))
        best = 4.0
        for width in _WIDTHS:
            if width * top <= sharp[j]:
                continue
            change = np.tanh(qd / (width * top)) - np.tanh(qd / max(sharp[j], 1e-12))
            design.add("blur", prepared(experiment, data, signals.on_joint(j + 1, change)))
            gain = fit.gain("blur")[0]
            if gain > best:
                best, blur[j] = gain, width * top
    return blur
