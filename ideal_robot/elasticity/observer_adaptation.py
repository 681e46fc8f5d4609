r"""Adapting the observer with an external measurement of few degrees of freedom, off line ([L] 2.1, 3.3).

A measuring device that shows two of six degrees of freedom, and only afterwards, does not give the arm angles. It does
say which gears are softer than believed: with the gear torques :math:`\tau_g = k (q - q_a)` of the observer, a relative
error :math:`\beta_j` of the compliance of joint j displaces the measured components by

.. math:: z - \hat z = -\sum_j J_{zj}\, \frac{\tau_{g,j}}{k_j}\, \beta_j + z_0

which is linear in the errors of all joints. A prior keeps those that the measurement does not show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

COMPONENTS = ("x", "y", "z")


@dataclass(frozen=True)
class AdaptedObserver:
    """The model with adapted stiffness, and what it yields on the recording.

    Attributes:
        model: with the stiffness found.
        std_percent: of each joint's stiffness ``(n,)``; near the prior's where the measurement shows nothing of it.
        q_a: arm angles on the recording ``(N, n)`` [rad], every cycle.
        residual_before, residual_after: RMS of the measured components against the prediction [m].
    """

    model: Model
    std_percent: Array
    q_a: Array
    residual_before: float
    residual_after: float


def adapt_observer(recording: Recording, robot: Robot, model: Model, *, prior_percent: float = 25.0,
                   sigma: float = 5e-5, iterations: int = 3) -> AdaptedObserver:
    """Adapts the stiffness to measured TCP components ([L] 2.1, 3.3).

    For scripts that have a device with fewer than six degrees of freedom beside the arm; no scene uses it.

    Args:
        recording: ``q_i`` and any of ``x``, ``y``, ``z`` [m] measured outside; NaN where nothing was measured.
        robot: kinematics.
        model: with a stiffness to begin with.
        prior_percent: how wrong that stiffness may be, standard deviation [%].
        sigma: of the measured components, what the model does not explain included [m].
        iterations: the observer is run again with the stiffness found.

    Raises:
        InputError: no component was measured, the model has no stiffness or is of another arm.
    """
    model.require_arm(robot)
    measured = [name for name in COMPONENTS if name in recording.columns]
    if not measured:
        raise InputError("at least one of x, y, z has to be measured", file=recording.source, field="x")
    if model.stiffness is None:
        raise InputError("the model has no stiffness to begin with", field="stiffness")
    every = max(1, round(robot.t_ipo / float(np.median(np.diff(recording.t)))))
    q = recording.joints("q")[::every]
    z = np.column_stack([recording.columns[name][::every] for name in measured])
    rows = [COMPONENTS.index(name) for name in measured]
    seen = np.all(np.isfinite(z), axis=1)
    n, before = robot.n, float("nan")
    stiffness, start = np.array(model.stiffness), np.array(model.stiffness)
    for step in range(iterations + 1):
        q_a = ArmObserver(replace(model, stiffness=stiffness), robot.t_ipo).angles(q)
        position, jacobian = _kinematics(robot, q_a[seen], rows)
        residual = z[seen] - position
        left = float(np.sqrt(np.mean((residual - residual.mean(axis=0)) ** 2)))
        before = left if step == 0 else before
        if step == iterations:
            break
        # One constant per component: where the device stands is not known.
        shift = -jacobian * (q[seen] - q_a[seen])[:, None, :]
        W = (shift - shift.mean(axis=0)).reshape(-1, n) / sigma
        Y = (residual - residual.mean(axis=0)).reshape(-1) / sigma
        # β counts from the stiffness the model came with, so that the prior stays where it was.
        now = start / stiffness - 1.0
        information = W.T @ W + np.eye(n) / (0.01 * prior_percent) ** 2
        change = np.linalg.solve(information, W.T @ Y - now / (0.01 * prior_percent) ** 2)
        stiffness = stiffness / np.clip(1.0 + change, 0.5, 2.0)
    std = 100 * np.sqrt(np.diag(np.linalg.inv(information)))
    return AdaptedObserver(replace(model, stiffness=stiffness), std, q_a, before, left)


def _kinematics(robot: Robot, q: Array, rows: list[int]) -> tuple[Array, Array]:
    """Measured components of the TCP ``(N, c)`` [m] and their Jacobians ``(N, c, n)``."""
    data = robot.pinocchio.createData()
    position, jacobian = np.empty((len(q), len(rows))), np.empty((len(q), len(rows), robot.n))
    for i, q_i in enumerate(q):
        full = pin.computeFrameJacobian(robot.pinocchio, data, q_i, robot.tool_id, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(robot.pinocchio, data, q_i)
        position[i] = data.oMf[robot.tool_id].translation[rows]
        jacobian[i] = full[rows]
    return position, jacobian
