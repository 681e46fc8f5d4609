"""Recordings of MuJoCo without any noise, against the model that made them, or one without a cause that they have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.prior import SAME
from ideal_robot.model.mjcf import arm_of_mjcf
from ideal_robot.signals.recording import Recording

mujoco = pytest.importorskip("mujoco", reason="needs the optional package mujoco")

STEP = 0.001
ARM = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body pos="0 0 0.3"><joint name="a" axis="0 0 1" damping="0.3" armature="0.2" frictionloss="1.2"/>
<inertial pos="0 0 0.1" mass="4" diaginertia="0.03 0.03 0.02"/>
<body pos="0 0 0.2"><joint name="b" axis="0 1 0" damping="0.2" armature="0.2" frictionloss="1.0"/>
<inertial pos="0.02 0 0.2" mass="3" diaginertia="0.03 0.03 0.01"/>
<body pos="0 0 0.4"><joint name="c" axis="0 1 0" damping="0.1" armature="0.07" frictionloss="0.5"/>
<inertial pos="0.15 0.02 0" mass="1.5" diaginertia="0.002 0.008 0.008"/>
<site name="tool" pos="0.3 0 0"/></body></body></body></worldbody></mujoco>"""


def payload(spec: Any) -> None:
    spec.joint("c").parent.add_body(pos=[0.3, 0.0, 0.0]).add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0.0, 0.0], mass=0.8)


def friction(spec: Any) -> None:
    spec.joint("b").frictionloss = 2.5


def spring(spec: Any) -> None:
    # Newer versions hold a polynomial.
    stiffness = spec.joint("c").stiffness
    spec.joint("c").stiffness = [8.0, *np.zeros(len(stiffness) - 1)] if np.ndim(stiffness) else 8.0


def recorded(hidden: Callable[[Any], None] | None, seconds: float = 16.0) -> Recording:
    """The arm under PD control along random sines, as MuJoCo moves it, to the last digit."""
    spec = mujoco.MjSpec.from_string(ARM)
    if hidden is not None:
        hidden(spec)
    model, rng, t = spec.compile(), np.random.default_rng(4), np.arange(0.0, seconds, STEP)
    data, (size, rate, phase) = mujoco.MjData(model), (
        rng.uniform(least, most, (3, 3)) for least, most in ((0.25, 0.4), (0.6, 3.0), (0.0, 6.0)))
    wanted = np.array([0.0, 0.4, 0.6]) + np.sum(size * np.sin(t[:, None, None] * rate + phase), axis=1)
    data.qpos[:], rows = wanted[0], []
    for at in wanted:
        tau = 2000.0 * (at - data.qpos) - [90.0, 90.0, 40.0] * data.qvel
        rows.append((data.qpos.copy(), tau))
        data.qfrc_applied[:] = tau
        mujoco.mj_step(model, data)
    q, tau = (np.array(values) for values in zip(*rows, strict=True))
    return Recording.from_arrays(t, q=q, tau=tau)


@pytest.mark.parametrize(("hidden", "named", "true"), [
    (None, [], 0.0), (payload, [("payload", 0)], 0.8),
    pytest.param(friction, [("coulomb", 2)], 1.5, marks=pytest.mark.slow),
    pytest.param(spring, [("cable_spring", 3)], 8.0, marks=pytest.mark.slow)])
def test_what_is_hidden_in_a_mujoco_model_is_named_and_nothing_is_missing_in_its_own_recording(
        hidden: Callable[[Any], None] | None, named: list[tuple[str, int]], true: float, tmp_path: Path) -> None:
    """The parameters took everything, and effects of a thousandth of a torque were named in its own recording."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    arm = arm_of_mjcf(path)
    answer = diagnose(recorded(hidden), arm.robot, model=arm.model)
    assert [(effect.fitted.name, effect.fitted.joint) for effect in answer.effects] == named
    assert not answer.unknown
    assert answer.verdict == ("effects" if named else "none")
    assert answer.taken_for == SAME
    for effect in answer.effects:
        size = effect.fitted.parameters[0]
        assert size.value == pytest.approx(true, abs=max(3.0 * size.std, 0.05 * true))
