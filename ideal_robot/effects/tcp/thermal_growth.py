"""Links that grow with warmth."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import TCP_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.thermal_drift import warming_bounds, warming_starts


class ThermalGrowth(Effect):
    """The link behind a joint grows with warmth: ``delta x = e w (p_(j+1) - p_j)``, ``w`` as in ``thermal_drift``."""

    name = "thermal_growth"
    domain = TCP_POSITION
    depends_on_joint = False
    geometric = True
    theta_names = ("T",)
    theta_units = ("s",)
    coefficient_names = ("strain",)
    coefficient_units = ("1",)
    source = "linear expansion, 12e-6/K for steel, 24e-6/K for aluminium"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be known."""
        return signals.frames is not None

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """By temperature if it varies; by time with constants from a tenth of the recording to three of it."""
        return warming_starts(signals, joint)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """As ``thermal_drift``."""
        return warming_bounds(signals)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 3, 1)``."""
        frames = signals.frames
        if frames is None:
            return np.zeros((len(signals.t), 3, 1))
        if theta[0] > 0.0 or signals.temperature is None:
            warm = 1.0 - np.exp(-signals.t / max(theta[0], 1e-9))
        else:
            warm = signals.temperature[:, joint - 1] - signals.temperature[0, joint - 1]
        end = frames.tool
        if joint < signals.n:
            end, axis = frames.position[:, joint], frames.axis[:, joint]
            if np.allclose(frames.jacobian[:, :, joint], axis, atol=1e-9):
                # Behind the link a joint slides: its way is no length of the link.
                end = end - axis * signals.q[:, joint, None]
        return np.asarray(((end - frames.position[:, joint - 1]) * warm[:, None])[:, :, None])

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: the loop is not told how warm the link is."""
        return LoopChange(nowhere="how warm a link is when a path begins cannot be told from the time since a "
                                  "recording began, and the positional interface gives no temperature")
