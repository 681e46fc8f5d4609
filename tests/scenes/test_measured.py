"""What an arm does not measure is not in its recording."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.signals.recording import Recording
from scenes.measured import Measured, visible

COLUMNS = {name: np.zeros(3) for name in ("q_1", "tau_1", "qa_1", "q_d_1", "x", "qx", "fx", "temp_1", "cam_t")}
HIDDEN: dict[Measured, set[str]] = {"motor": {"qa_1", "x", "qx"}, "arm": {"x", "qx"}, "tcp": set()}


@pytest.mark.parametrize("measured", ["motor", "arm", "tcp"])
def test_only_what_is_measured_is_seen(measured: Measured) -> None:
    seen = visible(Recording({"t": np.arange(3.0), **COLUMNS}), measured)
    assert set(seen.columns) == {"t", *COLUMNS} - HIDDEN[measured]
