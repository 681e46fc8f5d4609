"""The fastest speed within a tolerance: kept by the run, near its edge, and refused where nothing keeps it."""

from __future__ import annotations

import pytest

from ideal_robot.errors import InputError
from scenes.commands.common import length
from scenes.line.cell import prepared
from scenes.line.fastest import _law, _reaching, fastest
from scenes.line.play import play
from tests.scenes.line.test_line_following import short


def test_the_law_of_the_trials_is_recovered() -> None:
    trials = [(v, 3e-5 + 4e-5 * v**2) for v in (0.3, 0.6, 1.0)]
    assert _law(trials) == pytest.approx((3e-5, 4e-5))
    assert _reaching(trials, 3e-5 + 4e-5 * 1.44) == pytest.approx(1.2)


def test_the_speed_found_keeps_the_tolerance_and_a_wider_one_is_faster() -> None:
    scene = short()
    with prepared(scene) as shared:
        narrow, wide = (fastest(scene, tolerance, shared=shared) for tolerance in (8e-5, 1e-3))
        result = play(scene.changed(speed=narrow.speed), "ideal", shared=shared)
        with pytest.raises(InputError, match="allow more"):
            fastest(scene, 1e-6, shared=shared)
    assert result.control_error.p95 <= 8e-5
    assert narrow.speed < wide.speed
    assert dict(wide.trials)[wide.speed] <= 1e-3
    assert 0.0 < narrow.predicted < 2e-4


def test_lengths_have_units() -> None:
    assert length("0.2mm", "--tolerance") == pytest.approx(2e-4)
    assert length("200 um", "--tolerance") == pytest.approx(2e-4)
    assert length("0.0002", "--tolerance") == pytest.approx(2e-4)
    for wrong in ("0.2 inch", "-1mm", "nanmm", ""):
        with pytest.raises(InputError):
            length(wrong, "--tolerance")
