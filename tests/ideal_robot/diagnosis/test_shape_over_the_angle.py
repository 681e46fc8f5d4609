"""Torques over one joint's angle: ripples of few and of many periods, an odd shape, and friction of a load."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.search.forward_selection import Only
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm

Torque = Callable[[Array, Array, Array], Array]
"""Torque of a cause from angle, velocity and load ``(N,)``."""


def diagnosed(folder: Path, torque: Torque, middle: float = 0.0, turn: float = 1.0,
              only: Only | None = None) -> Diagnosis:
    """One joint that carries 5 kg at 0.3 m, with friction and one cause.

    Args:
        folder: for the arm's file.
        torque: of the cause.
        middle: of the range [rad].
        turn: half of the range, about [rad].
        only: names and joints that may be looked for.
    """
    t, rng = np.arange(0.0, 40.0, 0.004), np.random.default_rng(3)
    a, b = rng.uniform(0.5, 0.9, 3) / [1.0, 2.0, 3.0], rng.uniform(0.0, 6.0, 3)
    w = 2.0 * np.pi / 10.0
    q = middle + turn * sum(a[k] * np.sin((k + 1) * w * t + b[k]) for k in range(3))
    qd = np.gradient(q, t)
    load = 0.55 * np.gradient(qd, t) - 5.0 * 9.81 * 0.3 * np.cos(q)
    tau = load + 2.0 * np.tanh(qd / 2e-3) + 1.5 * qd + torque(q, qd, load) + 0.03 * rng.normal(size=len(t))
    return diagnose(Recording.from_arrays(t, q=q[:, None], tau=tau[:, None]), arm(folder), only=only)


@pytest.mark.parametrize("order", [pytest.param(11.0, id="hardly three periods in the range"),
                                   pytest.param(40.0, id="ten"),
                                   pytest.param(170.0, id="seen in the slower part of the motion alone")])
def test_a_ripple_is_found_with_its_order(order: float, tmp_path: Path) -> None:
    found = diagnosed(tmp_path, lambda q, qd, load: 0.6 * np.cos(order * q) + 0.08 * np.cos(2.0 * order * q))
    # Its double is a ripple of its own where it shows.
    assert {effect.fitted.name for effect in found.effects} == {"torque_ripple"}
    assert not found.unknown
    size, _, said = found.effects[0].fitted.parameters
    assert said.value == pytest.approx(order, rel=0.01)
    assert size.value == pytest.approx(0.6, rel=0.1)


def test_what_a_curve_leaves_of_a_narrow_bump_is_no_ripple(tmp_path: Path) -> None:
    def bump(q: Array, qd: Array, load: Array) -> Array:
        x = (q - 0.1) / 0.12
        return np.asarray(1.5 * np.exp(-(x**2)) * (1.0 + 1.5 * np.tanh(x)))

    found = diagnosed(tmp_path, bump)
    assert found.verdict == "unknown"
    assert not found.effects
    assert {curve.depends_on for curve in found.unknown} == {("q_1",)}


def test_friction_of_a_load_is_found_where_weight_and_a_constant_torque_are_hardly_told_apart(tmp_path: Path) -> None:
    # The load changes sign within half a radian, in which a constant torque looks like weight. The law of load that is
    # driven is the same one of a single joint.
    found = diagnosed(tmp_path, lambda q, qd, load: 0.3 * np.abs(load) * np.sign(qd), middle=1.5, turn=0.25,
                      only=(("load_dependent_friction", 1),))
    assert [effect.fitted.name for effect in found.effects] == ["load_dependent_friction"]
    assert found.effects[0].fitted.coefficients[0] == pytest.approx(0.3, rel=0.1)
