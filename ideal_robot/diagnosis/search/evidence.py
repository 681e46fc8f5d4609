"""What remains in a residual, and what motion would tell two causes apart."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.diagnosis.statistics.dependence import Dependence, Sieve, terms
from ideal_robot.diagnosis.validation.result import Structure

_TELLS = {
    frozenset({"dead_time", "joint_elasticity"}): "the same path at half and at double speed: a delay grows with the "
                                                  "torque's rate, a soft gear with its second derivative",
    frozenset({"dead_time", "presliding_hysteresis"}): "long strokes with few reversals at high speed: hysteresis "
                                                       "shows after reversals only, a delay everywhere",
    frozenset({"degressive", "stribeck"}): "constant-velocity runs at ten speeds, the slowest below 1 % of the highest",
    frozenset({"degressive", "presliding_hysteresis"}): "reversals at very different accelerations: presliding follows "
                                                        "the distance since the reversal, friction laws the speed",
    frozenset({"presliding_hysteresis", "stribeck"}): "reversals at very different accelerations: presliding follows "
                                                      "the distance since the reversal, friction laws the speed",
    frozenset({"backlash", "presliding_hysteresis"}): "reversals at postures with and without load on the gear",
    frozenset({"cable_spring", "gravity_spring"}): "the joint's whole range: a cable pulls in proportion, a balancer "
                                                   "with the sine",
    frozenset({"thermal_drift", "axis_coupling"}): "the same motion again after an hour's rest: only warming "
                                               "comes back",
    frozenset({"viscous", "degressive"}): "constant-velocity runs over the whole range of speeds",
    frozenset({"load_dependent_friction", "coulomb"}): "the same strokes at postures of high and of low gravity load",
}


def would_tell(name: str, rivals: tuple[str, ...]) -> str:
    """The motion that would tell an effect from its rivals; empty where there are none."""
    found = [_TELLS.get(frozenset({name, rival}), f"a motion with other speeds, ranges and loads ({name} or {rival})")
             for rival in rivals]
    return "; ".join(dict.fromkeys(found))


def ranked_structure(raw: Experiment, data: Data, residual: Array, rng: np.random.Generator,
                     most: int = 3) -> tuple[Structure, ...]:
    """For each channel the strongest dependences of a residual that stand out of their null distribution."""
    signals = raw.decimated_signals()
    sieve = Sieve(signals, data.blocks.edges, rng)
    result = []
    for j, channel in enumerate(raw.channels):
        tests = [sieve.test(residual[:, j], data.use[:, j], j, term)
                 for term in terms(signals, j, False, raw.head)]
        limit = 0.01 / max(len(tests) * len(raw.channels), 1)
        clear: list[Dependence] = [d for d in tests if d.p_value < limit and d.share - d.expected > 0.01]
        clear.sort(key=lambda d: -(d.share - d.expected))
        result += [Structure(channel, tuple(d.names), d.share, d.expected, d.p_value) for d in clear[:most]]
    return tuple(result)
