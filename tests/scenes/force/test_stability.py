"""The stability map: its bounds, and that estimating on the way widens them."""

from __future__ import annotations

import pytest

from scenes.force.stability import StabilityMap, StabilityPoint, stability_map, stability_page


def test_bounds_are_the_stable_range_around_one() -> None:
    good = {0.25: True, 0.5: False, 0.8: True, 1.0: True, 1.5: True, 2.0: False, 4.0: True}
    points = (StabilityPoint("elasticity", True, ratio, 1.0, stable, "") for ratio, stable in good.items())
    found = StabilityMap(tuple(points))
    assert found.bounds("elasticity", True) == (0.8, 1.5)


@pytest.mark.slow
def test_estimating_on_the_way_widens_the_range() -> None:
    """[L] 2.3: totally wrong values touch stability; half and twice E are bearable when it is estimated."""
    found = stability_map(elasticity=(0.5, 1.0, 2.0), distance=(0.8, 1.0, 1.25))
    assert found.bounds("elasticity", True) == (0.5, 2.0)
    assert found.bounds("distance", True) == (0.8, 1.25)
    narrow = found.bounds("elasticity", False)
    assert narrow[0] > 0.5
    assert "times the true one" in stability_page(found).summary
