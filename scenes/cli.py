"""The command line: one verb per task; the verbs are in ``scenes/commands`` by theme."""

from __future__ import annotations

import atexit
import errno
import gc
import importlib
import inspect
import math
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import MISSING, fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

# The small matrices here lose more to thread start-up than BLAS threads win; must be set before NumPy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402
from typer.core import TyperArgument, TyperCommand, TyperGroup  # noqa: E402

from ideal_robot.errors import IdealRobotError, InputError, described  # noqa: E402
from ideal_robot.whole_file import FULL, OutputError  # noqa: E402
from scenes.commands.common import shown  # noqa: E402
from scenes.program import find_ours_first  # noqa: E402

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
        "history": "regression:history",
        "compare-results": "regression:compare_results",
        "close-loop": "play:close_loop",
        "prepare": "play:prepare",
    },
    "More on an arm": {
        "plan-identification": "motions:plan_identification",
        "plan-diagnosis": "motions:plan_diagnosis",
        "inspect": "inspection:inspect",
        "stiffness": "recordings:stiffness",
        "validate": "recordings:validate",
        "twin": "files:twin",
    },
    "Devices": {
        "detect": "devices:detect",
        "calibrate": "devices:calibrate",
        "follow": "devices:follow",
        "play": "devices:play",
        "rsi": "devices:rsi",
        "simulate": "devices:simulate",
    },
    "Files": {
        "list": "files:list_",
        "examples": "files:examples",
        "view": "files:view",
        "export": "files:export",
        "fetch": "files:fetch",
    },
}
"""Themes of the help, and the verbs of each: module in ``scenes/commands`` and its function."""
VERBS = {verb: place for verbs in THEMES.values() for verb, place in verbs.items()}
"""All verbs, with the place of each."""


class Verb(TyperCommand):
    """A verb that starts only if its input files exist and its numbers are finite."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parses as the library does, then checks numbers, as ``float`` takes ``nan``, and files.

        Raises:
            InputError: a path that the verb takes as its argument, and so reads, leads nowhere, or any is too long.
        """
        rest = super().parse_args(ctx, args)
        for param, value in self._given(ctx):
            if isinstance(value, float) and not math.isfinite(value):
                raise typer.BadParameter(f"{value} is no finite number", ctx=ctx, param_hint=" / ".join(param.opts))
        for param, value in self._given(ctx):
            if isinstance(value, Path) and _too_long(value):
                raise InputError("no file can have so long a name", field=param.opts[0], value=f"{str(value)[:40]}…")
            if isinstance(value, Path) and isinstance(param, TyperArgument) and not os.path.exists(value):
                raise InputError(f"no such file or folder; expected: {param.help}", file=value)
        return rest

    def _given(self, ctx: typer.Context) -> Iterator[tuple[Any, Any]]:
        """Each parameter with its value, or with each of its values."""
        for param in self.params:
            value = ctx.params.get(param.name or "")
            yield from ((param, entry) for entry in (value if isinstance(value, (list, tuple)) else (value,)))


def _too_long(path: Path) -> bool:
    try:
        os.lstat(path)
    except OSError as error:
        return error.errno == errno.ENAMETOOLONG
    return False


class Program(TyperGroup):
    """The program; its help page lists each verb with name, theme and first sentence only."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: dict[str, Any] = dict.fromkeys(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a verb with its options, which are declared only now to save time at the start."""
        if cmd_name in VERBS and self.commands[cmd_name] is None:
            alone = typer.Typer(add_completion=False, rich_markup_mode="markdown")
            alone.command(cmd_name, cls=Verb)(function_of(cmd_name))
            self.commands[cmd_name] = typer.main.get_command(alone)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes the verbs by theme, each with the first sentence of its help."""
        for theme, verbs in THEMES.items():
            with formatter.section(theme):
                formatter.write_dl([(verb, (inspect.getdoc(declared(verb)) or "").split("\n\n")[0].replace("\n", " "))
                                    for verb in verbs])


app = typer.Typer(
    name="ideal-robot",
    cls=Program,
    help="Makes a position-controlled industrial arm ideal, and lets sensors decide where its path is.",
    no_args_is_help=True,
    # The page of all verbs is plain text: a library for frames takes longer to load than the rest of the program.
    rich_markup_mode=None,
    context_settings={"max_content_width": 110},
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


def declared(verb: str) -> Callable[..., None]:
    """The function of a verb, unchanged."""
    module, _, name = VERBS[verb].partition(":")
    function: Callable[..., None] = getattr(importlib.import_module(f"scenes.commands.{module}"), name)
    return function


def function_of(verb: str) -> Callable[..., None]:
    """The function that a verb calls, with one parameter per option."""
    function = declared(verb)
    options = get_type_hints(function).get("options")
    return function if options is None else one_by_one(function, options)


def one_by_one(verb: Callable[..., None], options: type[Any]) -> Callable[..., None]:
    """A function with one parameter per option, as typer needs it, for a verb that takes its options as one object.

    The fields of the class ``options`` are declared as typer's parameters are.
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
    """Runs the command line; exit code 0 done, 1 the task failed, 2 bad input, each with one clear line.

    With ``IDEAL_ROBOT_DEBUG=1`` in the environment errors of the program itself show their traceback.
    """
    find_ours_first()
    if not _debugging():
        warnings.simplefilter("ignore")
    # The libraries' 300,000 objects are never freed: a garbage collection after every 700 new objects costs a verb 0.3
    # s, one more with this threshold 0.1 s.
    gc.set_threshold(50_000, 50)
    # No garbage collection of the libraries' objects at exit, which takes half a second.
    atexit.register(gc.freeze)
    # As after Ctrl-C, partial files and worker processes are removed at exit.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    # In the background of a shell the signal stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    sys.unraisablehook = _raised_again
    try:
        app()
    except KeyboardInterrupt:
        # Ctrl-C before a verb has begun; within it typer exits in the same way.
        sys.exit(130)
    except Exception as error:
        # While compiled code is imported, Ctrl-C raises other errors.
        sys.exit(130 if _INTERRUPTED else ended_by(error))


_INTERRUPTED: list[int] = []
"""Signals by which the user has ended the program."""


def _interrupted(number: int, _: object) -> None:
    _INTERRUPTED.append(number)
    raise KeyboardInterrupt


def _raised_again(lost: Any) -> None:
    """Sends a signal once more that came where Python cannot raise, as while numba compiles: it is said and ignored."""
    sent = {SystemExit: signal.SIGTERM, KeyboardInterrupt: signal.SIGINT}.get(lost.exc_type)
    if sent is None:
        sys.__unraisablehook__(lost)
    else:
        # From another thread and a little later: here the signal would be lost again.
        threading.Timer(0.05, os.kill, (os.getpid(), sent)).start()


def ended_by(error: BaseException) -> int:
    """Prints in one line why a verb failed, and returns the exit code: 2 for bad input, else 1.

    With ``IDEAL_ROBOT_DEBUG`` an unexpected error is raised again.
    """
    if isinstance(error, IdealRobotError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "not enough memory for this; use shorter recordings or fewer at once"
    elif isinstance(error, OSError) and error.errno in FULL and error.filename is None and _output_is_full():
        text = str(OutputError.of("standard output", error))
    elif isinstance(error, OSError) and error.errno in FULL and error.filename is None:
        text = str(OutputError.of("temporary files (TMPDIR), or compiled code (beside the program, or NUMBA_CACHE_DIR)",
                                  error))
    elif _debugging():
        raise error
    elif isinstance(error, OSError):
        text = str(error)
    else:
        text = (f"cannot be computed from this input ({described(error)[:300]}); if the input is "
                "right, report it with what IDEAL_ROBOT_DEBUG=1 in the environment shows")
    print(f"ideal-robot: {shown(text)}", file=sys.stderr)
    return 2 if isinstance(error, InputError) else 1


def _output_is_full() -> bool:
    """Whether what was printed finds no room; what is left of it is then given up, so that nothing fails at the end."""
    try:
        # The buffered rest is discarded by then; the next write shows whether there is space.
        os.write(sys.stdout.fileno(), b"\n")
    except OSError as error:
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error.errno in FULL
    except ValueError:
        return False
    return False


def _debugging() -> bool:
    return os.environ.get("IDEAL_ROBOT_DEBUG", "") not in ("", "0")


if __name__ == "__main__":
    main()
