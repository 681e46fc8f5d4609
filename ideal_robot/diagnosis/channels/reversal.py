"""How sharply dry friction changes sign at a reversal: a nuisance that no effect may be built on.

Filters, sampling and bearings round the step of the sign; where the model has a hard one, each reversal leaves a
spike that looks like Stribeck or presliding. The width is fitted for each joint, up to a hundredth of its top speed.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy import linalg, optimize

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment, direction_of
from ideal_robot.diagnosis.search.candidates import prepared
from ideal_robot.diagnosis.statistics.block_regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.friction.base import FrictionModel
from ideal_robot.model.model import Model

_WIDTHS = (0.0003, 0.001, 0.002, 0.004, 0.008)
"""Shares of the top speed that are tried, before the best is refined."""
_SMALL = 4.0
"""Squares over their variance that a width has to win to replace the one that the noise of the position asks for."""


def fitted_blur(experiment: Experiment, data: Data, model: Model) -> Array:
    """Speeds over which the sign changes ``(n,)``: those that explain most, else what the position's noise asks for.

    Args:
        experiment: the regression about ``model``.
        data: its blocks.
        model: whose friction changes sign.
    """
    design = Design(data)
    weights = channel_weights(Fit(design, ["W"], np.ones(data.c)).squares(), data.count)
    signals = experiment.signals
    blur = np.full(signals.n, 1e-12) if signals.v_small is None else np.array(signals.v_small)
    at = model.base.count
    for j, law in enumerate(model.friction.laws):
        first, at = at, at + len(law.coefficients)
        top = float(np.percentile(np.abs(signals.qd[:, j]), 99))
        speeds = [width * top for width in _WIDTHS if width * top > blur[j]]
        if j + 1 in experiment.undecided or law.presliding or not speeds:
            continue
        left = partial(_remaining, experiment, design, weights, law, j, first)
        remaining = [left(speed) for speed in speeds]
        best = int(np.argmin(remaining))
        if left(blur[j]) - remaining[best] < _SMALL:
            continue
        around = (max(0.5 * speeds[best], blur[j]), min(2.0 * speeds[best], speeds[-1]))
        found = optimize.minimize_scalar(lambda x, of=left: of(np.exp(x)), bounds=np.log(around), method="bounded",
                                         options={"xatol": 0.02, "maxiter": 8})
        blur[j] = float(np.exp(found.x)) if found.fun < remaining[best] else speeds[best]
    return blur


def _remaining(experiment: Experiment, design: Design, weights: Array, law: FrictionModel, j: int, first: int,
               speed: float) -> float:
    """Weighted squares that remain if friction of joint ``j`` changes sign over ``speed``.

    Args:
        first: where its coefficients stand among the parameters.
    """
    s = experiment.signals
    qd, load, q = (values[:, [j]] for values in (s.qd, s.load, s.q))
    change = law.regressor(qd, load, q, np.tanh(qd / speed)) - law.regressor(qd, load, q, direction_of(s, j))
    design.add("blur", prepared(experiment, design.data, s.on_joint(j + 1, *change[:, 0].T)))
    return _squares(design, weights, first, law.coefficients[:, 0])


def _squares(design: Design, weights: Array, first: int, coefficients: Array) -> float:
    """Weighted squares with the columns from ``first`` on changed by the group ``blur``, refitted.

    The change counts with the coefficients of the model and with what is fitted to them, never on its own.
    """
    keys = ["W", "blur", "y"]
    selecting = design.data.blocks.fold >= 0
    G = np.einsum("c,bcij->ij", weights, design.gram(keys, keys)[selecting])
    m = len(coefficients)
    P = G.shape[0] - m - 1
    M = np.zeros((len(G), P + 1))
    M[:P, :P] = np.eye(P)
    M[P : P + m, first : first + m] = np.eye(m)
    M[P : P + m, P] = -coefficients
    M[-1, P] = 1.0
    G = M.T @ G @ M
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G)[:P], 1e-300))
    A, b = G[:P, :P] * np.outer(scale, scale), G[:P, P] * scale
    return float(G[P, P] - b @ linalg.pinvh(A, rtol=1e-11) @ b)
