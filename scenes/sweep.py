"""Many runs: scenes × methods × speeds × seeds, on local processes or a running Dask cluster."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ideal_robot.bounded_values import parsed_json
from ideal_robot.deadline import TIME_LIMIT
from ideal_robot.errors import InputError, described
from ideal_robot.results import plain
from ideal_robot.whole_file import OutputError
from scenes.kind import KINDS, kind_of
from scenes.methods import method_of
from scenes.models import digest_of, identity
from scenes.program import program
from scenes.result import silent
from scenes.scene_file import load_scene
from scenes.scene_files.scene import Scene, chosen
from scenes.workers import LostError, work_off, work_off_on

# Stores answers of a sweep as they come, one JSON line each, so that an interrupted sweep can continue.

FIGURES = {"speed_m_s": "m/s", "control_error_mm.mean": "mean mm", "control_error_mm.p95": "95 % mm",
           "control_error_mm.max": "max mm", "path_error_mm.time_matched.E_car": "E_car mm",
           "force_error_N.rms": "force N"}
"""Figures of a run that the table shows where the kind of scene has them, and the columns' titles."""
_LARGEST = 1e15
"""Numbers beyond are no figures."""


class Kept:
    """Stores answers as they come, so that a sweep can be continued; this base class stores none."""

    def __init__(self) -> None:
        self.answers: dict[Hashable, dict[str, Any]] = {}
        """Answers of earlier sweeps, by ``key_of`` their job."""

    def add(self, job: dict[str, Any], answer: dict[str, Any]) -> None:
        """Stores an answer; it is on the disk when this returns."""

    def close(self) -> None:
        """Called when the sweep has ended, in whatever way."""


class SweepFile(Kept):
    """A file of lines ``{"job": …, "answer": …}``.

    Without ``resume`` a file that is there is refused by InputError, as is one of something else.

    Attributes:
        lines: lines that were read, by ``key_of`` their job.
    """

    def __init__(self, path: Path, *, resume: bool) -> None:
        super().__init__()
        self.path = path
        self.lines: dict[Hashable, dict[str, Any]] = {}
        if path.exists():
            if not resume:
                raise InputError("is there already; --resume goes on with it, or give another name", field="--lines",
                                 value=str(path))
            self._read()

    def _read(self) -> None:
        if not self.path.is_file():
            raise InputError("not a plain file", field="--lines", value=str(self.path))
        raw = self.path.read_bytes()
        # A sweep that was killed may have left its last line unfinished.
        whole = raw[: raw.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                entry = parsed_json(line.decode(), self.path, "answer")
                self.answers[key_of(entry["job"])] = _checked(entry["answer"])
                self.lines[key_of(entry["job"])] = dict(entry)
            except (InputError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
                raise InputError(f"line {number} is not of a sweep; remove it, and its run is done again",
                                 file=self.path, field="--lines") from error
        if len(whole) < len(raw):
            os.truncate(self.path, len(whole))

    def add(self, job: dict[str, Any], answer: dict[str, Any]) -> None:
        """Appends an answer; OutputError where it cannot be written, the file holds the answers before it."""
        self.keep(job, answer)

    def keep(self, job: dict[str, Any], answer: dict[str, Any], **more: Any) -> None:
        """Adds an answer with further entries of its line, which ``lines`` has when the file is read again.

        Args:
            job, answer: as for ``add``.
            more: the entries.
        """
        line = json.dumps({"job": plain(job), "answer": plain(answer), **more}, allow_nan=False) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab", buffering=0) as file:
                whole = file.tell()
                try:
                    _append(file.fileno(), line.encode())
                except OSError:
                    with suppress(OSError):  # a disk that is read-only by now; --resume cuts the line off
                        file.truncate(whole)
                    raise
        except OSError as error:
            raise OutputError.of(self.path, error, "make room and go on with --resume; it holds the answers before "
                                                   "this one") from error


def _checked(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer that tables can be made of; raises an error of Python for any other."""
    for key, kinds in (("scene", str), ("method", str | None), ("seed", int | None), ("failure", str | None)):
        if not isinstance(answer[key], kinds):
            raise TypeError(key)
    for path in FIGURES:
        *tables, key = path.split(".")
        value: Any = answer
        for table in tables:
            value = value.get(table, {})
        value = value.get(key)
        if value is not None and not (isinstance(value, int | float) and abs(value) < _LARGEST):
            raise ValueError(path)
    return dict(answer)


def _append(descriptor: int, line: bytes) -> None:
    """Writes a line to the disk; a full disk may take a part of it before it says so."""
    while line:
        line = line[os.write(descriptor, line) :]
    os.fsync(descriptor)


def key_of(job: dict[str, Any]) -> str:
    """A text that identifies a job."""
    return json.dumps(plain(job), sort_keys=True)


MOST = 100_000
"""Most runs of a sweep."""


@dataclass(frozen=True)
class Job:
    """One run of a sweep; ``speed``, ``seed``, ``method``, ``individual`` and ``world`` None mean the scene's own."""

    scene: str | Scene
    method: Any
    speed: float | None
    seed: int | None
    individual: int | None = None
    world: str | None = None


def jobs(scenes: Sequence[str | Scene], methods: Sequence[Any] = (), speeds: Sequence[float] = (),
         seeds: Sequence[int] = (), individuals: Sequence[int] = (), world: str | None = None) -> list[Job]:
    """All combinations, in the order given; an empty list stands for the scene's own value.

    Args:
        scenes: names, paths of scene files, or scenes.
        methods: keys, or other methods that ``run_scene`` takes; with more than one process they must be importable.
        speeds: [m/s].
        seeds: of all that is drawn.
        individuals: arms of the type, each with the model of its own identification motions.
        world: world of all scenes; that of their files if None.
    """
    own: tuple[None] = (None,)
    count = math.prod(len(values) or 1 for values in (scenes, methods, speeds, seeds, individuals))
    if count > MOST:
        raise InputError(f"these are {count} runs; at most {MOST} at once", field="--seeds")
    product = itertools.product(scenes, methods or own, speeds or own, seeds or own, individuals or own)
    return [Job(*combination, world=world) for combination in product]


def play(job: Job, seen: Callable[[Scene, Any], None] = lambda scene, result: None) -> dict[str, Any]:
    """Runs one job without writing files; a failure is part of the answer and does not end the sweep.

    Only MemoryError is raised, as it depends on other processes.

    Args:
        job: the job.
        seen: called with the scene and its result, which the answer has only the figures of.
    """
    answer = _named(job)
    try:
        scene = chosen(_scene(job.scene), speed=job.speed, seed=job.seed, individual=job.individual,
                       world=job.world)
        kind, method = kind_of(scene), job.method or getattr(scene, "method", None)
        # These entries are set before the run, so that a failed run can be identified.
        answer |= {**scene.played(), "speed_m_s": getattr(scene, "speed", None), **identity(scene),
                   "method": method and method_of(method, kind.methods()).key}
        result = kind.run(scene, method=job.method, out=None, progress=silent)
        seen(scene, result)
        return {**answer, **result.json(), "failure": result.failure}
    except MemoryError:
        raise
    except Exception as error:  # a failed run is one row among the others
        return {**answer, "failure": described(error)}


def sweep(work: Sequence[Job], *, processes: int = 2, dask: str | None = None,
          done: Callable[[int, dict[str, Any]], None] = lambda count, answer: None, file: Kept | None = None,
          function: Callable[[Job], dict[str, Any]] = play, limit: float = TIME_LIMIT) -> list[dict[str, Any]]:
    """Runs all jobs and returns their answers in the order of ``work``.

    A job is answered when ``function`` has returned, be it with a failure of the run itself. Of a job whose process,
    worker or scheduler was lost the answer has the reason under ``not_played``; it is not written to ``file``, so that
    the next sweep with the file runs it.

    Args:
        work: the jobs.
        processes: local processes; not used with ``dask``.
        dask: address of a running Dask scheduler, e.g. ``tcp://host:8786``.
        done: called with the number of jobs finished and the last one's answer, once that is kept.
        file: where answers are written as they come; jobs that it holds are not run again.
        function: runs a job.
        limit: longest duration of a run [s]; one that hangs is ended, tried a second time, and then given up.

    Raises:
        InputError: a scene cannot be used, none of them knows a method, or no scheduler answers at ``dask``.
    """
    scenes = {job.scene: _scene(job.scene) for job in work if isinstance(job.scene, str)}
    loaded = [job.scene if isinstance(job.scene, Scene) else scenes[job.scene] for job in work]
    _check_names(loaded)
    _check_methods(work, {scene.kind for scene in loaded})
    digests = {id(scene): digest_of([program()["digest"], identity(scene), scene.model_dump(mode="json")])
               for scene in {id(scene): scene for scene in loaded}.values()}
    descriptions = [_described(job, digests[id(scene)]) for job, scene in zip(work, loaded, strict=True)]
    file = file or Kept()
    answers = [file.answers.get(key_of(description)) for description in descriptions]
    unanswered = [index for index, answer in enumerate(answers) if answer is None]
    tasks = [work[index] for index in unanswered]
    count = len(work) - len(unanswered)
    coming = (work_off_on(dask, tasks, function, limit) if dask
              else work_off(tasks, function, max(1, processes), limit))
    try:
        for place, answer in coming:
            index = unanswered[place]
            if isinstance(answer, LostError):
                answers[index] = {**_named(work[index]), "not_played": str(answer), "failure": f"not played: {answer}"}
                continue
            answers[index] = answer
            file.add(descriptions[index], answer)
            count += 1
            done(count, answer)
    finally:
        file.close()
    return [answer for answer in answers if answer is not None]


def sweep_scene(scene: str | Scene | Sequence[str | Scene], *, methods: Sequence[Any] = (),
                speeds: Sequence[float] = (), seeds: Sequence[int] = (), individuals: Sequence[int] = (),
                processes: int = 2, dask: str | None = None) -> pd.DataFrame:
    """Does many runs and returns a table with one row each; a failed run has its ``failure`` in its row.

    Args:
        scene: one or several, by name, path or as loaded.
        methods, speeds, seeds, individuals: as for ``jobs``; the scene's own if empty.
        processes, dask: how many local ones, or the address of a running Dask scheduler instead.

    Raises:
        InputError: a run's input cannot be used.
    """
    scenes = [scene] if isinstance(scene, str | Scene) else scene
    return pd.json_normalize(sweep(jobs(scenes, methods, speeds, seeds, individuals), processes=processes, dask=dask))


def _scene(scene: str | Scene) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene)


def _named(job: Job) -> dict[str, Any]:
    """What of an answer is known before anything is played."""
    return {"scene": job.scene.name if isinstance(job.scene, Scene) else job.scene,
            "method": job.method if isinstance(job.method, str | None) else None, "speed_m_s": job.speed,
            "seed": job.seed, **({} if job.individual is None else {"individual": job.individual}),
            **({} if job.world is None else {"world": job.world}), "failure": None}


def _check_names(scenes: Sequence[Scene]) -> None:
    """Raises InputError for two files with scenes of one name: nothing distinguishes their answers."""
    files: dict[str, str] = {}
    for scene in scenes:
        first = files.setdefault(scene.name, scene.source)
        if os.path.realpath(first) != os.path.realpath(scene.source):
            raise InputError(f"two scenes of the name {scene.name!r}: {first} and {scene.source}; give one another "
                             "name", field="scene")


def _check_methods(work: Sequence[Job], kinds: set[str]) -> None:
    known = sorted({key for kind in kinds for key in KINDS.get(kind).methods()})
    for job in work:
        if isinstance(job.method, str):
            method_of(job.method, known)


def _described(job: Job, digest: str) -> dict[str, Any]:
    """The job and a digest of program, model and scene: what has changed is played again."""
    method = job.method if isinstance(job.method, str | None) else repr(job.method)
    return {**_named(job), "method": method, "digest": digest}
