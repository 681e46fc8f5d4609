"""Samples near standstill: what creeps, or has not yet travelled as far as bristles yield, does not count."""

from __future__ import annotations

import numpy as np

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.motor_torque import torque_regression, with_reversal_width
from ideal_robot.diagnosis.channels.moving import apart_from_reversals
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm


def test_what_has_travelled_no_further_than_bristles_yield_does_not_count() -> None:
    dt, slow, fast = 0.004, 0.004, 1.0
    t = np.arange(0.0, 10.0, dt)
    # Forwards fast, then backwards: slowly in one joint, fast in the other.
    back = t > 5.0
    qd = np.where(back[:, None], [[-slow, -fast]], [[fast, fast]])
    q = np.cumsum(qd, axis=0) * dt
    apart = apart_from_reversals(q, qd, np.ones(q.shape, dtype=bool), 0.12, dt)
    first = [float(t[np.flatnonzero(apart[:, j] & back)[0]]) - 5.0 for j in range(2)]
    # 3 mrad at 4 mrad/s take 0.75 s; at 1 rad/s the filters' memory is longer.
    np.testing.assert_allclose(first, [0.75, 0.12], atol=0.02)
    # A joint that moves over a few milliradians only does not lose all of its samples.
    q = 0.004 * np.sin(1.5 * t)[:, None]
    small = apart_from_reversals(q, np.gradient(q, dt, axis=0), np.ones(q.shape, dtype=bool), 0.12, dt)
    assert small.mean() > 0.7


def creeping() -> Recording:
    """Strokes with rests between in which the axis still creeps; its friction changes sign within 5 mrad/s."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 40.0, 0.004)
    part = t % 4.0
    stroke = np.where(part < 2.0, np.sin(0.5 * np.pi * part) ** 2, 0.0) * np.where((t // 4.0) % 2 == 0, 1.0, -1.0)
    creep = np.where(part >= 2.0, 0.006 * np.sin(np.pi * (part - 2.0) / 2.0), 0.0) * np.sin(0.37 * (t // 4.0) + 1.0)
    qd = 0.55 * stroke + creep + 0.02 * np.sin(1.3 * t) * (part < 2.0)
    q = np.cumsum(qd) * 0.004
    qdd = np.gradient(qd, t)
    # Soft contacts give way in proportion and then slide all at once, no matter which curve a model has there.
    friction = 2.0 * np.clip(qd / 0.008, -1.0, 1.0)
    tau = 0.6 * qdd - 14.7 * np.cos(q) + friction + 1.5 * qd + 0.01 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q=q[:, None], tau=tau[:, None])


def test_an_axis_that_creeps_has_no_friction_over_speed_of_its_own(tmp_path) -> None:
    one, recording = arm(tmp_path), creeping()
    made = torque_regression(recording, one, Model.nominal(one))
    width = np.array([0.004])
    used = with_reversal_width(made, Model.nominal(one), width).use[:, 0]
    speed = np.abs(made.decimated_signals().qd[:, 0])
    assert used.any()
    assert not used[speed < 3.0 * width[0]].any()
    found = diagnose(recording, one)
    assert not {e.fitted.name for e in found.effects} & {"stribeck", "degressive", "thermal_drift"}


def test_a_spike_before_a_hole_is_one_sample(tmp_path) -> None:
    """Brought to an even grid first, it was a triangle as long as the hole, which no median takes out."""
    one, rng = arm(tmp_path), np.random.default_rng(3)
    t = np.arange(0.0, 20.0, 0.001)
    q = 0.6 * np.sin(0.7 * t)[:, None] + 0.3 * np.sin(1.9 * t)[:, None]
    tau = -14.7 * np.cos(q) + 0.03 * rng.normal(size=q.shape)
    spiked = tau.copy()
    spiked[8000] += 60.0
    keep = np.ones(len(t), dtype=bool)
    keep[8001:8008] = False
    made = [torque_regression(Recording.from_arrays(t[keep], q=q[keep], tau=values[keep]), one, Model.nominal(one))
            for values in (tau, spiked)]
    assert np.abs(made[1].measured - made[0].measured).max() < 0.02
