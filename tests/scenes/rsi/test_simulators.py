"""Our server against the controller's side as others wrote it, where their simulators lie beside the repository."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.rsi_simulators import SIMULATORS, home_of
from benchmarks.rsi_simulators import played as played_on

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "rsi-simulators"


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_public_simulator_is_led_along_the_path(name: str) -> None:
    if home_of(FOLDER, name) is None:
        pytest.skip(f"{SIMULATORS[name].file} is neither in ../shared/rsi-simulators nor installed")
    run = played_on(FOLDER, name, method="none", seconds=0.8)
    assert run.failure is None
    assert len(run.recording.t) == run.rows
    # They are where they were told to be a cycle before; RSIPI tells two decimals of a degree.
    q, q_c = run.recording.joints("q"), run.recording.joints("q_c")
    assert run.counts["lost"] + run.counts["late"] > 0 or np.abs(q[1:] - q_c[:-1]).max() < 1e-4
    np.testing.assert_allclose(q[-1], q_c[-1], atol=1e-4)
    assert np.ptp(q, axis=0).min() > np.radians(4.0)
