"""A simulated arm with the sensors that it carries, each behind the interface of its device."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.row_log import RowLog
from sensing.camera.camera_device import Field, Gray, Window, WindowsAt
from sensing.force.sensors import WrenchSample
from sim.arm.arm import SimulatedArm
from sim.camera.camera import RenderedCamera
from sim.camera.lamp import ArmShape
from sim.contact.contact import ForceSensor, TipContact

# Data on their way from a device to the controller.

class Late(Protocol):
    """Data that are available some time after they were measured."""

    @property
    def t_arrival(self) -> float:
        """Controller time at which the data are available [s]."""
        ...


T = TypeVar("T", bound=Late)


class Arrivals(Generic[T]):
    """Keeps data until they arrive."""

    def __init__(self) -> None:
        self._under_way: list[T] = []

    def send(self, items: Iterable[T]) -> None:
        """Adds items that are on their way."""
        self._under_way.extend(items)

    def arrived(self, t: float) -> list[T]:
        """The items that have arrived by ``t`` [s], in order of arrival, each once."""
        here = sorted((item for item in self._under_way if item.t_arrival <= t), key=lambda item: item.t_arrival)
        self._under_way = [item for item in self._under_way if item.t_arrival > t]
        return here


AGAIN = 0.006
"""After which a field that comes twice comes again [s]."""


def shadow_of(shape: ArmShape | None, arm: SimulatedArm, t: float) -> tuple[Array, ...]:
    """Parts of the arm that may cast a shadow at a time: ends and radii of its capsules, as the camera takes them.

    Args:
        shape: of the arm; None where no lamp is.
        arm: the arm.
        t: within its history [s].
    """
    return () if shape is None else (shape.at(arm.q_at(t)), shape.radii)


class Carried(Protocol):
    """A simulated sensor on the arm: it measures while the arm moves."""

    def carry(self, t0: float, t1: float) -> None:
        """Notifies the sensor that the arm has moved from ``t0`` to ``t1`` [s]."""
        ...


@dataclass(frozen=True)
class Knock:
    """A disturbance of the camera's mounting at ``t`` [s].

    The camera is turned by ``yaw`` [rad] about the tool's approach axis through its own centre.
    """

    t: float
    yaw: float

    @classmethod
    def of(cls, table: Any) -> Knock | None:
        """The disturbance of the mounting given by the camera's table of a scene file; None where it gives none."""
        return cls(table.knock_s, math.radians(table.knock_deg)) if table.knock_deg else None


class CarriedCamera:
    """The simulated camera on the arm, as a ``sensing.camera.camera_device.Camera``.

    Args:
        camera, arm: the renderer, and the arm that carries it.
        knock: disturbance of its mounting; None for none.
    """

    def __init__(self, camera: RenderedCamera, arm: SimulatedArm, knock: Knock | None = None) -> None:
        self._camera, self._arm, self._knock = camera, arm, knock
        self._wanted: list[tuple[float, Sequence[Window]]] = []
        self._late: Arrivals[Field] = Arrivals()
        self._shape = ArmShape(arm.robot) if camera.lamp is not None else None
        camera.restart()

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """Asks for the fields of a cycle before it begins; see ``Camera.request``."""
        # The true instant of an exposure is unknown; windows are requested for the camera's own time stamp.
        requests = ((t, windows(self._camera.stamp(t))) for t in self._camera.due(t0, t1))
        self._wanted += [(t, wanted) for t, wanted in requests if wanted is not None]

    def arrived(self, t: float) -> list[Field]:
        """The fields that have arrived by the controller time ``t`` [s]; see ``Camera.arrived``."""
        return self._late.arrived(t)

    def carry(self, t0: float, t1: float) -> None:
        """Exposes the requested fields while the arm moves from ``t0`` to ``t1`` [s]."""
        for t, windows in self._wanted:
            field = self._camera.windows(t, self._tool_at, windows, *self._beside(t))
            again = replace(field, t_arrival=field.t_arrival + AGAIN)
            self._late.send([field, again] if self._camera.comes_twice(t) else [field])
        self._wanted = []

    def whole(self, seen: Field) -> Gray:
        """The whole picture ``(height, width)`` of a field, with its windows pasted in as they were read out."""
        return self._camera.whole(seen, self._tool_at, *self._beside(self._camera.exposed(seen.t_stamp)))

    def _beside(self, t: float) -> tuple[tuple[Array, ...], Array | None]:
        """What else a picture shows: who stands in the lamp's way, and the arm's angles ``(n,)`` [rad]."""
        return shadow_of(self._shape, self._arm, t), self._arm.q_at(t) if self._camera.shows_arm else None

    def _tool_at(self, t: float) -> pin.SE3:
        """Where the tool would be that carries the camera where it is, had the camera not been knocked."""
        tool = self._arm.tcp_at(t)
        if self._knock is None or t < self._knock.t:
            return tool
        model = self._camera.model
        return tool * model.perturbed(yaw=self._knock.yaw).T_tool_camera * model.T_tool_camera.inverse()


class CarriedForceSensor:
    """The simulated force sensor on the arm, as a ``sensing.force.sensors.ForceSensor``.

    Args:
        sensor, arm: the simulated sensor, and the arm that carries it.
        contact: of the tool's tip.

    Attributes:
        samples: of all that was measured the time [s] and the wrench [N, N m].
    """

    def __init__(self, sensor: ForceSensor, arm: SimulatedArm, contact: TipContact) -> None:
        self._sensor, self._arm, self._contact = sensor, arm, contact
        self._late: Arrivals[WrenchSample] = Arrivals()
        self.samples = RowLog(7)

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by the controller time ``t`` [s]; see ``ForceSensor.arrived``."""
        return self._late.arrived(t)

    def carry(self, t0: float, t1: float) -> None:
        """Measures samples while the arm moves from ``t0`` to ``t1`` [s]."""
        measured = self._sensor.due(t0, t1, self._arm.tcp_at, self._contact.force_at)
        for reading in measured:
            self.samples.append((reading.t, *reading.wrench))
        self._late.send(measured)


class EquippedArm:
    """A ``RobotInterface`` that moves the arm and lets its sensors measure meanwhile."""

    def __init__(self, arm: SimulatedArm, carried: Sequence[Carried]) -> None:
        self._arm, self._carried = arm, tuple(carried)
        self.t_ipo = arm.t_ipo
        self._cycles = 0

    def cycle(self, q_c: Array) -> RobotState:
        """Sends a command ``(n,)`` [rad] and waits one interpolation cycle; see ``RobotInterface.cycle``."""
        state = self._arm.cycle(q_c)
        t0 = self._cycles * self.t_ipo
        for device in self._carried:
            device.carry(t0, t0 + self.t_ipo)
        self._cycles += 1
        return state
