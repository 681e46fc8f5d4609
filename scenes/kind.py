"""The interface of scene kinds: the functions that a kind offers to runner, command line and viewer.

A package outside adds one by ``KINDS.register("mine", SceneKind(…))`` or by an entry point of the group
``ideal_robot.scene_kinds``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from ideal_robot.arrays import Array
from ideal_robot.registry import Registry
from scenes.result import CompareResult, RunResult
from scenes.scene_files.scene import Scene

if TYPE_CHECKING:
    from scenes.closing.result import Closing


class Play(Protocol):
    """Runs a scene once; a kind may take further keywords, such as the sensors of a line scene."""

    def __call__(self, scene: Any, *, method: Any = None, out: Any = None, progress: Any = ...) -> RunResult:
        """Plays the scene.

        Args:
            scene: of the kind's class.
            method: key of the method, or a feedforward or a factory of one; the kind's usual one if None.
            out: folder of recording and report; nothing is written if None.
            progress: called with the share that is done, and what is being done.

        Raises:
            InputError: no such method, or a scene that cannot be played.
        """


class Compare(Protocol):
    """Runs a scene with several methods."""

    def __call__(self, scene: Any, *, methods: Any = None, out: Any = None, progress: Any = ...) -> CompareResult:
        """See ``Play.__call__``; ``methods`` are several of what it takes, all that apply if None."""


class CloseLoop(Protocol):
    """Runs a scene, diagnoses what its model lacks, and runs it again with the extended model."""

    def __call__(self, scene: Any, *, measured: str = ..., out: Any = None, progress: Any = ...) -> Closing:
        """See ``Play.__call__``; ``measured`` says what the arm measures, see ``scenes.closing.result``.

        Raises:
            InputError: another word for what is measured, or a world that holds nothing to be found.
        """


@dataclass(frozen=True)
class SceneKind:
    """One kind of scene.

    Attributes:
        scene: the scene's class: which keys its file has.
        methods: the keys that ``run`` takes as its method.
        run: runs a scene with one method.
        compare: runs a scene with several methods.
        curves: curves of a scene by name ``(N, 3)`` [m] for the viewer; None where there is nothing to draw.
        replay: makes the animation of a run's result for pages, films and the viewer (``scenes.report.replay.Replay``),
            or None where the run was too short; None where the kind has no replay.
        close_loop: run, diagnose, extend the model and run again, or ``"module:attribute"`` of it, which is imported
            when a loop is closed; None where the kind has no diagnosis.
    """

    scene: type[Scene]
    methods: Callable[[], tuple[str, ...]]
    run: Play
    compare: Compare
    curves: Callable[[Any], dict[str, Array]] | None = None
    close_loop: CloseLoop | str | None = None
    replay: Callable[[Any], Any] | None = None


KINDS: Registry[SceneKind] = Registry("kind of scene", "ideal_robot.scene_kinds", {
    "line": "scenes.line.kind:LINE",
    "path": "scenes.path.kind:PATH",
    "force": "scenes.force.kind:FORCE",
    "clamped": "scenes.clamped:CLAMPED",
    "close_clamped": "scenes.close_clamped:CLOSE_CLAMPED",
})


def kind_of(scene: Scene) -> SceneKind:
    """The kind that a scene is of."""
    return KINDS.get(scene.kind)
