"""Options that several verbs have, and the help and completion of ``--method``, which only asking for it loads."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

Bridge = Annotated[float, typer.Option(help="How long packets may be lost in a row [s].", min=0.0, max=1.0)]
ControllerAddress = Annotated[str | None, typer.Option(help="Listen to this address only.")]
Core = Annotated[int | None, typer.Option(help="Processor core to keep to.", min=0)]
Cycle = Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004; default: robot's.")]
DriveData = Annotated[Path | None, typer.Option(help="Drive data of the arm (TOML): gains, rotor inertias, cycles; "
                                                "default: beside the URDF.")]
Horizon = Annotated[int | None, typer.Option("--n-d", help="Desired positions the feedforward is given, from 1 up.")]
Individual = Annotated[int | None, typer.Option(help="Arm of the type, with a model of its own (see prepare).", min=0)]
JsonFigures = Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")]
JsonPlan = Annotated[Path | None, typer.Option(help="Write the plan and its figures as JSON to this file.")]
JsonResults = Annotated[Path | None, typer.Option(help="Write the results as JSON to this file.")]
ModelsRobot = Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                 "URDF; default: the one the model names.")]
PlannerDelay = Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")]
ReportFolder = Annotated[Path, typer.Option(help="Folder of the report.")]
Rest = Annotated[float, typer.Option(help="Rest added before the path [s], for the gears' deflection.")]
RobotName = Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a URDF.")]
SceneName = Annotated[str, typer.Argument(help="Name of a shipped scene, or path of a scene file (.toml).")]
SearchSeed = Annotated[int, typer.Option(help="Seed of the search.", min=0)]
Seed = Annotated[int | None, typer.Option(help="Seed instead of the scene's.", min=0)]
Speed = Annotated[float | None, typer.Option(help="Path speed [m/s] instead of the scene's.")]
WorldName = Annotated[str | None, typer.Option(help="Where it plays instead of the scene's world: workshop or bench.")]


def method_help(verb: str) -> str:
    """The help of a verb's ``--method``, with the keys where somebody asks for help of this very verb.

    Args:
        verb: ``rsi`` or ``precorrect``.
    """
    if verb in sys.argv and "--help" in sys.argv:
        return f"How the path is corrected: {', '.join(methods_of(verb))}."
    return "How the path is corrected."


def methods_of(verb: str) -> tuple[str, ...]:
    """Methods that a verb takes, those of other packages included.

    Args:
        verb: ``rsi`` (those that need no more than a model) or ``precorrect`` (that need no plays on the arm).
    """
    from ideal_robot.feedforward.method import Needs
    from ideal_robot.feedforward.registry import methods

    return methods(Needs.MODEL if verb == "rsi" else Needs.PATH)


def completed(verb: str, incomplete: str) -> list[str]:
    """Keys that begin with what was typed.

    Args:
        verb: as in ``methods_of``.
        incomplete: what was typed.
    """
    return [key for key in methods_of(verb) if key.startswith(incomplete)]
