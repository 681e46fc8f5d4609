"""Gear deflection on a path: all rows at once are what each row alone gives."""

from __future__ import annotations

import numpy as np

from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.model.model import Model
from scenes.models import shipped_model


def test_a_whole_path_is_its_rows_one_by_one() -> None:
    model = Model.load(shipped_model("kr6"))
    deflection = GearDeflection(model, 0.012)
    q_d = np.array([0.0, -1.2, 1.8, 0.0, 0.9, 0.0]) + 0.3 * np.sin(np.outer(0.012 * np.arange(40), np.arange(1, 7)))
    one_by_one = [deflection.at(q_d[max(k - 1, 0) : k + 2]) for k in range(len(q_d))]
    np.testing.assert_array_equal(deflection.along(q_d), one_by_one)
    assert np.abs(one_by_one).max() > 1e-5
