"""Words that rate a number, coloured in tables: green for good, red for bad, gray for undecided."""

from __future__ import annotations

GOOD, BAD, OPEN = "good", "bad", "open"
COLOURS = {GOOD: "green", BAD: "red", OPEN: "bright_black"}
"""Of a terminal, by what a verdict is."""
_WORDS = {"better": GOOD, "same": GOOD, "kept": GOOD, "best": GOOD, "worse": BAD, "missed": BAD, "failed": BAD,
          "not comparable": OPEN, "usable": GOOD, "weak": OPEN, "unusable": BAD}


class Verdict(str):
    """A cell of a table that says whether something is good; as a string it is its text.

    Args:
        text: shown; begins with a word of ``_WORDS`` where ``kind`` is not given.
        kind: ``GOOD``, ``BAD`` or ``OPEN``.
    """

    __slots__ = ("kind",)
    kind: str

    def __new__(cls, text: str, kind: str | None = None) -> Verdict:
        """A verdict whose kind follows from its first word, before a colon, where none is given."""
        verdict = super().__new__(cls, text)
        verdict.kind = kind or _WORDS.get(text.partition(":")[0], OPEN)
        return verdict
