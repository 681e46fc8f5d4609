"""The table of where effects act, for the page ``docs/effects.md`` of the site: ``python -m docs.effects_table``."""

from __future__ import annotations

from ideal_robot.effects.base import Effect
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.registry import library

MARK = "<!-- where effects act -->"
"""Where the table stands in the page."""
_SMALL = 1e-3


def change_of(effect: Effect) -> LoopChange:
    """What an effect of some small size changes."""
    return effect.loop_change((_SMALL,) * len(effect.coefficient_names), (1.0,) * len(effect.theta_names))


def acting_table() -> str:
    """Markdown: effects by where they act, or why they do not, with the channels where each shows."""
    curve = Unknown(("q_1",), False, ((0.0, 1.0),))
    by_place: dict[str, dict[str, list[str]]] = {}
    for effect in (*library(), curve):
        change = change_of(effect)
        place = "; ".join(change.places) or f"nowhere ({change.nowhere})"
        by_place.setdefault(place, {}).setdefault(effect.name, []).append(effect.channel_prefix)
    rows = ["| acts in | effects, and where they show |", "| --- | --- |"]
    for place, effects in by_place.items():
        cell = ", ".join(f"`{name}` ({', '.join(channels)})" for name, channels in effects.items())
        rows.append(f"| {place} | {cell} |")
    return "\n".join(rows)


def with_table(document: str) -> str:
    """A page with the table in the place of its mark."""
    return document.replace(MARK, acting_table())


if __name__ == "__main__":
    print(acting_table())
