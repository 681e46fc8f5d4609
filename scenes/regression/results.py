"""Results as one table of runs, from any file, table or folder; and the data set that a sweep writes."""

from __future__ import annotations

import json
import re
import secrets
import time
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ideal_robot.bounded_values import parsed_json, read_json, read_text
from ideal_robot.errors import InputError, did_you_mean
from ideal_robot.registry import in_words
from ideal_robot.results import flat, plain
from ideal_robot.whole_file import OutputError, whole_file
from scenes.program import ORIGIN, PLACES, SCHEMA, TIMES, machine, origin, program
from scenes.report.page import write_json
from scenes.sweep import FIGURES, Kept, SweepFile, key_of

if TYPE_CHECKING:
    import pandas as pd

NOT_RESULTS = (*TIMES, *PLACES, "times", "files", "schema", "program")
"""Keys of a file that say how long it took, where files lie and what wrote it."""
CASE = ("scene", "robot", "individual", "world", "speed_m_s", "method")
"""What runs of one case have in common; its runs differ in their seeds."""
HASHES = ("task_hash", "world_hash", "model_hash")
NOT_FIGURES = frozenset({*CASE, *HASHES, "seed", "failure", "not_played"})
"""Columns of a table of runs that say what was played, or why not."""
MAIN = tuple(name for name in FIGURES if name != "speed_m_s")
"""Figures that are compared where nobody names others: those that a sweep shows; of all of them less is better."""
UNITS = {"mm": {"um": 1e-3, "µm": 1e-3, "mm": 1.0, "m": 1e3}, "N": {"mN": 1e-3, "N": 1.0, "kN": 1e3},
         "s": {"us": 1e-6, "ms": 1e-3, "s": 1.0}, "ms": {"us": 1e-3, "ms": 1.0, "s": 1e3}}
"""Units of figures, and what may be given in their place: factor to the figure's own."""


def unit_of(figure: str) -> str | None:
    """Unit of a figure, the last that stands in its name; None where there is none.

    >>> unit_of("control_error_mm.mean"), unit_of("path_error_mm.delay_ms"), unit_of("fields.used")
    ('mm', 'ms', None)
    """
    units = re.findall(r"_(mm|N|ms|s)(?=\.|$)", figure)
    return units[-1] if units else None


def figure_in_words(figure: str) -> str:
    """A figure's key as words, its unit left out.

    >>> figure_in_words("path_error_mm.time_matched.E_car")
    'path error, time matched, E_car'
    """
    parts = [part.removesuffix(f"_{unit_of(figure)}") for part in figure.split(".")]
    return ", ".join(part if part.startswith("E_") else in_words(part) for part in parts)


@dataclass(frozen=True)
class Results:
    """Runs with their figures, and the program and machine that computed them.

    Attributes:
        runs: one row a run: ``CASE``, ``seed``, ``failure``, ``HASHES``, and figures by their dotted names.
        program, machine: version of the program, and the computer; empty where a file has none.
        source: the file, table or folder.
    """

    runs: pd.DataFrame = field(repr=False)
    program: dict[str, Any] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    source: str = ""

    @classmethod
    def of(cls, answers: Iterable[dict[str, Any]], source: str = "this run") -> Results:
        """Results of answers that this program has just computed."""
        return cls(table(answers), dict(program()), machine(), source)

    @property
    def figures(self) -> list[str]:
        """Names of all figures that are numbers."""
        return [name for name in self.runs.columns
                if name not in NOT_FIGURES and self.runs[name].dtype.kind in "fi"]

    def mean(self, figure: str) -> float:
        """Mean of a figure over the runs, in the unit of its name.

        Raises:
            InputError: no run has it; or a run failed, with its reason.
        """
        failed = self.runs["failure"].dropna()
        if len(failed):
            raise InputError(f"{len(failed)} of {len(self.runs)} runs failed: {failed.iloc[0]}", field=figure)
        if figure not in self.figures:
            raise InputError(f"no run has this figure; {did_you_mean(figure, self.figures)}there are "
                             f"{', '.join(self.figures)}", field="figure", value=figure)
        return float(self.runs[figure].mean())

    def write(self, path: Path) -> Path:
        """Writes the results as JSON, which ``read_results`` reads; the same runs give the same bytes."""
        rows = self.runs.astype(object).where(self.runs.notna(), None).to_dict("records")
        rows = [{str(key): int(value) if key in ("seed", "individual") else value for key, value in row.items()
                 if value is not None} for row in rows]
        return write_json(path, {"schema": SCHEMA, "program": self.program, "machine": self.machine, "runs": rows})


def table(answers: Iterable[Mapping[Any, Any]]) -> pd.DataFrame:
    """A table of answers of a sweep, without times and places; lists and texts that no column is for are left out."""
    import pandas as pd

    rows = []
    for answer in answers:
        results = {key: value for key, value in plain(answer).items() if key not in NOT_RESULTS}
        results.setdefault("individual", 1)
        rows.append({key: value for key, value in flat(results).items() if not isinstance(value, list)})
    frame = pd.DataFrame(rows)
    texts = {"scene", "robot", "world", "method", "failure", "not_played", *HASHES}
    for name in (*CASE, *HASHES, "seed", "failure"):
        if name not in frame:
            frame[name] = None
    numbers = [name for name in frame.columns if name not in texts and frame[name].map(_is_number).all()]
    frame[numbers] = frame[numbers].astype(float)
    return frame[[name for name in frame.columns if name in texts or name in numbers]]


def times_of(answers: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The times of answers, with the keys of their runs."""
    return [{key: answer.get(key) for key in (*CASE, "seed", *TIMES) if key in answer} for answer in answers]


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


# Reading what run, compare, sweep and check have written.

def read_results(path: Path) -> Results:
    """Results of a file (JSON, JSON Lines, CSV, Parquet) or a folder of such that a verb has written.

    Raises:
        InputError: no such file, or none with runs.
    """
    if path.is_dir():
        return _of_folder(path)
    if not path.is_file():
        raise InputError("no such file or folder; give what run, compare, sweep or check has written", file=path)
    if path.suffix in (".parquet", ".csv"):
        return Results(_of_table(path), source=str(path))
    if path.suffix == ".jsonl":
        lines = [parsed_json(line, path, "results") for line in read_text(path, "results").splitlines() if line]
        return _checked(table(row.get("answer", row) if isinstance(row, dict) else {} for row in lines), {}, path)
    content = read_json(path, "results")
    if not isinstance(content, dict):
        raise InputError("holds no runs; give what run, compare, sweep or check has written", file=path)
    if isinstance(content.get("schema", SCHEMA), int) and content.get("schema", SCHEMA) > SCHEMA:
        raise InputError(f"written by a newer version (layout {content['schema']}, this one reads {SCHEMA}); update "
                         "the program", file=path, field="schema")
    if isinstance(content.get("runs"), list):
        answers = content["runs"]
    elif isinstance(content.get("methods"), dict):
        answers = list(content["methods"].values())
    else:
        answers = [content]
    return _checked(table(answer if isinstance(answer, dict) else {} for answer in answers), content, path)


def _of_folder(folder: Path) -> Results:
    for name in ("results.json", "report.json"):
        if (folder / name).is_file():
            return read_results(folder / name)
    files = [path for ending in ("parquet", "jsonl", "json") for path in sorted(folder.rglob(f"*.{ending}"))]
    parts = [read_results(path) for path in files if not path.name.startswith(".")]
    if not parts:
        raise InputError("holds no results (.json, .jsonl, .parquet)", file=folder)
    import pandas as pd

    return Results(pd.concat([part.runs for part in parts], ignore_index=True), source=str(folder))


def _of_table(path: Path) -> pd.DataFrame:
    import pandas as pd

    try:
        frame = (pd.read_parquet if path.suffix == ".parquet" else pd.read_csv)(path.absolute())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read as a table of runs ({str(error)[:200]})", file=path) from error
    frame = frame.rename(columns={title: name for name, title in FIGURES.items()})
    if "scene" not in frame and path.parent.name.startswith("scene="):
        frame["scene"] = path.parent.name.removeprefix("scene=")
    if "scene" not in frame:
        raise InputError("has no column scene; give a table that sweep or check has written", file=path)
    return table(frame.astype(object).where(frame.notna(), None).to_dict("records"))


def _checked(frame: pd.DataFrame, content: dict[str, Any], path: Path) -> Results:
    if frame["scene"].isna().any() or not len(frame):
        raise InputError("has an entry that is not a run (no scene); give what run, compare, sweep or check has "
                         "written", file=path)
    origin = {key: value if isinstance(value := content.get(key), dict) else {} for key in ("program", "machine")}
    return Results(frame, source=str(path), **origin)


# A partitioned Parquet data set of a sweep's answers, which grows during the sweep and can be queried meanwhile.

PART = 500
"""Answers of a part at most: a megabyte."""
EVERY = 30.0
"""How old an answer may become before a query finds it [s]."""


class RunSet(Kept):
    """A folder ``scene=NAME/part-….parquet`` with one row per run, and ``open.jsonl`` with answers not yet in a part.

    A row says which version played it, on which computer and when (``scenes.program.ORIGIN``), so that the folder is
    the history of its runs. Answers of other versions stay beside those of today.

    An answer is on the disk when ``add`` returns; a part is there whole or not at all. Any reader of Parquet can query
    the parts while the sweep goes on.

    Without ``resume`` a folder that is there is refused by InputError, as is one that holds something else.
    """

    def __init__(self, folder: Path, *, resume: bool) -> None:
        self.folder = folder
        if folder.exists() and not resume:
            raise InputError("is there already; --resume goes on with it, or give another name", field="--runs",
                             value=str(folder))
        self.answers = dict(self._of_parts())
        self._open = SweepFile(folder / "open.jsonl", resume=True)
        # Answers that a killed sweep had already written into a part are dropped.
        self._waiting = [(json.loads(str(key)), answer, self._open.lines[key].get("origin") or {})
                         for key, answer in self._open.answers.items() if key not in self.answers]
        self.answers |= self._open.answers
        self._written = time.monotonic()

    def _of_parts(self) -> list[tuple[Hashable, dict[str, Any]]]:
        import pyarrow.parquet

        answers: list[tuple[Hashable, dict[str, Any]]] = []
        for path in sorted(self.folder.glob("scene=*/*.parquet")):
            try:
                part = pyarrow.parquet.ParquetFile(path).read(columns=["job", "answer"])
            except (pyarrow.ArrowException, OSError, ValueError, KeyError) as error:
                raise InputError("is not a part of a sweep; remove it, and its runs are done again", file=path,
                                 field="--runs") from error
            answers += [(str(job), parsed_json(str(answer), path, "answer"))
                        for job, answer in zip(*(part[name].to_pylist() for name in ("job", "answer")), strict=True)]
        return answers

    def add(self, job: dict[str, Any], answer: dict[str, Any]) -> None:
        """Appends an answer; OutputError where it cannot be written, the data set holds the answers before it."""
        by = origin()
        self._open.keep(job, answer, origin=by)
        self._waiting.append((plain(job), plain(answer), by))
        if len(self._waiting) >= PART or time.monotonic() - self._written > EVERY:
            self.close()

    def close(self) -> None:
        """Makes parts of the answers that are in none yet; OutputError where it cannot, they are in ``open.jsonl``."""
        scenes = dict.fromkeys(str(answer["scene"]) for _, answer, _ in self._waiting)
        try:
            for scene in scenes:
                rows = [entry for entry in self._waiting if str(entry[1]["scene"]) == scene]
                frame = table(answer for _, answer, _ in rows).drop(columns="scene")
                for name in ORIGIN:
                    frame[name] = [by.get(name) for _, _, by in rows]
                frame["job"] = [key_of(job) for job, _, _ in rows]
                frame["answer"] = [json.dumps(answer) for _, answer, _ in rows]
                with whole_file(self.folder / f"scene={scene}" / f"part-{secrets.token_hex(8)}.parquet") as file:
                    frame.dropna(axis="columns", how="all").to_parquet(file, index=False)
            self._open.path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError.of(self.folder, error, "make room and go on with --resume") from error
        self._waiting, self._written = [], time.monotonic()
