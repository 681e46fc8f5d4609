"""Contour following without a reference path ([L] 4.4)."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.force.kind import run
from scenes.force.play import play


def test_the_whole_contour_is_followed_in_contact() -> None:
    """Slopes up to 30° that nobody told the arm; force within 10 %, the way is the one asked for."""
    result = play(load_scene("contour"), "ideal")
    assert result.failure is None
    assert result.figures.lost == 0.0
    assert result.figures.rms <= 2.0
    assert result.figures.largest <= 60.0
    tip, moving = result.history["tip"], result.history["normal"] > 1.0
    way = np.sum(np.linalg.norm(np.diff(tip[moving][::20], axis=0), axis=1))
    assert way == pytest.approx(0.5, rel=0.06)
    # There and back: the contour leaves the straight line by far more than a reference would have allowed for.
    assert np.ptp(tip[moving, 2]) > 0.04


def test_direct_feedback_has_no_reference_to_go_along() -> None:
    with pytest.raises(InputError, match="sensor_path, ideal"):
        run(load_scene("contour"), method="direct_feedback")
