"""Line scenes whose camera is wrong by what is drawn at random, for ``benchmarks.random_closings``.

One or two of time stamps (2 to 10 ms), their drift (0.6 to 3 ms/s), focal length (1 to 4 %), height (1 to 5 mm), yaw
and pitch (0.3° to 1.5°), and the lens (k1 of 0.02 to 0.08), either sign.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes import load_scene
from scenes.line.close_loop import closed, undeclared_effects
from scenes.scene_files.line_scene import LineScene

SIZES = {"camera.stamp_offset": (2e-3, 10e-3), "camera.stamp_drift": (6e-4, 3e-3),
         "calibration.focal_percent": (1.0, 4.0),
         "calibration.height_mm": (1.0, 5.0), "calibration.yaw_deg": (0.3, 1.5), "calibration.pitch_deg": (0.3, 1.5),
         "calibration.k1": (0.02, 0.08)}
"""Least and most of what is wrong with a camera, by key."""
_CALIBRATION = ("roll_deg", "pitch_deg", "yaw_deg", "height_mm", "lateral_mm", "focal_percent", "principal_px", "k1")


def drawn_line(rng: np.random.Generator) -> LineScene:
    """A wavy line under a camera that is right."""
    length, height = float(rng.uniform(0.6, 1.0)), float(rng.uniform(0.02, 0.05))
    scene = load_scene("close_camera").changed(
        world="bench", seed=int(rng.integers(1, 10**6)), speed=float(rng.uniform(0.4, 0.7)),
        camera={"stamp_drift": 0.0},
        line={"formula": f"{height:.4f}*sin(2*pi*x/{rng.uniform(0.5, 0.8):.3f})", "length": length},
        calibration=dict.fromkeys(_CALIBRATION, 0.0))
    assert isinstance(scene, LineScene)
    return scene


def drawn_error(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """One or two things that are wrong with a camera, as tables of the scene."""
    result: dict[str, dict[str, float]] = {}
    for key in map(str, rng.choice(list(SIZES), int(rng.integers(1, 3)), replace=False)):
        table, name = key.split(".")
        # The sizes of a calibration's errors have the signs that the scene's seed draws.
        sign = float(rng.choice([-1.0, 1.0])) if table == "camera" else 1.0
        result.setdefault(table, {})[name] = sign * float(rng.uniform(*SIZES[key]))
    return result


def closed_line(rng: np.random.Generator, right: bool, measured: str) -> dict[str, Any]:
    """Draws and closes one line.

    Args:
        rng: what is drawn.
        right: whether nothing is wrong.
        measured: what the arm measures.
    """
    scene = drawn_line(rng)
    misfit = {} if right else drawn_error(rng)
    hidden = scene.changed(**misfit) if misfit else scene
    assert isinstance(hidden, LineScene)
    result = closed(hidden, () if right else undeclared_effects(hidden), measured=measured)
    values = result.json()
    return {"robot": scene.robot, "speed": scene.speed, "misfit": misfit, "undeclared": values["undeclared"],
            "error_mm": {name: values["path_error_mm"][name]["mean"] for name in ("before", "after", "oracle", "true")},
            "steps": values["steps"]}
