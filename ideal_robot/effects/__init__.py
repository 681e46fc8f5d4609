"""The library of effects: causes of a residual that identification and diagnosis share."""

from __future__ import annotations

from ideal_robot.effects.base import Effect, EffectParameter, FittedEffect, Signals

__all__ = ["Effect", "EffectParameter", "FittedEffect", "Signals", "effect_of", "library"]


def library() -> dict[str, Effect]:
    """All effects by name."""
    return {}


def effect_of(fitted: FittedEffect) -> Effect:
    """The library's effect behind a fitted one.

    Raises:
        InputError: a model file names an effect that this version does not know.
    """
    from ideal_robot.errors import InputError

    known = library()
    if fitted.name not in known:
        raise InputError(f"unknown effect; known are {', '.join(sorted(known))}", field="effects", value=fitted.name)
    return known[fitted.name]
