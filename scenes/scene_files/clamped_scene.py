"""The files of clamped scenes: where the flange is clamped, and how the motors push."""

from __future__ import annotations

from typing import ClassVar, Literal

import pydantic

from scenes.scene_files.scene import BENCH, Scene, Table
from sim.contact.clamp import WRENCH

_LARGEST = 1e6
"""Force or mass [N or kg]."""


class ClampTable(Table):
    """The ``[clamp]`` table: where the flange is clamped, and how it is pushed."""

    configurations: tuple[tuple[float, ...], ...] = ()
    """Joint angles [rad]; none: the program chooses."""
    most: int = pydantic.Field(default=3, ge=1, le=12)
    """How many configurations the program may choose."""
    push: Literal["tool_z", "joints"] = "joints"
    """``tool_z``: force-controlled levels along −z of the tool ([J]); ``joints``: one motor after the other."""
    forces: tuple[float, ...] = pydantic.Field(
        default=(1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 7000.0), min_length=1, max_length=100)
    """Force levels of ``tool_z`` [N]; held upwards, then downwards."""
    components: tuple[str, ...] = WRENCH
    """Wrench components that the sensor records."""
    hold: float = pydantic.Field(default=2.0, gt=0.2, le=60.0)
    """Time at a level [s]."""
    payloads: tuple[float, ...] = ()
    """Masses hung on the unclamped flange for comparison [kg]; none: no comparison."""

    @pydantic.field_validator("forces", "payloads")
    @classmethod
    def _can_be(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0.0 < value <= _LARGEST for value in values):
            raise ValueError(f"expected numbers above 0, to {_LARGEST:g}")
        return values

    @pydantic.field_validator("components")
    @classmethod
    def _are_of_a_wrench(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        if not values or not set(values) <= set(WRENCH):
            raise ValueError(f"expected some of {', '.join(WRENCH)}")
        return values


class ClampedScene(Scene):
    """Keys of a scene in which the flange is clamped and the motors deflect the gears."""

    worlds: ClassVar[tuple[str, ...]] = (BENCH,)
    robot: str = "kr500"
    clamp: ClampTable = ClampTable()
