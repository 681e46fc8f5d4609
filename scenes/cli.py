"""The command line: one verb a job; the verbs stand by theme in ``scenes/commands``."""

from __future__ import annotations

import importlib
import inspect
import math
import os
import signal
import sys
import warnings
from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import cache, wraps
from typing import Annotated, Any, get_type_hints

# The small matrices here lose more to thread start-up than BLAS threads win; must be set before NumPy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402
from typer.core import TyperCommand  # noqa: E402

from ideal_robot.errors import IdealRobotError, InputError  # noqa: E402
from ideal_robot.whole_file import FULL, OutputError  # noqa: E402
from scenes.commands.common import shown  # noqa: E402
from scenes.shadowed import find_ours_first  # noqa: E402

THEMES = {
    "First steps": {
        "run": "play:run",
        "compare": "play:compare",
        "new": "files:new",
        "identify": "recordings:identify",
        "diagnose": "recordings:diagnose",
        "precorrect": "recordings:precorrect",
    },
    "More on scenes": {
        "sweep": "play:sweep",
        "check": "regression:check",
        "compare-results": "regression:compare_results",
        "close-loop": "play:close_loop",
        "prepare": "play:prepare",
    },
    "More on an arm": {
        "plan-identification": "motions:plan_identification",
        "plan-diagnosis": "motions:plan_diagnosis",
        "stiffness": "recordings:stiffness",
        "twin": "twins:twin",
    },
    "Devices": {
        "detect": "devices:detect",
        "follow": "devices:follow",
        "rsi": "devices:rsi",
        "simulate": "devices:simulate",
    },
    "Files": {
        "list": "files:list_",
        "view": "files:view",
        "export": "files:export",
        "fetch": "files:fetch",
    },
}
"""Themes of the help, and the verbs of each: module in ``scenes/commands`` and its function."""
VERBS = {verb: place for verbs in THEMES.values() for verb, place in verbs.items()}
"""All verbs, with the place of each."""

app = typer.Typer(
    name="ideal-robot",
    help="Makes a position-controlled industrial arm ideal, and lets sensors decide where its path is.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ideal-robot {importlib.import_module('importlib.metadata').version('ideal-robot')}")
        raise typer.Exit


@app.callback()
def _common(version: Annotated[bool, typer.Option("--version", callback=_say_version, is_eager=True,
                                                  help="Say the version and leave.")] = False) -> None:
    """Makes a position-controlled industrial arm ideal, and lets sensors decide where its path is."""


class Verb(TyperCommand):
    """A verb none of whose numbers may be ``nan`` or ``inf``, which ``float`` accepts."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """As the library does it, then looks at the numbers."""
        rest = super().parse_args(ctx, args)
        for param in self.params:
            value = ctx.params.get(param.name or "")
            for one in value if isinstance(value, (list, tuple)) else (value,):
                if isinstance(one, float) and not math.isfinite(one):
                    raise typer.BadParameter(f"{one} is no finite number", ctx=ctx, param_hint=" / ".join(param.opts))
        return rest


@cache
def _register(only: str = "") -> None:
    """Declares the verbs: the one that is told alone, since those that are not asked for cost as much as it does."""
    for theme, verbs in THEMES.items():
        for verb in verbs.keys() & {only} if only in VERBS else verbs:
            app.command(verb, cls=Verb, rich_help_panel=theme)(function_of(verb))


def function_of(verb: str) -> Callable[..., None]:
    """The function that a verb calls."""
    module, _, name = VERBS[verb].partition(":")
    found: Callable[..., None] = getattr(importlib.import_module(f"scenes.commands.{module}"), name)
    options = get_type_hints(found).get("options")
    return found if options is None else one_by_one(found, options)


def one_by_one(verb: Callable[..., None], options: type[Any]) -> Callable[..., None]:
    """A verb with a parameter for each option, as typer reads it, of one that takes them as one object.

    Args:
        verb: function of ``options`` alone.
        options: dataclass whose fields are declared as typer's parameters are.
    """
    hints = get_type_hints(options, include_extras=True)

    @wraps(verb)
    def called(**given: Any) -> None:
        verb(options(**given))

    called.__signature__ = inspect.Signature([  # type: ignore[attr-defined]
        inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, annotation=hints[field.name],
                          default=inspect.Parameter.empty if field.default is MISSING else field.default)
        for field in fields(options)])
    called.__annotations__ = hints
    return called


def main() -> None:
    """Entry point: exit code 0 done, 1 the job failed, 2 bad input, each with one clear line.

    With ``IDEAL_ROBOT_DEBUG=1`` in the environment errors of the program itself show their traceback.
    """
    find_ours_first()
    if not _debugging():
        warnings.simplefilter("ignore")
    # As after Ctrl-C, partial files and worker processes are cleared away on the way out.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        _register(*sys.argv[1:2])
        app()
    except KeyboardInterrupt:
        # Before a verb has begun; within it typer answers the same.
        sys.exit(130)
    except Exception as error:
        sys.exit(ended_by(error))


def ended_by(error: BaseException) -> int:
    """Says in one line why a verb ended early; with ``IDEAL_ROBOT_DEBUG`` an unexpected error is raised again.

    Args:
        error: what a verb raised.

    Returns:
        The exit code: 2 for bad input, else 1.
    """
    if isinstance(error, IdealRobotError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "not enough memory for this; use shorter recordings or fewer at once"
    elif isinstance(error, OSError) and error.errno in FULL and error.filename is None:
        text = str(OutputError.of("temporary files (TMPDIR), or compiled code (beside the program, or NUMBA_CACHE_DIR)",
                                  error))
    elif _debugging():
        raise error
    elif isinstance(error, OSError):
        text = str(error)
    else:
        text = (f"cannot be computed from this input ({f'{type(error).__name__}: {error}'[:300]}); if the input is "
                "right, report it with what IDEAL_ROBOT_DEBUG=1 in the environment shows")
    print(f"ideal-robot: {shown(text)}", file=sys.stderr)
    return 2 if isinstance(error, InputError) else 1


def _debugging() -> bool:
    return os.environ.get("IDEAL_ROBOT_DEBUG", "") not in ("", "0")


if __name__ == "__main__":
    main()
