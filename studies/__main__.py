"""One runner for all studies.

    python -m studies                  # lists them, a line each
    python -m studies NAME --help      # what a study plays and which options it has
    python -m studies NAME …

A study prints its tables as the pages under ``docs`` have them; ``docs/numbers.toml`` says which page publishes what.
"""

from __future__ import annotations

import ast
import importlib
import os
import sys
from pathlib import Path

# BLAS threads cost more than they gain with small matrices; must be set before NumPy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402

from ideal_robot.errors import IdealRobotError, InputError  # noqa: E402

GROUPS = {
    "speed and memory": {
        "speed": "speed", "line-cycles": "cycles", "cycle": "cycles", "planning": "cycles", "growth": "speed",
    },
    "accuracy": {
        "arms": "arms", "arms-models": "arms", "arms-adapted": "arms", "arms-cell": "arms",
        "knew": "arms", "urdfs": "arms", "controllers": "controllers", "controlled-line": "controlled_line",
        "five-commands": "five_commands", "drifting-lag": "drifting_lag", "fr3-line": "fr3_line",
        "paths": "paths", "paths-causes": "paths", "warm-up": "paths", "friction-sigma": "adapted_friction",
        "methods": "line", "horizon": "line", "latency": "line", "causes": "line",
        "world": "paths", "heating": "paths", "camera": "camera", "calibration": "camera", "detectors": "camera",
        "photographs": "photographs", "real-camera": "photographs",
        "line-weights": "line_photographs", "line-films": "line_photographs",
        "parts": "parts",
        "force": "force", "force-parts": "force", "stability": "force", "surface-shapes": "force",
        "forecast-errors": "force",
        "line-shapes": "line",
        "measured": "measured", "measured-commands": "measured",
        "measured-adapted": "measured", "twins": "measured", "twin-arms": "measured",
    },
    "strangers": {"strangers": "diagnoses", "each-effect": "diagnoses",
                  "sensors": "diagnoses", "users-way": "users_way"},
    "closings": {"outside": "closings"},
    "robustness": {
        "limits": "limits", "device-faults": "faults", "sound-forces": "faults",
        "lockstep": "lockstep", "link-faults": "link_faults",
        "sweep-kills": "sweeps", "sweep-efficiency": "sweeps", "sweep-plan": "sweeps", "check-suite": "sweeps",
        "rsi-hour": "rsi", "rsi-simulators": "rsi", "loopback": "loopback", "wires": "loopback",
        "follow-hour": "loopback",
    },
}
"""Studies by group: name → module here, whose function of that name plays it."""
STUDIES = {name: module for group in GROUPS.values() for name, module in group.items()}


def function_of(name: str) -> str:
    """Name of the function that plays a study."""
    return name.replace("-", "_")


def first_line(name: str) -> str:
    """First line of a study's docstring, without importing the study."""
    tree = ast.parse((Path(__file__).parent / f"{STUDIES[name]}.py").read_text(encoding="utf-8"))
    function = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function_of(name))
    return (ast.get_docstring(function) or "").partition("\n")[0]


def main(words: list[str] | None = None) -> None:
    """Lists the studies, or plays one.

    Args:
        words: name and options; those of the command line if None.
    """
    words = sys.argv[1:] if words is None else words
    if not words or words[0] in ("-h", "--help"):
        for group, studies in GROUPS.items():
            print(f"{group}:")
            for name in studies:
                print(f"  {name:18s} {first_line(name)}")
        return
    name, *rest = words
    if name not in STUDIES:
        raise SystemExit(f"no study is called {name!r}; python -m studies lists them")
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command(name)(getattr(importlib.import_module(f"studies.{STUDIES[name]}"), function_of(name)))
    try:
        app(rest, prog_name=f"python -m studies {name}")
    except IdealRobotError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2 if isinstance(error, InputError) else 1) from error


if __name__ == "__main__":
    main()
