"""Verbs that plan motions: plan-identification, plan-diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ideal_robot.errors import InputError
from ideal_robot.progress import part_of
from ideal_robot.whole_file import whole_files
from scenes.commands.common import (
    ColumnsMap,
    DriveData,
    JointNames,
    JsonPlan,
    RobotName,
    SearchSeed,
    StatesTopic,
    progress_bar,
    recording_of,
    show_table,
    write_signed,
)
from scenes.outputs import check_outputs, folders_held, whole_folder
from scenes.scene_file import load_scene

if TYPE_CHECKING:
    from ideal_robot.diagnosis import DiagnosisPlan
    from ideal_robot.diagnosis.next_motion.questions import Open
    from ideal_robot.identification.excitation import Workspace
    from ideal_robot.model.model import Model
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording
    from scenes.result import Progress


InCell = Annotated[Path | None, typer.Option(help="Scene whose surface and boxes the arm keeps off, a name or a file; "
                                                  "default: only itself and its base plane.")]


@dataclass(kw_only=True)
class IdentificationMotion:
    """Options of ``plan-identification``."""

    robot: RobotName
    drive_data: DriveData = None
    method: Annotated[str, typer.Option(help="joint (optimised Fourier series) or two-step (trapezoidal moves at "
                                             "operating points, [G] 3.1.2).")] = "joint"
    period: Annotated[float, typer.Option(help="Period of the Fourier motion [s].", min=1.0)] = 20.0
    points: Annotated[int, typer.Option(help="Operating points of the two-step method.", min=2)] = 10
    seed: SearchSeed = 1
    z_min: Annotated[float | None, typer.Option(help="Lowest height of tool and links [m]; default: 0.15, less for "
                                                     "arms that reach less than 1 m or stand low.")] = None
    cell: InCell = None
    play: Annotated[bool, typer.Option("--play", help="Play it on the simulated arm and record it.")] = False
    json: JsonPlan = None
    out: Annotated[Path, typer.Option(help="Folder of program, commands and recording.")] = Path("out/plan")


def plan_identification(options: IdentificationMotion) -> None:
    """Plans an identification motion within the limits, writes it out, and on request plays it in simulation.

    Writes `commands.csv` (joint angles every interpolation cycle) and, for the two-step method, the program of moves as
    `program.txt` and `program.json`. Look at the motion before it goes to a real arm: limits, floor and base column
    are known here, and of what stands in the cell only what the scene `--cell` names.

    Example: `ideal-robot plan-identification --robot kr6 --play --out out/plan`
    """
    from ideal_robot.robots.robot import Robot
    from scenes.identification.plan import plan, play_plan

    check_outputs({"--out": options.out}, json=options.json)
    arm = Robot.load(options.robot, options.drive_data)
    workspace = _workspace(arm, options.z_min, options.cell)
    with progress_bar("plan") as progress:
        planned = plan(arm, options.method, seed=options.seed, period=options.period, points=options.points,
                       workspace=workspace)
        progress(0.2, "playing" if options.play else "")
        content = planned.json()
        recording = play_plan(planned, arm, options.seed,
                              lambda share: progress(0.2 + 0.8 * share, "playing")) if options.play else None
        with folders_held():
            with whole_folder(options.out) as new:
                files = [options.out / file.name for file in planned.write(new)]
                if recording is not None:
                    files.append(options.out / recording.write(new / "recording.parquet").name)
                    content["recording"] = str(files[-1])
            write_signed(options.json, content)
    show_table(f"identification motion of {arm.name}", ["figure", "value"],
               [[key, value] for key, value in content.items() if isinstance(value, (int, float, str))])
    for path in files:
        typer.echo(f"written: {path}")


@dataclass(kw_only=True)
class DiagnosticMotion:
    """Options of ``plan-diagnosis``."""

    recording: Annotated[Path, typer.Argument(help="Recording that was diagnosed (Parquet, CSV, ROS 2 bag or MCAP).")]
    robot: RobotName
    columns: ColumnsMap = None
    topic: StatesTopic = None
    joints: JointNames = None
    result: Annotated[Path | None, typer.Option(help="What diagnose --json wrote of it; without it the recording is "
                                                     "diagnosed now.")] = None
    model: Annotated[Path | None, typer.Option(help="Model that the diagnosis was given.")] = None
    drive_data: DriveData = None
    length: Annotated[float, typer.Option(help="Longest motion [s], 4 to 600.")] = 30.0
    z_min: Annotated[float | None, typer.Option(help="Lowest height of tool and links [m]; wherever the recording has "
                                                     "been is allowed too; default: by the arm's size.")] = None
    cell: InCell = None
    seed: SearchSeed = 1
    json: JsonPlan = None
    out: Annotated[Path, typer.Option(help="File of the motion (CSV or Parquet).")] = Path("out/plan-diagnosis.csv")


def plan_diagnosis(options: DiagnosticMotion) -> None:
    """Plans the motion that separates causes which a recording could not distinguish, or says what else would.

    The motion has `t` and the joint angles `q_d_i` (as commands `q_c_i`) at the interpolation cycle, from rest to rest,
    within the limits of position, speed and acceleration. It begins where the recording began. Look at it before it
    goes to a real arm: limits, floor and base column are known here, and of what stands in the cell only what the
    scene `--cell` names. Play it, record it, diagnose it.

    Example, after that of `diagnose`:
    `ideal-robot plan-diagnosis out/plan/recording.parquet --robot kr6 --result diagnosis.json --out motion.csv`
    """
    from ideal_robot.diagnosis import plan_diagnosis
    from ideal_robot.model.model import Model
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import WRITTEN

    check_outputs(out=options.out, json=options.json)
    if options.out.suffix not in WRITTEN:
        raise InputError(f"expected a name ending in {' or '.join(WRITTEN)}", field="--out", value=str(options.out))
    arm = Robot.load(options.robot, options.drive_data)
    recording = recording_of(options.recording, options.columns, options.topic, options.joints)
    workspace = _workspace(arm, options.z_min, options.cell)
    known = None if options.model is None else Model.load(options.model)
    with progress_bar("plan-diagnosis") as progress:
        questions = _questions(options.result, recording, arm, known, progress)
        begun = 0.0 if options.result is not None else 0.5
        plan = plan_diagnosis(recording, arm, questions, model=known, longest=options.length, workspace=workspace,
                              seed=options.seed, progress=part_of(progress, begun, 1.0 - begun))
        with whole_files(options.out if plan.useful else None, options.json) as (motion_file, json_file):
            if motion_file is not None:
                plan.path().write(motion_file)
            write_signed(json_file, {**plan.to_dict(), "motion": str(options.out) if plan.useful else None})
    _show_planned(plan, options.out)


def _workspace(arm: Robot, z_min: float | None, cell: Path | None) -> Workspace:
    """The space for tool and links: by the arm's size or a given height [m], and off the obstacles of a scene."""
    from ideal_robot.identification.excitation import Workspace

    workspace = Workspace.of(arm) if z_min is None else replace(Workspace.of(arm), z_min=z_min)
    if cell is None:
        return workspace
    from scenes.line_way import shapes_in

    return replace(workspace, cell=shapes_in(load_scene(cell), arm))


def _questions(result: Path | None, recording: Recording, arm: Robot, known: Model | None,
               progress: Progress) -> Open:
    """What a diagnosis left open: as its file says, or of one that is made now, in half of the time."""
    from ideal_robot.bounded_values import read_json
    from ideal_robot.diagnosis import diagnose, open_questions, read_questions

    if result is not None:
        diagnosis = read_json(result, "a diagnosis")
        questions = read_questions(diagnosis, arm.n, result)
        if diagnosis.get("recording_hash", recording.hash) != recording.hash:
            raise InputError("is of another recording; give the one that was diagnosed, or no --result", file=result,
                             field="recording_hash", value=diagnosis["recording_hash"])
        return questions
    return open_questions(diagnose(recording, arm, model=known, progress=part_of(progress, 0.0, 0.5)))


def _show_planned(plan: DiagnosisPlan, out: Path) -> None:
    """Prints how well each pair of causes is distinguished, what no motion can decide, and where the motion is."""
    if plan.pairs:
        show_table("what is to be distinguished: standard deviations between the two, and share of its own",
                   ["cause", "or", "recorded σ", "own %", "planned σ", "own %", "distinguishable"],
                   [[pair.cause, pair.rival or "none", pair.before.sigma, 100.0 * pair.before.own_share,
                     pair.planned.sigma, 100.0 * pair.planned.own_share, "yes" if pair.told_apart else pair.only]
                    for pair in plan.pairs])
    for reason in plan.not_asked:
        typer.echo(f"not planned: {reason}", err=True)
    for joint in plan.still_undecided:
        typer.echo(f"joint {joint} moves too little in this motion too; its limits or the workspace prevent "
                   "more", err=True)
    if plan.useful:
        typer.echo(f"motion of {plan.seconds:.1f} s: {out}")
    elif plan.pairs:
        typer.echo("no motion is written: no motion within the limits distinguishes these causes")
    else:
        typer.echo("no question is open that a motion of the joints could answer")
