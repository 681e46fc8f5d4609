"""Quality of an identified model joint by joint: its torque residual, and the uncertainty of its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.identification.idim import Identification
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import Parameter, joined
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.clean import STILL

USABLE, WEAK, UNUSABLE = "usable", "weak", "unusable"

GOOD = 100.0 * 0.1**0.5
"""Share of a torque's standard deviation that holds a tenth of its power [%]: a usable model leaves no more …"""
POOR = 100.0 * 0.5**0.5
"""… and one that leaves half of the power explains no more than it leaves."""
_STATES = 200
"""Random states: a standard deviation over N of them is right within ``1/√(2 N)``, 5 %."""

_TELLS = {
    "gravity": "slow moves through postures that change the load on joint {j}",
    "inertia": "fast reversals of joint {j}, with the joints behind it stretched and folded",
    "friction": "moves of joint {j} in both directions, slow ones and fast ones",
}


@dataclass(frozen=True)
class JointVerdict:
    """Quality of the model of one joint.

    Attributes:
        joint: from 1.
        verdict: ``usable``, ``weak`` or ``unusable``.
        left_percent: residual over torque, standard deviations, the larger one of estimation and validation [%].
        uncertain_percent: standard deviation of the torque by the parameters' covariance, over postures of the whole
            range at the recorded speeds and accelerations, relative to the torque there [%].
        reason: why it is not usable; empty where it is.
        would_tell: a motion that would determine more; empty where none would, or none is needed.
    """

    joint: int
    verdict: str
    left_percent: float
    uncertain_percent: float
    reason: str = ""
    would_tell: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dict(vars(self))


def told(parameter: Parameter) -> bool:
    """Whether a parameter differs from zero by two standard deviations."""
    return parameter.value != 0.0 and parameter.std < 0.5 * abs(parameter.value)


def joint_verdicts(model: Model, result: Identification, robot: Robot) -> tuple[JointVerdict, ...]:
    """The quality of the model for each joint.

    Args:
        model, result: as identified, and the identification behind it.
        robot: the arm, with the range of its joints.
    """
    q = np.concatenate([recording.joints("q") for recording in result.recordings])
    moved = np.ptp(q, axis=0) >= STILL
    counted = np.asarray(model.provenance.get("samples_counted_percent", np.full(model.n, 100.0)))
    # A torque that never changes cannot be judged.
    residual = [np.nan_to_num(joined(predictions).residual_std_percent, nan=np.inf, posinf=np.inf)
                for predictions in (result.estimation, result.validation) if predictions]
    open_ = _uncertain(model, result, robot)
    # Joints share bodies, so an error of one torque affects the parameters of all.
    contrary = ", ".join(dict.fromkeys(finding.kind for finding in result.contradictions))
    return tuple(_verdict(j, residual[0][j], residual[-1][j], {name: share[j] for name, share in open_.items()},
                          "it does not move" if not moved[j] else
                          "its torque channel does not measure it" if counted[j] == 0.0 else
                          f"the recording contradicts the URDF: see the warning {contrary}" if contrary else "")
                 for j in range(model.n))


def _uncertain(model: Model, result: Identification, robot: Robot) -> dict[str, Array]:
    """Standard deviation of the torque by kinds of parameters, ``all`` of them too, over the torque ``(n,)`` [%]."""
    rng, n = np.random.default_rng(5), model.n
    speed, acceleration = _reached(result)
    low, high = np.clip(robot.q_min, -np.pi, np.pi), np.clip(robot.q_max, -np.pi, np.pi)
    q = low + (high - low) * rng.uniform(size=(_STATES, n))
    qd, qdd = (limit * rng.uniform(-1.0, 1.0, (_STATES, n)) for limit in (speed, acceleration))
    columns = model.sensitivity(q, qd, qdd)
    torque = np.sqrt(np.mean(model.inverse_dynamics(q, qd, qdd) ** 2, axis=0))
    kinds = np.array([_kind(name, model) for name in [p.name for p in model.parameters]])
    shares = {}
    for kind in ("all", *_TELLS):
        mine = np.ones(len(kinds), dtype=bool) if kind == "all" else kinds == kind
        part = columns[:, :, mine]
        power = np.einsum("knp,pr,knr->n", part, model.covariance[np.ix_(mine, mine)], part, optimize=True) / _STATES
        shares[kind] = 100.0 * np.sqrt(np.maximum(power, 0.0)) / np.maximum(torque, 1e-12)
    return shares


def _reached(result: Identification) -> tuple[Array, Array]:
    """Speeds and accelerations that the recordings reach, but for one sample in twenty ``(n,)`` each."""
    speeds, accelerations = [], []
    for recording in result.recordings:
        step = max(1, round(0.02 / float(np.median(np.diff(recording.t)))))
        t, q = recording.t[::step], recording.joints("q", slice(None, None, step))
        qd = np.gradient(q, t, axis=0)
        speeds.append(np.quantile(np.abs(qd), 0.95, axis=0))
        accelerations.append(np.quantile(np.abs(np.gradient(qd, t, axis=0)), 0.95, axis=0))
    return np.max(speeds, axis=0), np.max(accelerations, axis=0)


def _kind(name: str, model: Model) -> str:
    if name.startswith("offset_") or name not in model.base.names:
        return "friction"
    return "gravity" if model.base.gravitational[model.base.names.index(name)] else "inertia"


def _verdict(j: int, own: float, unseen: float, uncertain: dict[str, float], broken: str) -> JointVerdict:
    """The verdict on joint ``j``, from its residuals and uncertainties [%], and faults of its recording."""
    residual, wide = max(own, unseen), uncertain["all"]
    moves = _TELLS[max(_TELLS, key=lambda kind: uncertain[kind])].format(j=j + 1)
    values = (float(residual), float(wide))
    if broken:
        return JointVerdict(j + 1, UNUSABLE, *values, broken, _TELLS["friction"].format(j=j + 1)
                            if broken == "it does not move" else "")
    if residual > GOOD:
        verdict = UNUSABLE if residual > POOR else WEAK
        share = f"{residual:.0f} % of its torque is left" if np.isfinite(residual) else "its torque never changes"
        if unseen > 2.0**0.5 * own:
            return JointVerdict(j + 1, verdict, *values, f"{share} in what was not fitted, {own:.0f} % in what was",
                                f"the validation's motion, among those that are fitted; {moves}")
        return JointVerdict(j + 1, verdict, *values, f"{share}; diagnose looks for what the model lacks")
    if wide > GOOD:
        return JointVerdict(j + 1, WEAK, *values, f"beyond the recorded postures its parameters leave {wide:.0f} % of "
                                                  "the torque open", moves)
    return JointVerdict(j + 1, USABLE, *values)
