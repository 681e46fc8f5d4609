"""Watches the force sensor in every motion: force limit, speed towards a surface, contact.

Before its tool was weighed, forces are relative to those at rest, and a force that turns with the tool like a weight is
taken as its weight:

    f(t) - f(0) = m (R(t) - R(0))ᵀ g + contact,        m by least squares over what was felt so far.

How fast the tip may near a surface follows from the force that a touch may have grown to when it is answered,

    v ≤ (F_max - κ F_touch) / (E t_noticed)

with the ratio κ of the true force to the shown one, at its largest for an unknown gain, and the stiffness E of the arm
itself, which bounds that of the contact until it is measured. Places where the tip was without contact are free.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ideal_robot.arrays import GRAVITY, Array
from ideal_robot.execution.guard import Watch
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.contact import NOTICED, SLOPE
from planning.force.sensor_gain import UNKNOWN
from planning.path.kinematics import InverseKinematics
from scenes.online.live_sensors import LiveForce
from sensing.force.force_calibration import ToolLoad

TOUCH, UNWEIGHED = 5.0, 15.0
"""Force from which on a motion in the air touches something [N], with a tool that was weighed and with one that was
not: 15 N are what the weight of a sound sensor's tool does not come to while it is being found, and a hand bears."""
GONE = 1.0 / 3.0
"""Share of that below which nothing is touched any more."""
WITHIN = 0.045
"""Height above the surface as told within which it may begin [m]: one told 40 mm wrong is met slowly."""
KNOWN_WITHIN = 0.003
"""The same above a place where it was touched [m]."""
RIGID = 1e6
"""Stiffness of an arm whose gears are not known [N/m]."""
SAFE = 0.9
"""Share of the largest force that a touch may come to by what is known of the arm."""
ZEROED = 0.2
"""Rest in which the sensor is read before anything moves [s]."""
_FASTEST = 0.1
"""Speed of the tip towards a surface that nobody needs to exceed [m/s]."""
_REMEMBERED, _LATELY = 0.6, 0.15
"""Time of which motor angles are remembered, longer than a reading may be old, and the time in which a motion of the
tool still shows in what is felt [s]."""
_BY_NOISE = float(np.sqrt(chdtri(3, 1e-6)))
"""Standard deviations of an axis that a force of noise alone exceeds once in 10⁶ times."""
_PRIOR = 1e-3
"""Weight of no mass in the estimate of the tool's, as a change of direction squared [m²/s⁴]: of a tenth of a degree."""


@dataclass
class Surface:
    """Place and slope of the surface as far as they are known.

    Attributes:
        origin: a nominal place on it ``(3,)`` [m].
        up: unit normal away from it ``(3,)``.
        within: height above which it does not begin [m].
        stiffness: largest one with which the arm can press on it [N/m].
    """

    origin: Array
    up: Array
    within: float
    stiffness: float

    def heights(self, places: Array) -> Array:
        """Heights of ``places (N, 3)`` [m] above the surface ``(N,)`` [m]."""
        return np.asarray((places - self.origin) @ self.up)


def stiffness_of(model: Model, robot: Robot, q: Array, direction: Array) -> float:
    r"""Stiffness of an arm's gears against a force along a direction at its tool [N/m].

    :math:`1/E = \sum_j (J^T d)_j^2 / k_j` ([L] 2.1): arm and surface together are softer than the arm alone, however
    stiff the surface. ``RIGID`` where no gear's stiffness is known.

    Args:
        model: of the arm.
        robot: its kinematics.
        q: joint angles ``(n,)`` [rad].
        direction: unit vector ``(3,)`` in the base frame.
    """
    k = np.full(robot.n, np.inf) if model.gears is None else model.gears.rigid_if_unknown
    compliance = float(np.sum(InverseKinematics(robot).torque(q, direction) ** 2 / k))
    return 1.0 / max(compliance, 1.0 / RIGID)


class FeltForce(Watch):
    """The force sensor as a watch of the guard.

    Args:
        force: connected.
        robot: the arm that carries the sensor.
        surface: surface that may be touched; None where none is known.
        limit: largest force that a motion may press with [N].
        meets: force that a motion may meet which wants to press with none [N], where that is more than a touch.

    Attributes:
        wanted: force that the present motion wants to press with [N]; 0 where it wants to touch nothing.
        tool: bias and weight, once they are known.
        contact: force of the environment on the tool, by the last readings ``(3,)`` [N, tool frame].
        largest: size of the largest such force so far [N].
        ratio: the true force over the one that is shown which the sensor's gain may make of it.
    """

    def __init__(self, force: LiveForce, robot: Robot, surface: Surface | None, limit: float, *,
                 meets: float = 0.0) -> None:
        self._meets = meets
        self._force, self._robot, self._limit, self._surface = force, robot, limit, surface
        self._fk, self._T = robot.fk(), robot.t_ipo
        self.wanted, self.contact, self.ratio = 0.0, np.zeros(3), UNKNOWN.at_most
        self.tool: ToolLoad | None = None
        self._poses: deque[tuple[float, Array, Array]] = deque(maxlen=round(_REMEMBERED / robot.t_ipo))
        self._zero: tuple[Array, Array] | None = None
        self._rest: list[Array] = []
        self._weights = np.array([_PRIOR, 0.0])
        self._touching: bool | None = False
        self._count, self.largest = 1, 0.0

    @property
    def touching(self) -> bool | None:
        """Whether there is contact, see ``Watch``; None while the sensor is unreliable, or none is expected."""
        return self._touching or (None if self.wanted > 0.0 else self._touching)

    @property
    def within(self) -> float:
        """Height above which the space is free [m]."""
        return -np.inf if self._surface is None else self._surface.within

    @property
    def zeroed(self) -> bool:
        """Whether the readings without contact are known."""
        return self._zero is not None

    def found(self, touch: float, stiffness: float) -> None:
        """Sets the height [m] at which the surface begins and the stiffness [N/m] of the contact."""
        if self._surface is not None:
            self._surface.within, self._surface.stiffness = touch + KNOWN_WITHIN, stiffness

    @property
    def stiffness(self) -> float:
        """Largest stiffness of a contact with the surface [N/m]."""
        return RIGID if self._surface is None else self._surface.stiffness

    @property
    def nearing(self) -> float:
        """Largest permitted speed towards the surface [m/s]."""
        if self._surface is None:
            return _FASTEST
        room = SAFE * self._limit - self.ratio * self._touch
        return min(max(room, 1.0) / (self._surface.stiffness * NOTICED), _FASTEST)

    def rates(self, rows: Array, T: float) -> Array:
        """Permitted speed of each row, see ``Watch``: slow near a surface, and along one of unknown slope."""
        if self._surface is None:
            return np.ones(len(rows))
        places = self._robot.tool_places(rows)
        step = np.gradient(places, T, axis=0)
        up = step @ self._surface.up
        along = np.linalg.norm(step - up[:, None] * self._surface.up, axis=1)
        towards = np.maximum(SLOPE * along - up, 0.0)
        near = self._surface.heights(places) < self._surface.within
        return np.where(near & (towards > 0.0), np.minimum(self.nearing / np.maximum(towards, 1e-12), 1.0), 1.0)

    def begin(self) -> None:
        """Restarts the run's time."""
        self._poses.clear()

    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        """Why a motion has to end after this cycle; None where it may continue; see ``Watch.look``."""
        pose = self._fk(q)
        self._poses.append((t, pose.rotation, pose.translation))
        samples = self._force.take(t)
        if (trouble := self._force.trouble(t)) is not None:
            self._touching = None
            return trouble
        if samples:
            self.contact = self._felt(float(np.mean([sample.t for sample in samples])),
                                      np.mean([sample.wrench for sample in samples], axis=0))
            self._count = len(samples)
        felt, allowed = float(np.linalg.norm(self.contact)), self._allowed()
        self.largest = max(self.largest, felt)
        clear = GONE * self._touch + self._noise()
        self._touching = felt > (clear if self._touching else allowed if self.wanted == 0.0 else clear)
        if self._surface is not None and not self._touching:
            self._air()
        if felt <= allowed:
            return None
        where = self._where(pose.translation)
        if self.wanted == 0.0:
            most = "nothing should be touched" if self._meets == 0.0 else f"{self._meets:.0f} N may be met"
            return (f"{felt:.1f} N felt{where} by the force sensor, where {most}; look what is in "
                    "the way, where the surface really is, and whether the sensor's bias has leapt")
        return f"{felt:.1f} N felt{where} of {allowed:.0f} N allowed; look for an obstacle, or lower the speed"

    def _felt(self, t: float, wrench: Array) -> Array:
        """Contact force ``(3,)`` [N, tool frame] of a ``wrench (6,)`` at ``t`` [s]; zero while none is known."""
        rotation = min(self._poses, key=lambda known: abs(known[0] - t))[1]
        if self.tool is not None:
            return self.tool.contact(wrench, rotation)[:3]
        weight = rotation.T @ GRAVITY
        if self._zero is None:
            self._rest.append(wrench[:3])
            if len(self._rest) * self._T >= ZEROED:
                self._zero = np.mean(self._rest, axis=0), weight
            return np.zeros(3)
        change, turned = wrench[:3] - self._zero[0], weight - self._zero[1]
        self._weights += turned @ turned, turned @ change
        return np.asarray(change - self._mass * turned)

    @property
    def _touch(self) -> float:
        """Force from which on a motion in the air touches something [N]."""
        return TOUCH if self.tool is not None else UNWEIGHED

    @property
    def _mass(self) -> float:
        """Mass of the tool, as far as it is known [kg]; negative where the sensor has the other sign."""
        return self.tool.mass if self.tool is not None else float(self._weights[1] / self._weights[0])

    def _allowed(self) -> float:
        """Largest force that may be felt now [N]."""
        if self.wanted > 0.0:
            return self._limit / self.ratio
        # Force that the tool's own inertia may cause.
        rows = [place for t, _, place in self._poses if t >= self._poses[-1][0] - _LATELY]
        inertia = 0.0
        if len(rows) > 2:
            inertia = float(np.max(np.linalg.norm(np.diff(rows, n=2, axis=0), axis=1))) / self._T**2
        return max(self._touch, self._meets) + abs(self._mass) * inertia + self._noise()

    def _noise(self) -> float:
        """What noise alone shows in the mean of a cycle's readings once in 10⁶ times [N]: χ² of three axes."""
        noise = self._force.signs.noise
        return 0.0 if noise is None else _BY_NOISE * float(np.max(noise[:3])) / np.sqrt(self._count)

    def _air(self) -> None:
        """Takes note that the surface does not begin where the tip has been without feeling it."""
        surface = self._surface
        if surface is not None and self._zero is not None:
            # Forces arrive late, so the last positions are used.
            highest = max(surface.heights(np.array([place for t, _, place in self._poses
                                                    if t >= self._poses[-1][0] - _LATELY])))
            surface.within = min(surface.within, float(highest) + 1e-3)

    def _where(self, place: Array) -> str:
        if self._surface is None:
            return ""
        height = 1e3 * float(self._surface.heights(place[None])[0])
        return f" {abs(height):.1f} mm {'above' if height >= 0.0 else 'below'} where the path begins"

