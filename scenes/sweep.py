"""Many runs: scenes × methods × speeds × seeds, on local processes or a running Dask cluster."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ideal_robot.errors import IdealRobotError, InputError
from scenes.kind import kind_of
from scenes.options import chosen
from scenes.result import silent
from scenes.scene import Scene
from scenes.scene_file import load_scene


@dataclass(frozen=True)
class Job:
    """One run of a sweep; ``speed``, ``seed`` and ``method`` None mean the scene's own."""

    scene: str | Scene
    method: Any
    speed: float | None
    seed: int | None


def jobs(scenes: Sequence[str | Scene], methods: Sequence[Any] = (), speeds: Sequence[float] = (),
         seeds: Sequence[int] = ()) -> list[Job]:
    """All combinations, in the order given; an empty list stands for the scene's own value.

    Args:
        scenes: names, paths of scene files, or scenes.
        methods: keys, or what ``run_scene`` takes besides; with more than one process it has to be importable.
        speeds: [m/s].
        seeds: of all that is drawn.
    """
    own: tuple[None] = (None,)
    product = itertools.product(scenes, methods or own, speeds or own, seeds or own)
    return [Job(scene, method, speed, seed) for scene, method, speed, seed in product]


def play(job: Job) -> dict[str, Any]:
    """Plays one job without writing anything; a failure is part of the answer, it does not end the sweep."""
    scene = job.scene if isinstance(job.scene, Scene) else load_scene(job.scene)
    scene = chosen(scene, speed=job.speed, seed=job.seed)
    key = job.method if isinstance(job.method, str | None) else None
    answer: dict[str, Any] = {"scene": scene.name, "method": key, "speed_m_s": getattr(scene, "speed", None),
                              "seed": scene.seed, "failure": None}
    try:
        result = kind_of(scene).run(scene, method=job.method, out=None, progress=silent)
    except InputError:
        raise
    except IdealRobotError as error:
        return {**answer, "failure": str(error)}
    return {**answer, **result.json(), "failure": result.failure}


def sweep(work: Sequence[Job], *, processes: int = 2, dask: str | None = None,
          done: Callable[[int], None] = lambda count: None) -> list[dict[str, Any]]:
    """Plays all jobs and returns their answers in the order of ``work``.

    Args:
        work: what to play.
        processes: local processes; not used with ``dask``.
        dask: address of a running Dask scheduler, e.g. ``tcp://host:8786``.
        done: called with the number of jobs finished.

    Raises:
        InputError: a job's input cannot be used, or no scheduler answers at ``dask``.
    """
    answers: list[dict[str, Any] | None] = [None] * len(work)
    for count, (index, answer) in enumerate(_dask(work, dask) if dask else _local(work, processes), start=1):
        answers[index] = answer
        done(count)
    return [answer for answer in answers if answer is not None]


def sweep_scene(scene: str | Scene | Sequence[str | Scene], *, methods: Sequence[Any] = (),
                speeds: Sequence[float] = (), seeds: Sequence[int] = (), processes: int = 2,
                dask: str | None = None) -> pd.DataFrame:
    """Plays many runs and returns a table with one row each; a run that fails is a row with its ``failure``.

    Args:
        scene: one or several, by name, path or as loaded.
        methods: keys; the scene's own if empty.
        speeds: [m/s]; the scene's own if empty.
        seeds: of all that is drawn; the scene's own if empty.
        processes: local processes.
        dask: address of a running Dask scheduler instead.

    Raises:
        InputError: a run's input cannot be used.
    """
    scenes = [scene] if isinstance(scene, str | Scene) else scene
    return pd.json_normalize(sweep(jobs(scenes, methods, speeds, seeds), processes=processes, dask=dask))


def _local(work: Sequence[Job], processes: int) -> Iterator[tuple[int, dict[str, Any]]]:
    with ProcessPoolExecutor(max_workers=max(1, processes)) as pool:
        pending = {pool.submit(play, job): index for index, job in enumerate(work)}
        try:
            for future in as_completed(pending):
                yield pending[future], future.result()
        except InputError:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _dask(work: Sequence[Job], address: str) -> Iterator[tuple[int, dict[str, Any]]]:
    try:
        from dask.distributed import Client
        from dask.distributed import as_completed as finished
    except ImportError as error:
        raise InputError("needs the package dask[distributed] (pip install 'ideal-robot[cluster]')",
                         field="--dask") from error
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no Dask scheduler answers ({error})", field="--dask", value=address) from error
    with client:
        pending = {client.submit(play, job, pure=False): index for index, job in enumerate(work)}
        keys = {future.key: index for future, index in pending.items()}
        for future, answer in finished(list(pending), with_results=True):
            yield keys[future.key], answer
