"""The command line: one verb a job; the verbs stand by theme in ``scenes/commands``."""

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
    """A verb that begins only if what it is to read is there and its numbers are finite."""

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
    """The program: its page of help tells of each verb no more than name, theme and first sentence."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: dict[str, Any] = dict.fromkeys(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a verb, its options declared now: those of all verbs would double the time of an answer."""
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
    # The page of all verbs as plain text: what draws it in frames takes longer to load than the rest of the program.
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
    """The function of a verb, as it stands."""
    module, _, name = VERBS[verb].partition(":")
    function: Callable[..., None] = getattr(importlib.import_module(f"scenes.commands.{module}"), name)
    return function


def function_of(verb: str) -> Callable[..., None]:
    """The function that a verb calls, with a parameter for each option."""
    function = declared(verb)
    options = get_type_hints(function).get("options")
    return function if options is None else one_by_one(function, options)


def one_by_one(verb: Callable[..., None], options: type[Any]) -> Callable[..., None]:
    """A verb with a parameter for each option, as typer reads it, of one that takes them as one object.

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
    """Entry point: exit code 0 done, 1 the job failed, 2 bad input, each with one clear line.

    With ``IDEAL_ROBOT_DEBUG=1`` in the environment errors of the program itself show their traceback.
    """
    find_ours_first()
    if not _debugging():
        warnings.simplefilter("ignore")
    # The libraries' 300,000 objects stay: to look through them after every 700 new ones takes 0.3 s of a verb, to look
    # once more through those that are new 0.1 s.
    gc.set_threshold(50_000, 50)
    # On the way out nobody looks for circles among the libraries' objects, which takes half a second.
    atexit.register(gc.freeze)
    # As after Ctrl-C, partial files and worker processes are cleared away on the way out.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    # In the background of a shell it stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    sys.unraisablehook = _raised_again
    try:
        app()
    except KeyboardInterrupt:
        # Before a verb has begun; within it typer answers the same.
        sys.exit(130)
    except Exception as error:
        # Compiled code, while it is imported, makes other errors of a Ctrl-C.
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
        # From elsewhere and a little later: here it would be lost again.
        threading.Timer(0.05, os.kill, (os.getpid(), sent)).start()


def ended_by(error: BaseException) -> int:
    """Says in one line why a verb ended early, and returns the exit code: 2 for bad input, else 1.

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
        # What did not fit is given up by then: whether there is room shows what is written next.
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
