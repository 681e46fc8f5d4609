"""Suite files: scenes, arms, seeds, speeds and methods to be run every night, with bounds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pydantic

from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError, did_you_mean
from ideal_robot.results import flat
from scenes.kind import kind_of
from scenes.methods import method_of
from scenes.regression.paired import Rules
from scenes.regression.results import MAIN, NOT_FIGURES, UNITS, Results, table, unit_of
from scenes.scene_file import load_scene
from scenes.scene_files.scene import Scene, Table, chosen, validated
from scenes.sweep import MOST, Job, jobs, sweep

_LIMIT = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµ]+)\s*")
_OF_CASE = ("method", "speed", "individual", "world")
"""What the jobs of one case have in common, beside the scene."""
_RANGE = re.compile(r"\s*(\d{1,9})\s*-\s*(\d{1,9})\s*")


class Case(Table):
    """Runs of a suite: all combinations of scenes, seeds, speeds, arms and methods; and bounds on their figures."""

    scenes: tuple[str, ...] = pydantic.Field(min_length=1)
    """Names of scenes, or paths of scene files as seen from the suite's folder."""
    seeds: tuple[pydantic.NonNegativeInt, ...] = ()
    """A list, or a range such as ``"1-10"``; each seed of the baseline is compared with the same seed."""
    speeds: tuple[float, ...] = ()
    """Speeds [m/s]; the scene's own if empty."""
    arms: tuple[int, ...] = ()
    """Arms of the type, each with a model of its own; the scene's arm if empty."""
    methods: tuple[str, ...] = ()
    """Methods; the scene's own if empty."""
    world: str | None = None
    """``workshop``, ``bench`` or ``cell``; the scene's own if not given."""
    bounds: dict[str, Any] = pydantic.Field(default_factory=dict)
    """Figure → largest mean of its size over the seeds, with its unit: ``"control_error_mm.p95" = "0.3 mm"``."""

    @pydantic.field_validator("seeds", mode="before")
    @classmethod
    def _of_a_range(cls, seeds: Any) -> Any:
        if not isinstance(seeds, str):
            return seeds
        match = _RANGE.fullmatch(seeds)
        if match is None or not 0 <= int(match[2]) - int(match[1]) < MOST:
            raise ValueError('expected a list of whole numbers, or a range such as "1-10"')
        return tuple(range(int(match[1]), int(match[2]) + 1))


class SuiteFile(Table):
    """Keys of a suite file: the cases that are run, and the figures that are compared with a baseline."""

    title: str
    """What the suite is for, on one line."""
    baseline: str | None = None
    """File of the baseline, as seen from the suite's folder; ``NAME.baseline.json`` where the check is begun if not
    given."""
    figures: tuple[str, ...] = pydantic.Field(default=MAIN, min_length=1)
    """What is compared; less is better, in size. Each is a figure of one of the scenes at least."""
    false_alarms: float = pydantic.Field(default=0.01, gt=0.0, lt=0.5)
    """Chance that an unchanged program is called worse or better, over all figures and cases together."""
    relevant: float = pydantic.Field(default=0.01, ge=0.0, lt=1.0)
    """Smallest change of a mean that counts, relative to the baseline's."""
    case: tuple[Case, ...] = pydantic.Field(min_length=1)
    """What is played."""


@dataclass(frozen=True)
class Played:
    """The runs of a suite with their bounds.

    Attributes:
        answers: in the order of ``Suite.work``; bounds: the bounds of each run's case.
        spared: scenes that do not depend on the seed, and how many further seeds of a case were not played.
    """

    answers: list[dict[str, Any]]
    bounds: list[dict[str, float]]
    spared: dict[str, int]


class Suite:
    """A suite file, its scenes loaded and its bounds in the figures' units; InputError for what is not known in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = validated(SuiteFile, read_toml(path, "a suite file"), path)
        self.baseline = path.parent / self.file.baseline if self.file.baseline else Path(f"{path.stem}.baseline.json")
        self.rules = Rules(self.file.false_alarms, self.file.relevant)
        self.work: list[tuple[Job, dict[str, float]]] = []
        """Jobs, and the bounds that hold for the mean of each one's case [the figures' units]."""
        self.places: dict[str, str] = {}
        """Name of each scene → as the command line takes it from here."""
        self._asked: list[tuple[str, str, set[str]]] = []
        self._figures: dict[str, set[str]] = {}
        known: dict[tuple[Any, ...], Job] = {}
        for number, case in enumerate(self.file.case):
            loaded = [_scene(name, path, f"case.{number}.scenes") for name in case.scenes]
            self.places |= {scene.name: str(_place(name, path))
                            for scene, name in zip(loaded, case.scenes, strict=True)}
            bounds = {figure: _bound(figure, value, path, f"case.{number}.bounds")
                      for figure, value in flat(case.bounds).items()}
            for figure in bounds:
                self._ask(f"case.{number}.bounds", figure, loaded)
            for job in jobs(loaded, case.methods, case.speeds, case.seeds, case.arms, case.world):
                assert isinstance(job.scene, Scene)
                _check_options(job.scene, job, path, number)
                key = (job.scene.name, *(getattr(job, name) for name in Job.__dataclass_fields__ if name != "scene"))
                if key in known:
                    raise InputError(f"has a run of {job.scene.name} twice; list it once",
                                     file=path, field=f"case.{number}")
                known[key] = job
                self.work.append((job, bounds))
        for figure in self.file.figures if "figures" in self.file.model_fields_set else ():
            self._ask("figures", figure, [job.scene for job, _ in self.work if isinstance(job.scene, Scene)])

    def _ask(self, field: str, figure: str, scenes: Sequence[Scene]) -> None:
        if figure in NOT_FIGURES:
            raise InputError(f"is a setting of a run, not a figure of its result; give figures such as "
                             f"{', '.join(MAIN)}", file=self.path, field=field, value=figure)
        self._asked.append((field, figure, {scene.name for scene in scenes}))

    def play(self, done: Callable[[int], None], **how: Any) -> Played:
        """Runs one seed of each scene first, then a second one of each case, then the others.

        Where the first two seeds of a case give the same figures to the last digit, the scene does not depend on the
        seed, and the other seeds are not run.

        Args:
            done: called with the number of runs finished.
            how: as for ``sweep``.

        Raises:
            InputError: as ``sweep`` does, and as ``check_figures`` does once these scenes have been run.
        """
        cases: dict[tuple[Any, ...], list[int]] = {}
        for i, (job, _) in enumerate(self.work):
            cases.setdefault((_name(job), *(getattr(job, name) for name in _OF_CASE)), []).append(i)
        first = {_name(job): i for i, (job, _) in reversed(list(enumerate(self.work)))}
        begun = sorted((i for case in cases.values() for i in case[:2]),
                       key=lambda i: (first[_name(self.work[i][0])] != i, i))
        answers: dict[int, dict[str, Any]] = {}

        def play(indices: list[int]) -> None:
            before = len(answers)

            def looked(count: int, answer: dict[str, Any]) -> None:
                self.check_figures(answer)
                done(before + count)

            answers.update(zip(indices, sweep([self.work[i][0] for i in indices], done=looked, **how), strict=True))
            for answer in answers.values():  # including those stored earlier
                self.check_figures(answer)

        play(begun)
        same = [case for case in cases.values() if len(case) > 2 and _one_run([answers[i] for i in case[:2]])]
        spared = {i for case in same for i in case[2:]}
        if rest := [i for i in range(len(self.work)) if i not in answers and i not in spared]:
            play(rest)
        return Played([answers[i] for i in sorted(answers)], [self.work[i][1] for i in sorted(answers)],
                      {_name(self.work[case[0]][0]): len(case) - 2 for case in same})

    def check_figures(self, answer: dict[str, Any]) -> None:
        """Raises InputError for compared or bounded figures that none of their scenes has.

        What a scene has is known from its first answer without a failure.

        Raises:
            InputError: none of the scenes of a figure has it.
        """
        if answer["failure"] is not None or answer["scene"] in self._figures:
            return
        self._figures[answer["scene"]] = set(Results(table([answer])).figures)
        for field, figure, scenes in self._asked:
            if scenes <= self._figures.keys():
                known = sorted(set().union(*(self._figures[scene] for scene in scenes)))
                if figure not in known:
                    raise InputError(f"no run of {', '.join(sorted(scenes))} has this figure; "
                                     f"{did_you_mean(figure, known)}there are {', '.join(known)}", file=self.path,
                                     field=field, value=figure)


def _one_run(answers: list[dict[str, Any]]) -> bool:
    """Whether runs of other seeds have all their figures in common, to the last digit."""
    if any(answer["failure"] is not None for answer in answers):
        return False
    results = Results(table(answers))
    return bool((results.runs[results.figures].nunique(dropna=False) == 1).all())


def _name(job: Job) -> str:
    assert isinstance(job.scene, Scene)
    return job.scene.name


def _place(name: str, suite: Path) -> str | Path:
    """A shipped scene's name, or the path of a scene file as seen from where the check is begun."""
    return suite.parent / name if name.endswith(".toml") or "/" in name else name


def _scene(name: str, suite: Path, field: str) -> Scene:
    try:
        return load_scene(_place(name, suite))
    except InputError as error:
        if error.field != "scene":
            raise
        raise InputError(error.message, file=suite, field=field, value=name) from error


def _check_options(scene: Scene, job: Job, suite: Path, number: int) -> None:
    """Raises InputError that names the case where a scene cannot be played so."""
    try:
        chosen(scene, speed=job.speed, individual=job.individual, world=job.world)
        if job.method is not None:
            method_of(job.method, kind_of(scene).methods())
    except InputError as error:
        raise InputError(error.message, file=suite, field=f"case.{number}.{(error.field or '').removeprefix('--')}",
                         value=error.value) from error


def _bound(figure: str, value: Any, suite: Path, field: str) -> float:
    unit = unit_of(figure)
    if unit is None:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        raise InputError(f"{figure} has no unit; {did_you_mean(figure, MAIN)}expected a number, or a figure such as "
                         "control_error_mm.p95", file=suite, field=field, value=value)
    allowed = UNITS[unit]
    parts = _LIMIT.fullmatch(value) if isinstance(value, str) else None
    if parts is None or parts[2] not in allowed or not float(parts[1]) * allowed[parts[2]] < math.inf:
        raise InputError(f"{figure} is bounded in {', '.join(allowed)}: write for instance \"0.3 {unit}\"", file=suite,
                         field=field, value=value)
    return float(parts[1]) * allowed[parts[2]]
