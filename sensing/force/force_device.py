"""The seam of force sensors: what a force/torque sensor at the flange gives."""

from __future__ import annotations

from typing import Protocol

from sensing.force.wrench import WrenchSample


class ForceSensor(Protocol):
    """A force/torque sensor as a device.

    It samples on its own clock. Each sample carries the *controller's* time of its measurement as well as the device
    knows it; where the sensor's clock drifts, diagnosis finds it (effect ``clock_drift``).
    """

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by the controller time ``t`` [s], in order of arrival, each once."""
        ...
