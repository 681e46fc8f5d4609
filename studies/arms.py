"""The line in the workshop with arms of one type: own models, a stranger's, adapted, and beside a run that knew."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.row_log import temporary_folder
from scenes.arms import arm_of
from scenes.commands.common import numbers, whole_numbers
from scenes.line.kind import run
from scenes.line.result import LineResult
from scenes.methods import ADAPTED, DIRECT, IDEAL, NONE, SENSOR_PATH
from scenes.models import own_model
from scenes.placing import place_line, scene_text
from scenes.scene_file import library, load_scene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import OWN, chosen
from scenes.sweep import SweepFile, jobs, sweep
from studies.report import head, listed, row, scene_of

WANTED = {0.7: {"mean": 0.045, "worst mean": 0.07}, 1.5: {"mean": 0.065, "worst mean": 0.11},
          2.0: {"mean": 0.09, "worst mean": 0.16}}
"""What is aimed at, by speed [mm]: the mean over all runs and the worst run's mean."""
HEAVY: dict[str, Any] = {"payload_mass": 2.0, "payload_com": (0.0, 0.0, -0.08)}
COLD: dict[str, Any] = {"start_temperature": 20.0}
CHANGES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "tool 2 kg heavier than told": {"world": HEAVY},
    "cold start, 20 °C": {"world": COLD},
    "both": {"world": HEAVY | COLD},
    "camera knocked by 0.5° midway": {"camera": {"knock_deg": 0.5}},
    "all three": {"world": HEAVY | COLD, "camera": {"knock_deg": 0.5}},
}
TOLD: dict[str, Any] = {"external_rotation_noise": 0.0}
"""A measuring device without noise, for joint angles that a study takes for the truth."""
ASSUMED = {"masses": "the links weigh", "some masses": "no arm's masses", "speeds": "no arm's speed limit",
           "efforts": "no effort", "end of a turn": "turns without end", "joints held": "is held",
           "tool's direction": "which is not the z axis"}
"""What is assumed of an arm, by words that `new` and `run` tell it with."""


def arms(lines: Path, individuals: str = "1-10", seeds: str = "1-3", speeds: str = "0.7,1.5,2",
         method: str = ADAPTED, processes: int = 2) -> None:
    """Ten arms with the models of their own motions at three speeds, mean / 95 % in mm, beside what is wanted.

    Answers go to the file LINES as they come; started again with the same file, the study goes on where it was. An
    arm's model takes 20 s of processor time (kept in the user's cache folder), a run 3 s.
    """
    every, draws, velocities = _whole(individuals), _whole(seeds), numbers(speeds, "--speeds")
    file, answers = SweepFile(lines, resume=lines.exists()), list[dict[str, Any]]()
    for individual in every:
        # Arm by arm, so that what is finished early is a whole row; two processes would identify one arm twice.
        work = jobs(["line"], speeds=velocities, seeds=draws, individuals=[individual], methods=[method])
        answers += [*sweep(work[:1], processes=1, file=file), *sweep(work[1:], processes=processes, file=file)]
    head("individual", *(f"{v:g} m/s, seed {s}" for v in velocities for s in draws))
    for individual in every:
        own = {(entry["speed_m_s"], entry["seed"]): entry for entry in answers if entry["individual"] == individual}
        row(individual, *(_cell(own[v, s]) for v in velocities for s in draws))
    print()
    head("m/s", "runs", "mean of the means", "worst run's mean", "largest 95 %", "largest", "failed", "wanted")
    for v in velocities:
        runs = [entry for entry in answers if entry["speed_m_s"] == v]
        whole = [entry["control_error_mm"] for entry in runs if not entry["failure"]]
        mean, p95, most = (np.array([error[key] for error in whole] or [np.nan]) for key in ("mean", "p95", "max"))
        row(f"{v:g}", len(runs), *(f"{x:.3f}" for x in (mean.mean(), mean.max(), p95.max(), most.max())),
            len(runs) - len(whole), ", ".join(f"{key} ≤ {bound:g}" for key, bound in WANTED.get(v, {}).items()))


def arms_models(individuals: str = "1-10", seeds: str = "1-3") -> None:
    """Ten arms with their own models and with a stranger's, that of the next individual: mean error in mm.

    A constant beside the line is the sensing's, not the arm's: what is left without each run's own stands apart.
    """
    every, draws = _whole(individuals), _whole(seeds)
    head("individual", "own, `ideal`", "own, `adapted`", "stranger's, `ideal`", "stranger's, `adapted`")
    errors = np.empty((4, len(every), 4, len(draws)))
    for i, individual in enumerate(every):
        scene, other = (chosen(scene_of(LineScene, "line"), individual=which)
                        for which in (individual, individual % 10 + 1))
        for whose, columns in ((scene, slice(0, 2)), (other, slice(2, 4))):
            errors[:, i, columns] = _played(scene.changed(model=_model(whose)), draws)
        row(individual, *_mm(errors[0, i].mean(axis=1)))
    for title, values in (("mean", errors[0].mean(axis=(0, 2))), ("worst run's mean", errors[0].max(axis=(0, 2))),
                          ("worst run's 95 %", errors[1].max(axis=(0, 2))),
                          ("mean without each run's constant", errors[2].mean(axis=(0, 2)))):
        row(title, *_mm(values))


def arms_adapted(individuals: str = "1-20", seeds: str = "6-8") -> None:
    """Each arm with its own model, adapted over not adapted: how much worse where nothing is to be adapted.

    With the standard error of the ratio over the seeds. Behind it the arm's part alone: what its joints leave of the
    planned path; what sensing adds is by chance with or against it.
    """
    head("individual", "`ideal`, mm", "`adapted`, mm", "`adapted` / `ideal`", "the same without each run's constant")
    sums, parts = [], {}
    for individual in _whole(individuals):
        scene = chosen(scene_of(LineScene, "line"), individual=individual)
        mean, _, varying, arm = _played(scene.changed(model=_model(scene)), _whole(seeds))
        parts[individual] = arm
        sums.append(np.stack([mean, varying]).mean(axis=2))
        row(individual, *_mm(sums[-1][0]), _ratio(*mean), _ratio(*varying))
    whole = np.mean(sums, axis=0)
    row("all", *_mm(whole[0]), *(f"{adapted / ideal:.2f}" for ideal, adapted in whole))
    print()
    head("individual", "the arm's part, `ideal`, mm", "`adapted`, mm", "`adapted` / `ideal`")
    for individual, arm in parts.items():
        row(individual, *_mm(arm.mean(axis=1)), _ratio(*arm))


def arms_cell(individuals: str = "1-20", seeds: str = "1-3") -> None:
    """Arms with their own models in a cell as it is, mean / 95 % in mm, beside direct feedback and the sensed path.

    An arm's model takes 90 s of processor time (kept in the user's cache folder), a run 15 s. Rows come as they end.
    """
    draws = _whole(seeds)
    head("individual", *(f"seed {seed}: `{ADAPTED}`" for seed in draws), f"`{SENSOR_PATH}`", f"`{DIRECT}`")
    means, p95 = list[float](), list[float]()
    for individual in _whole(individuals):
        scene = chosen(scene_of(LineScene, "line"), individual=individual).changed(world={"base": "cell"}, model=OWN)
        runs = np.array([_error(scene, seed, ADAPTED)[:2] for seed in draws])
        beside = [_error(scene, draws[0], method)[:2] for method in (SENSOR_PATH, DIRECT)]
        row(individual, *(" / ".join(_mm(one)) for one in (*runs, *beside)))
        means, p95 = [*means, *runs[:, 0]], [*p95, *runs[:, 1]]
    row("all", f"mean of the means {1e3 * np.nanmean(means):.3f}, worst {1e3 * np.nanmax(means):.3f}",
        f"mean of the 95 % {1e3 * np.nanmean(p95):.3f}, worst {1e3 * np.nanmax(p95):.3f}",
        f"failed {int(np.isnan(means).sum())} of {len(means)}")


def knew(seeds: int = 2, individual: int = 1) -> None:
    """A heavier tool, a cold start, a knocked camera: adapted beside the run that knew; mean errors in mm.

    Who knew has the model that the arm's identification motions gave with that tool on, or at that temperature; the
    camera was knocked before its calibration. Who adapts has the arm's model of before, warm and without the tool, and
    learns on the way. Wanted: at most 1.1 times the mean error of who knew.
    """
    line = chosen(scene_of(LineScene, "line"), individual=individual)
    before = _model(line)
    head("change", "knew", "adapted", "adapted / knew", "not adapted")
    for name, change in CHANGES.items():
        changed = line.changed(**change)
        # A knock that is over before calibration is a camera mounted otherwise: the same as none.
        informed = changed.changed(model=OWN, camera={"knock_deg": 0.0})
        known, learned, fixed = (
            [_error(scene, seed, method)[0] for seed in range(1, seeds + 1)]
            for scene, method in ((informed, IDEAL), (changed.changed(model=before), ADAPTED),
                                  (changed.changed(model=before), IDEAL)))
        row(name, listed(1e3 * np.array(known)), listed(1e3 * np.array(learned)),
            f"{np.mean(learned) / np.mean(known):.2f}", listed(1e3 * np.array(fixed)))


def urdfs(folder: Path, seed: int = 1) -> None:
    """Every URDF of a folder as `new NAME --robot URDF` and `run` play it, beside `none`; errors in mm.

    An arm takes one to five minutes of processor time, its own model most of it (kept in the user's cache folder).
    """
    head("arm", "joints", "m/s", "mean", "95 %", "`none`", "`none` / mean", "assumed")
    for urdf in sorted(folder.glob("*.urdf")):
        try:
            cells = _followed(urdf, seed)
        except IdealRobotError as error:
            cells = ["", "", f"refused: {error}"]
        row(urdf.stem, *cells)


def _followed(urdf: Path, seed: int) -> list[object]:
    """Joints, speed [m/s], errors with and without correction [mm] and what was assumed of an arm by its URDF."""
    template = scene_of(LineScene, "line").changed(robot=str(urdf), model=OWN)
    text = scene_text((library() / "line.toml").read_text(encoding="utf-8"), str(urdf.resolve()), place_line(template))
    with temporary_folder() as folder:
        file = Path(folder) / f"{urdf.stem}.toml"
        file.write_text(text, encoding="utf-8")
        scene = load_scene(str(file))
        assert isinstance(scene, LineScene)
        results = [run(scene.changed(seed=seed), method=method) for method in (ADAPTED, NONE)]
    errors = [result.control_error for result in results]
    assumptions = " ".join(scene.arm.assumed)
    assumed = ", ".join(name for name, says in ASSUMED.items() if says in assumptions) or "nothing"
    failure = " ".join(f"{result.failure}" for result in results if result.failure)
    return [scene.arm.n, f"{scene.speed:g}", *_mm([errors[0].mean, errors[0].p95, errors[1].mean]),
            f"{errors[1].mean / errors[0].mean:.0f}", failure or assumed]


def _whole(text: str) -> list[int]:
    return whole_numbers(text, "--individuals and --seeds")


def _model(scene: LineScene) -> str:
    """The model that the scene's arm gave by motions of its own."""
    return own_model(scene, arm_of(scene.robot))


def _error(scene: LineScene, seed: int, method: str) -> tuple[float, float, float, float]:
    """Mean error, 95 %, mean error less the run's constant, and the arm's part [m]; NaN where the run failed."""
    result = run(scene.changed(seed=seed), method=method)
    if result.failure:
        return np.nan, np.nan, np.nan, np.nan
    error = result.control_error
    varying = float(np.mean(np.abs(error.lateral - np.mean(error.lateral))))
    return error.mean, error.p95, varying, float(np.mean(np.abs(_arms_part(result))))


def _arms_part(result: LineResult) -> Array:
    """Where the true joint angles put the tool, to the left of where the desired ones do ``(N,)`` [m].

    Both by the geometry of the data sheet, so that its errors do not count. The recording's angles are those of a
    measuring device, whose noise is as large as the arm's part: the scene has to be ``TOLD``.
    """
    columns, robot = result.recording.columns, result.scene.arm
    t = columns["t"]
    q_a, q_d = (np.column_stack([columns[f"{kind}_{i + 1}"] for i in range(robot.n)]) for kind in ("qa", "q_d"))
    # Between the cycles the recording has straight lines, which leave a fast path.
    cycles = np.isclose(t / robot.t_ipo, np.round(t / robot.t_ipo), atol=1e-6)
    counts = np.isin(np.round(t, 6), np.round(result.control_error.t, 6))
    actual, desired = (robot.tool_places(angles)[:, :2]
                       for angles in (q_a[counts], CubicSpline(t[cycles], q_d[cycles])(t[counts])))
    along, off = np.gradient(desired, axis=0).T, (actual - desired).T
    return np.asarray((along[0] * off[1] - along[1] * off[0]) / np.maximum(np.hypot(*along), 1e-12))


def _played(scene: LineScene, seeds: Sequence[int]) -> Array:
    """What ``_error`` gives, by `ideal` and `adapted` ``(4, 2, seeds)`` [m]."""
    scene = scene.changed(world=TOLD)
    return np.array([[_error(scene, seed, method) for seed in seeds] for method in (IDEAL, ADAPTED)]).transpose(2, 0, 1)


def _ratio(ideal: Array, adapted: Array) -> str:
    """Ratio of the means over the seeds, with its standard error."""
    ratio = adapted.mean() / ideal.mean()
    if len(ideal) < 2:
        return f"{ratio:.2f}"
    return f"{ratio:.2f} ± {np.std(adapted - ratio * ideal, ddof=1) / np.sqrt(len(ideal)) / ideal.mean():.2f}"


def _mm(values: Sequence[float] | Array) -> list[str]:
    return [f"{1e3 * value:.3f}" for value in values]


def _cell(answer: dict[str, Any]) -> str:
    """Mean and 95 % of a run [mm], or that it failed."""
    error = answer["control_error_mm"]
    return "failed" if answer["failure"] else f"{error['mean']:.3f} / {error['p95']:.3f}"
