"""What studies share: Markdown tables that are printed row by row, and the time and memory that work takes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ideal_robot.errors import IdealRobotError, InputError
from scenes import load_scene
from scenes.scene_files.scene import Scene

S = TypeVar("S", bound=Scene)
DOCS = Path(__file__).resolve().parents[1] / "docs"


def head(*titles: str) -> None:
    """Begins a table."""
    print(f"| {' | '.join(titles)} |\n{'| --- ' * len(titles)}|", flush=True)


def row(*cells: object) -> None:
    """Goes on with it."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def listed(values: Iterable[float], digits: int = 3) -> str:
    """Numbers with commas between; ``failed`` for one that is none."""
    return ", ".join("failed" if np.isnan(value) else f"{value:.{digits}f}" for value in values)


def scene_of(kind: type[S], name: str) -> S:
    """A shipped scene of a kind."""
    scene = load_scene(name)
    assert isinstance(scene, kind)
    return scene


def used(job: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Processor time of a job [s], of this process unless another clock is given."""
    begun = clock()
    job()
    return clock() - begun


def resident(process: int | str = "self") -> float:
    """Resident memory of this process, or of another one by its number, now [MiB]."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def plays_in(lines: Path | None) -> list[dict[str, Any]]:
    """Plays that a file of JSON lines holds, each as it was kept; none without the file."""
    return [] if lines is None or not lines.is_file() else list(
        map(json.loads, lines.read_text(encoding="utf-8").splitlines()))


def keep(lines: Path | None, play: dict[str, Any]) -> None:
    """Adds a play that has ended as a line of the file, where there is to be one."""
    if lines is not None:
        with lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps(play) + "\n")


def kept(lines: Path, seeds: Sequence[int], play: Callable[[int], Any]) -> list[Any]:
    """What was played of seeds: lines of a file where it has them, else played and added; refused ones are said."""
    done = {values["seed"]: values["scores"] for values in plays_in(lines)}
    for seed in seeds:
        if seed in done:
            continue
        try:
            done[seed] = play(seed)
        except (RuntimeError, IdealRobotError) as error:
            print(f"{seed}: {error}", flush=True)
            continue
        keep(lines, {"seed": seed, "scores": done[seed]})
    return [done[seed] for seed in seeds if seed in done]


def marked_page(mark: str) -> Path:
    """The page that has ``<!-- mark -->``.

    Raises:
        InputError: none has.
    """
    for page in sorted(DOCS.glob("*.md")):
        if f"<!-- {mark} -->\n" in page.read_text(encoding="utf-8"):
            return page
    raise InputError(f"no page has <!-- {mark} -->", field="--write", value=mark)


def write_tables(mark: str, text: str) -> None:
    """Puts text between ``<!-- mark -->`` and ``<!-- end of mark -->`` of the page that has them.

    Raises:
        InputError: no page has the mark.
    """
    page = marked_page(mark)
    before, first, rest = page.read_text(encoding="utf-8").partition(f"<!-- {mark} -->\n")
    last = f"<!-- end of {mark} -->"
    page.write_text(f"{before}{first}{text}\n{last}{rest.partition(last)[2]}", encoding="utf-8")
