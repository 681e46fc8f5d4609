"""Answers of a sweep as a partitioned Parquet data set, which grows while it runs and can be queried meanwhile."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Hashable
from pathlib import Path
from typing import Any

from ideal_robot.bounded_values import parsed_json
from ideal_robot.errors import InputError
from ideal_robot.whole_file import OutputError, whole_file
from scenes.regression.results import table
from scenes.report.page import plain
from scenes.sweep import SweepFile, key_of

PART = 500
"""Answers of a part at most: a megabyte."""
EVERY = 30.0
"""How old an answer may become before a query finds it [s]."""


class RunSet:
    """A folder ``scene=NAME/part-….parquet`` with a row a run, and ``open.jsonl`` with the answers of no part yet.

    An answer is on the disk when ``add`` returns; a part is there whole or not at all. Any reader of Parquet can query
    the parts while the sweep goes on.

    Args:
        folder: of the data set.
        resume: go on with one that is there; without it such a folder is refused.

    Raises:
        InputError: the folder is there and not to be gone on with, or holds something else.
    """

    def __init__(self, folder: Path, *, resume: bool) -> None:
        self.folder = folder
        if folder.exists() and not resume:
            raise InputError("is there already; --resume goes on with it, or give another name", field="--runs",
                             value=str(folder))
        self.answers: dict[Hashable, dict[str, Any]] = dict(self._of_parts())
        """Answers of earlier sweeps, by ``key_of`` their job."""
        self._open = SweepFile(folder / "open.jsonl", resume=True)
        # What a sweep that was killed between both wrote into a part already.
        self._waiting = [(json.loads(str(key)), answer) for key, answer in self._open.answers.items()
                         if key not in self.answers]
        self.answers |= self._open.answers
        self._written = time.monotonic()

    def _of_parts(self) -> list[tuple[Hashable, dict[str, Any]]]:
        import pyarrow
        import pyarrow.parquet

        found: list[tuple[Hashable, dict[str, Any]]] = []
        for path in sorted(self.folder.glob("scene=*/*.parquet")):
            try:
                part = pyarrow.parquet.ParquetFile(path).read(columns=["job", "answer"])
            except (pyarrow.ArrowException, OSError, ValueError, KeyError) as error:
                raise InputError("is no part of a sweep; remove it, and its runs are played again", file=path,
                                 field="--runs") from error
            found += [(str(job), parsed_json(str(answer), path, "answer"))
                      for job, answer in zip(*(part[name].to_pylist() for name in ("job", "answer")), strict=True)]
        return found

    def add(self, job: dict[str, Any], answer: dict[str, Any]) -> None:
        """Appends an answer.

        Raises:
            OutputError: it cannot be written; the data set holds the answers before it.
        """
        self._open.add(job, answer)
        self._waiting.append((plain(job), plain(answer)))
        if len(self._waiting) >= PART or time.monotonic() - self._written > EVERY:
            self.close()

    def close(self) -> None:
        """Makes parts of the answers that are in none yet.

        Raises:
            OutputError: they cannot be written; the answers are in ``open.jsonl``.
        """
        scenes = dict.fromkeys(str(answer["scene"]) for _, answer in self._waiting)
        try:
            for scene in scenes:
                rows = [(job, answer) for job, answer in self._waiting if str(answer["scene"]) == scene]
                frame = table(answer for _, answer in rows).drop(columns="scene")
                frame["job"] = [key_of(job) for job, _ in rows]
                frame["answer"] = [json.dumps(answer) for _, answer in rows]
                with whole_file(self.folder / f"scene={scene}" / f"part-{secrets.token_hex(8)}.parquet") as file:
                    frame.dropna(axis="columns", how="all").to_parquet(file, index=False)
            self._open.path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError.of(self.folder, error, "make room and go on with --resume") from error
        self._waiting, self._written = [], time.monotonic()
