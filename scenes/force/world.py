"""The tables of a force scene as the world has them."""

from __future__ import annotations

import math

from scenes.force.scene import SensorTable, TipTable, UnknownSurface
from sim.contact.contact import HeightSurface, Tip, Wave
from sim.contact.force_sensor import ForceSensorSettings


def true_surface(table: UnknownSurface) -> HeightSurface:
    """The surface that the follower does not know."""
    waves = tuple(Wave(1e-3 * w.amplitude_mm, 1e-3 * w.wavelength_mm, math.radians(w.heading_deg),
                       math.radians(w.phase_deg)) for w in table.wave)
    return HeightSurface(table.pose(), waves, table.curvature, 1e-3 * table.crest_mm, 1e-3 * table.offset_mm,
                         table.slope)


def true_tip(table: TipTable) -> Tip:
    """The tool's elastic tip."""
    return Tip(table.stiffness, table.damping, table.friction)


def true_sensor(table: SensorTable) -> ForceSensorSettings:
    """The force sensor and the tool that hangs on it."""
    return ForceSensorSettings(**table.model_dump())
