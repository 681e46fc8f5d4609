"""What motor angles cannot show counts against adoption, by how uncertain it is."""

from __future__ import annotations

import pytest

from ideal_robot.effects import FittedEffect
from scenes.path.close_loop import doubt_of_load


def test_load_is_as_doubtful_as_its_mass() -> None:
    """Two standard deviations; moments have other units and their own, far larger shares."""
    load = FittedEffect("payload", 0, "tau", (4.0, *(0.1,) * 9), (0.5, *(1.0,) * 9))
    assert doubt_of_load(load) == pytest.approx(2.0 * 0.5 / 4.0)


def test_slope_of_the_ground_is_as_doubtful_as_both_its_parts() -> None:
    tilt = FittedEffect("base_tilt", 0, "tau", (0.03, 0.04), (0.003, 0.004))
    assert doubt_of_load(tilt) == pytest.approx(0.2)


def test_size_without_deviation_adds_no_doubt() -> None:
    assert doubt_of_load(FittedEffect("base_tilt", 0, "tau", (0.03, 0.04))) == 0.0
