"""The scene as a file: a path, and how the flange is clamped before it."""

from __future__ import annotations

from scenes.scene_files.clamped_scene import ClampTable
from scenes.scene_files.path_scene import PathScene


class CloseClampedScene(PathScene):
    """A tool path of an arm whose gears are known from recordings with the flange clamped alone."""

    clamp: ClampTable = ClampTable(most=3)
