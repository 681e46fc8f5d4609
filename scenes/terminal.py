"""Text of users' files on its way to a terminal: shown as it is written, never obeyed."""

from __future__ import annotations


def shown(text: object) -> str:
    """The text on one line, with whatever a terminal would act on (escapes, bells, direction marks) spelt out."""
    return "".join(c if c.isprintable() else " " if c in "\n\t" else c.encode("unicode_escape").decode()
                   for c in str(text))
