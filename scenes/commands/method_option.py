"""Help and completion of ``--method``: what the registry has, which is slow to load and read only when asked for."""

from __future__ import annotations

import sys


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
