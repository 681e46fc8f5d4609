"""Friction over speed where an arm vibrates: its share is asked for in the lower half of the band as well."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ideal_robot.diagnosis import diagnose
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm


def vibrating(surplus: float) -> Recording:
    """One joint with a surplus of friction [N m] that falls with speed, and what another cause shakes it by at 9 Hz."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 40.0, 0.004)
    q = sum(a * np.sin(w * t + p) for a, w, p in zip((0.6, 0.3, 0.15), (0.7, 1.9, 3.1), rng.uniform(0, 6, 3),
                                                      strict=True))
    qd, qdd = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    band = signal.butter(2, (8.0, 10.0), "bandpass", fs=250.0, output="sos")
    shaken = signal.sosfiltfilt(band, rng.normal(size=len(t)))
    tau = 0.6 * qdd - 14.7 * np.cos(q) + (2.0 + surplus * np.exp(-np.abs(qd) / 0.2)) * np.tanh(qd / 2e-3) + 1.5 * qd
    tau = tau + 0.6 * shaken / np.std(shaken) + 0.01 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q=q[:, None], tau=tau[:, None])


@pytest.mark.parametrize(("surplus", "named"), [(1.0, ["stribeck"]), (0.0, [])])
def test_friction_over_speed_is_found_where_vibrations_are_most_of_what_is_left(surplus, named, tmp_path):
    found = diagnose(vibrating(surplus), arm(tmp_path))
    assert [e.fitted.name for e in found.effects] == named
    if named:
        (effect,) = found.effects
        # Of the whole band's squares it takes away less than is asked there; what is asked is said in those.
        assert effect.fitted.evidence["share"] < 0.15
        assert effect.fitted.evidence["share_asked"] < effect.fitted.evidence["share"]
        assert effect.fitted.coefficients[0] == pytest.approx(surplus, rel=0.3)
