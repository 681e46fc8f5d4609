"""Replays of a data set's runs: newest and best version of each case, for comparison."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenes.kind import kind_of
from scenes.program import program
from scenes.regression.results import CASE
from scenes.report.replay import KeptReplay
from scenes.sweep import Job, play

FOLDER = "replays"
"""Folder of a data set with a folder of replays for each version, named after the digest of its sources."""


def play_and_keep(job: Job, folder: Path) -> dict[str, Any]:
    """Runs a job as ``scenes.sweep.play`` does, and stores its replay in the data set ``folder``."""
    drawn: list[KeptReplay] = []

    def draw(scene: Any, result: Any) -> None:
        make = kind_of(scene).replay
        replay = None if make is None else make(result)
        if replay is not None:
            drawn.append(KeptReplay(replace(replay, pictures=()).data()))

    answer = play(job, draw)
    for replay in drawn:
        with suppress(Exception):  # a replay is optional, so its errors are ignored
            replay.keep(replay_place(folder, str(program()["digest"]), answer))
    return answer


def replay_place(folder: Path, digest: str, run: Mapping[Any, Any]) -> Path:
    """File of a run's replay in a data set.

    Args:
        folder: of the data set.
        digest: digest of the sources of the program that ran it.
        run: an answer, or a row of a table of runs, with the keys of ``CASE`` and ``seed``.
    """
    words = [re.sub(r"[^\w.]+", "_", word_of(run.get(name))) for name in (*CASE, "seed")]
    return folder / FOLDER / digest / f"{'-'.join(words)}.json.gz"


def word_of(value: Any) -> str:
    """A row's value as the command line takes it; empty where it has none."""
    return "" if value is None or value != value else f"{value:g}" if isinstance(value, int | float) else str(value)


def tidy_replays(folder: Path, kept: set[str]) -> None:
    """Removes the replays of all versions but some.

    Args:
        folder: of the data set.
        kept: digests of the versions whose replays stay.
    """
    for version in (folder / FOLDER).glob("*"):
        if version.is_dir() and version.name not in kept:
            for file in version.glob("*.json.gz"):
                file.unlink(missing_ok=True)
            with suppress(OSError):  # another kind of file is in its place
                version.rmdir()
