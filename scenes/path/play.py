"""Plays scenes of kind ``path``: tool paths known beforehand, [G] sections 4 and 5, corrected by one method."""

from __future__ import annotations

from dataclasses import replace

from ideal_robot.feedforward.method import ITERATIONS
from scenes.methods import SceneMethod
from scenes.path.cell import PathCell
from scenes.path.result import PathResult
from scenes.result import Progress
from scenes.scene_files.path_scene import PathScene

_LEARNING = ITERATIONS / (ITERATIONS + 1.0)
"""Share of the plays that learning takes, where there is something to learn; the last one counts."""


def play_method(scene: PathScene, cell: PathCell, method: SceneMethod, progress: Progress) -> PathResult:
    """Plays the scene's path with one method; nothing is written.

    Args:
        scene: what to play.
        cell: from ``set_up`` of the scene, with the planner's delay as the method's key says.
        method: how the path is corrected.
        progress: called with the fraction done.

    Raises:
        InputError: no such method.
    """
    learned: list[float] = []

    def learning(fraction: float, text: str) -> None:
        learned.append(fraction)
        progress(_LEARNING * fraction, text)

    feedforward = cell.feedforward(method, learning)
    progress(_LEARNING if learned else 0.0, method.key)
    played = cell.play(feedforward)
    progress(1.0, method.key)
    meta = {**played.recording.meta, "scene": scene.name, "method": method.key, "seed": scene.seed}
    played = replace(played, recording=replace(played.recording, meta=meta))
    return PathResult(scene, method.key, cell.path, played, cell.robot.urdf, cell.world.table())
