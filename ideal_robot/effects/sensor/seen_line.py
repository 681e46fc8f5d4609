"""What all effects of a camera that sees a line have in common: they move its points sideways on the line.

Only the part of a point's displacement across the line can be seen. For a point at ``u`` in the tool frame, with the
pose ``R, p`` of the tool at the time stamp and the line's normal ``n`` in the surface, a displacement ``du`` of the
measured point adds ``n' R du`` to its lateral deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import SENSOR
from ideal_robot.effects.signals import Signals

SPEED, DRIFT, ALONG, ACROSS, YAW, SCALE, CUBIC = ("line_speed", "line_drift", "line_along", "line_across", "line_yaw",
                                                  "line_scale", "line_cubic")
"""Names of the signals: what a unit of each motion of the measured points does across the line, less what another line
would do."""


class SeenLineEffect(Effect):
    """An effect whose columns are signals of the line's regression."""

    domain = SENSOR
    depends_on_joint = False
    needs: ClassVar[tuple[str, ...]] = ()

    def joints(self, signals: Signals) -> Iterator[int]:
        """The camera."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """A line has to be seen."""
        return all(name in signals.extra for name in self.needs)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 1, m)``."""
        return np.stack([signals.extra[name] for name in self.needs], axis=-1)[:, None, :]
