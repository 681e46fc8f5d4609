"""The last good model of a closing that is interrupted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ideal_robot.model.model import Model
from ideal_robot.whole_file import OutputError
from scenes.scene_files.scene import SceneError

NAME = "extended_model.json"
"""Of the model in the folder of a closing."""


@dataclass
class LastGood:
    """What is kept while rounds are done.

    Attributes:
        folder: where; None where nothing is written.
        round: the one that is being done; 0 when all are.
        kept: of which round the model in the folder is; 0 for none.
    """

    folder: Path | None
    round: int = 0
    kept: int = 0

    def model(self, model: Model) -> None:
        """Writes the model of the round that is done, whole or not at all."""
        if self.folder is not None:
            model.save(self.folder / NAME)
        self.kept = self.round


@contextmanager
def last_good(folder: Path | None) -> Iterator[LastGood]:
    """Says of which round the model is that an interrupted closing leaves.

    Args:
        folder: of the closing's results; None where nothing is written.

    Raises:
        SceneError: in place of an interrupt, the end of the process or a full disk while a round was being done.
    """
    keep = LastGood(folder)
    try:
        yield keep
    except (KeyboardInterrupt, SystemExit, OutputError) as ended:
        if not keep.round:
            raise
        if keep.kept and folder is not None:
            left = f"{folder / NAME} is the model of round {keep.kept}"
        else:
            left = "no round was done, the model is as it was"
        why = f"{ended}; ended" if isinstance(ended, OutputError) else "interrupted"
        raise SceneError(f"{why} in round {keep.round}; {left}") from ended
