"""Standard deviations of what adaptation learns of friction are true."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import load_scene
from scenes.path.cell import set_up
from studies.adapted_friction import ENGINES, compared


@pytest.mark.parametrize("engine", ["identified loop", pytest.param("simulated arm", marks=pytest.mark.slow)])
def test_friction_is_as_far_from_the_truth_as_its_standard_deviation_says(engine: str) -> None:
    cell = set_up(load_scene("iso9283_2"), delay=False)  # type: ignore[arg-type]
    errors = np.concatenate([compared(cell, ENGINES[engine], seed)[0] for seed in range(1, 7)])
    assert np.isfinite(errors).sum() > 100
    assert 0.8 < np.sqrt(np.nanmean(errors**2)) < 1.25
