"""The surplus of friction near standstill in each of its two forms: with its numbers and nothing beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm


@pytest.mark.parametrize(("exponent", "channel"), [(1.0, "tau_1"), (2.0, "tau_bell_1")])
def test_either_form_is_one_name_with_its_numbers(tmp_path: Path, exponent: float, channel: str) -> None:
    one, rng = arm(tmp_path), np.random.default_rng(3)
    t = np.arange(0.0, 40.0, 0.004)
    q = 0.6 * np.sin(0.7 * t)[:, None] + 0.3 * np.sin(1.9 * t)[:, None]
    qd, qdd = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    tau = 0.6 * qdd - 14.7 * np.cos(q) + 2.0 * np.tanh(qd / 2e-3) + 1.5 * qd + 0.03 * rng.normal(size=q.shape)
    tau = tau + 1.2 * np.tanh(qd / 2e-3) * np.exp(-((np.abs(qd) / 0.2) ** exponent))
    found = diagnose(Recording.from_arrays(t, q=q, tau=tau), one)
    assert [(e.fitted.name, e.fitted.channel) for e in found.effects] == [("stribeck", channel)]
    surplus, speed = (p.value for p in found.effects[0].fitted.parameters)
    assert surplus == pytest.approx(1.2, rel=0.1)
    assert speed == pytest.approx(0.2, rel=0.1)
