"""How sharply dry friction changes sign at a reversal: a nuisance that no effect may be built on.

Filters, sampling and bearings round the step of the sign; where the model has a hard one, each reversal leaves a
spike that looks like Stribeck or presliding. The width is fitted for each joint, up to a hundredth of its top speed.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy import linalg, optimize

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import direction_of
from ideal_robot.diagnosis.statistics.least_squares import Design, weights_of_channels
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.friction import FrictionModel
from ideal_robot.model.model import Model

_WIDTHS = (0.0003, 0.001, 0.002, 0.004, 0.008)
"""Shares of the top speed that are tried, before the best is refined."""
_SMALL = 4.0
"""Squares over their variance that a width has to take away to replace the one that the position's noise asks for."""


def reversal_widths(problem: Problem, model: Model) -> Array:
    """Speeds over which the sign changes ``(n,)``: those that explain most, else what the position's noise asks for.

    Args:
        problem: the regression about ``model``, and its blocks.
        model: whose friction changes sign.
    """
    design = problem.design()
    weights = weights_of_channels(design, ["W"], None, 0)
    signals = problem.regression.signals
    reversal_width = np.full(signals.n, 1e-12) if signals.v_small is None else np.array(signals.v_small)
    at = model.base.count
    for j, law in enumerate(model.friction.laws):
        first, at = at, at + len(law.coefficients)
        top = float(np.percentile(np.abs(signals.qd[:, j]), 99))
        speeds = [width * top for width in _WIDTHS if width * top > reversal_width[j]]
        if j + 1 in problem.regression.undecided or law.presliding or not speeds:
            continue
        left = partial(_remaining, problem, design, weights, law, j, first)
        remaining = [left(speed) for speed in speeds]
        best = int(np.argmin(remaining))
        if left(reversal_width[j]) - remaining[best] < _SMALL:
            continue
        around = (max(0.5 * speeds[best], reversal_width[j]), min(2.0 * speeds[best], speeds[-1]))
        found = optimize.minimize_scalar(lambda x, of=left: of(np.exp(x)), bounds=np.log(around), method="bounded",
                                         options={"xatol": 0.02, "maxiter": 8})
        reversal_width[j] = float(np.exp(found.x)) if found.fun < remaining[best] else speeds[best]
    return reversal_width


def _remaining(problem: Problem, design: Design, weights: Array, law: FrictionModel, j: int, first: int,
               speed: float) -> float:
    """Weighted squares that remain if friction of joint ``j`` changes sign over ``speed``.

    Its coefficients stand from ``first`` on among the parameters.
    """
    s = problem.regression.signals
    qd, load, q = (values[:, [j]] for values in (s.qd, s.load, s.q))
    change = law.regressor(qd, load, q, np.tanh(qd / speed)) - law.regressor(qd, load, q, direction_of(s, j))
    design.add("reversal_width", problem.prepared(s.on_joint(j + 1, *change[:, 0].T)))
    return _squares(design, weights, first, law.coefficients[:, 0])


def _squares(design: Design, weights: Array, first: int, coefficients: Array) -> float:
    """Weighted squares with the columns from ``first`` on changed by the group ``reversal_width``, refitted.

    The change counts with the coefficients of the model and with what is fitted to them, never on its own.
    """
    keys = ["W", "reversal_width", "y"]
    selecting = design.data.blocks.selecting
    G = np.einsum("c,bcij->ij", weights, design.gram(keys)[selecting])
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
