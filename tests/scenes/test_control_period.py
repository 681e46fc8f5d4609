"""Horizons and windows are times: a faster controller is followed no worse."""

from __future__ import annotations

import pytest

from scenes import load_scene, run_scene


@pytest.mark.parametrize(("name", "changes"), [
    ("straight", {"world": {"base": "bench"}, "calibration": {"by_moving": False},
                  "line": {"points": [(0.4, 0.0), (0.8, 0.0)]}}),
    ("iso9283_1", {}),
])
def test_a_shorter_cycle_is_no_worse(name: str, changes: dict) -> None:
    """4 ms beside 12 ms; a quarter more is what another draw of the encoders' steps and the noise makes of a run."""
    errors = []
    for t_ipo in (0.012, 0.004):
        scene = load_scene(name)
        world = {**changes.get("world", {}), "t_ipo": t_ipo}
        result = run_scene(scene.changed(**{**changes, "world": world}), method="ideal")
        assert result.failure is None
        measured = result.errors if hasattr(result, "errors") else result.path_errors
        errors.append(measured.aligned.E_car)
    assert errors[1] <= 1.25 * errors[0], errors
