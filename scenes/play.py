"""Runs scenes of any kind from Python: with one method, with several, or run, diagnose and run again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from ideal_robot.errors import InputError
from ideal_robot.registry import imported
from scenes.kind import KINDS, kind_of
from scenes.result import Progress, silent
from scenes.scene_files.scene import Scene

if TYPE_CHECKING:
    from scenes.closing.result import Closing
    from scenes.force.play import ForceResult
    from scenes.line.result import LineResult
    from scenes.path.cell import PathResult
    from scenes.scene_files.force_scene import ForceScene
    from scenes.scene_files.line_scene import LineScene
    from scenes.scene_files.path_scene import PathScene


@overload
def run_scene(scene: LineScene, *, method: Any = ..., out: Path | None = ..., progress: Progress = ...,
              **changes: Any) -> LineResult: ...


@overload
def run_scene(scene: PathScene, *, method: Any = ..., out: Path | None = ..., progress: Progress = ...,
              **changes: Any) -> PathResult: ...


@overload
def run_scene(scene: ForceScene, *, method: Any = ..., out: Path | None = ..., progress: Progress = ...,
              **changes: Any) -> ForceResult: ...


@overload
def run_scene(scene: Scene, *, method: Any = ..., out: Path | None = ..., progress: Progress = ...,
              **changes: Any) -> Any: ...


def run_scene(scene: Scene, *, method: Any = None, out: Path | None = None, progress: Progress = silent,
              **changes: Any) -> Any:
    """Runs a scene and returns its typed result (``scenes.line.result.LineResult`` for a line).

    Args:
        scene: the scene.
        method: method key, or a ``Feedforward`` or a factory of one; the scene's own if None.
        out: folder for recording and report; nothing is written without.
        progress: called with the fraction done.
        changes: keys of the scene to change, tables given as dictionaries and merged; or further arguments of the
            kind's ``run`` (``sensors`` of a line).

    Raises:
        InputError: the scene cannot be run.
    """
    own = {key: value for key, value in changes.items() if key not in type(scene).model_fields}
    changed = scene.changed(**{key: value for key, value in changes.items() if key not in own})
    return kind_of(changed).run(changed, method=method, out=out, progress=progress, **own)


def compare_scene(scene: Scene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
                  progress: Progress = silent, **changes: Any) -> Any:
    """Runs a scene with several methods.

    Args:
        scene: the scene.
        methods: method keys, ``Feedforward`` objects or factories; every method that applies if None.
        out, progress, changes: as for ``run_scene``.

    Raises:
        InputError: the scene cannot be run.
    """
    changed = scene.changed(**changes) if changes else scene
    return kind_of(changed).compare(changed, methods=methods, out=out, progress=progress)


def close_scene(scene: Scene, *, measured: str = "tcp", out: Path | None = None,
                progress: Progress = silent) -> Closing:
    """Runs a scene, diagnoses what its model lacks, extends the model and runs it again.

    Args:
        scene: the scene; its kind has to support it.
        measured: the measured quantities: ``motor``, ``arm`` or ``tcp``.
        out, progress: as for ``run_scene``; the model is written, too.

    Raises:
        InputError: a scene of another kind, or one whose world holds nothing undeclared.
    """
    close_loop = kind_of(scene).close_loop
    if close_loop is None:
        able = ", ".join(name for name, kind in KINDS if kind.close_loop is not None)
        raise InputError(f"only scenes of kind {able} can be closed; they hold the undeclared effect", field="kind",
                         value=scene.kind)
    return imported(close_loop)(scene, measured=measured, out=out, progress=progress)
