"""Whether what a force sensor on a device tells can be: a push, where the surface is, and what the motors feel."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from planning.follower import Phase
from planning.force.contact import ASKED, EmergencyStopError, most_force
from planning.force.contour import LATELY, ContourFollower
from planning.force.felt_by_motors import BeyondSensor
from planning.force.force_follower import SurfaceFollower
from scenes.online.force_known import START_HEIGHT
from scenes.online.live_sensors import LiveForce
from scenes.scene_files.force_scene import ForceScene
from sensing.force.force_calibration import ContactElasticity

_BELOW = 1.25
"""Depth below where the surface was touched, as a share of what the wanted force takes, at which the tip is stopped."""
_IN_AIR = 0.003
"""Height above where the calibration touched the surface at which nothing can be felt [m]."""
_RECEDES = 0.3
"""Share of the wanted force by which a contour may lie deeper than forecast: 0.1 with a sound sensor, over 0.3 within
0.1 s with one that is stuck (``python -m studies faults``)."""
_TOUCHES, _SLIDES = 3.0, 0.5
"""Force that need not be a push [N], and the largest coefficient of friction that a tip has."""
_BY_MOTORS = 0.65
"""Share of the force that the surface bears beyond the wanted one of which the motors' word is enough."""
_PULLS = -3.0
"""Force that no surface exerts [N]."""
_UNSEEN = 5
"""Fusions of forces, 0.06 s of them, after which no field is fused before the sensor's signs of life are looked at."""


class ContactWitness:
    """Looks at what a force sensor tells, with what else is known of the contact.

    Args:
        scene: how hard is pressed.
        follower: what the forces are fused into.
        force: the sensor, and its signs of life.
        elasticity: of tip and surface, and where that was touched, from calibration.
        model: of the arm, of whose motors it is asked what they feel.

    Attributes:
        nearest: how near what was felt came to each limit, as a share of it.
    """

    def __init__(self, scene: ForceScene, follower: SurfaceFollower | ContourFollower, force: LiveForce,
                 elasticity: ContactElasticity, model: Model) -> None:
        self._scene, self._follower, self._force = scene, follower, force
        self._stiffness = elasticity.stiffness
        self._floor = elasticity.touch - _BELOW * scene.force / elasticity.stiffness
        """Height at the start of the path below which the tip does not go, and above which it feels nothing [m]."""
        self._ceiling = elasticity.touch + _IN_AIR
        self._motors = BeyondSensor(model, follower.robot.t_ipo)
        # What was felt of the tip's swing and not looked at, see ``SurfaceFollower.felt``.
        self._swung = list[Array]()
        self.nearest = dict[str, float]()

    @property
    def owes(self) -> bool:
        """See ``scenes.online.task.Sensor``."""
        return len(self._swung) >= _UNSEEN

    def fused(self, innovation: float, values: int) -> None:
        """See ``scenes.online.contact.Witness``: the map of a surface tells how well it fits."""
        if isinstance(self._follower, SurfaceFollower) and self._follower.phase is Phase.TRAVEL:
            self._force.signs.fits(innovation, values)
            self._swung.append(self._follower.felt)

    def look(self) -> None:
        """See ``scenes.online.contact.Witness``: does it answer the tip's swing, and what do the motors feel."""
        self._motors.weigh()
        if self._swung:
            self._force.signs.answers(np.concatenate(self._swung), self._stiffness, ASKED)
            self._swung.clear()

    def ended(self, t0: float, measured: RobotState, torque: Array) -> None:
        """See ``Sensor.ended``."""
        if self._follower.phase is Phase.TRAVEL:
            self._motors.hear(measured, torque[0] / self._scene.force, self._follower.force,
                              self._follower.speed_at(t0))

    def check(self, t: float) -> None:
        """Raises ``EmergencyStopError`` where what is felt at ``t`` [s] cannot be."""
        self._check_felt(t)
        self._check_height(t)

    def _check_felt(self, t: float) -> None:
        """What is felt is no push, fits no contour, or is not what the motors feel."""
        follower, scene = self._follower, self._scene
        if follower.force < _PULLS:
            raise EmergencyStopError("force", t, f"the force sensor feels the surface pull with {-follower.force:.1f} "
                                     "N; check its sign, its axes, and whether its bias has moved")
        if follower.phase in (Phase.SETTLE, Phase.TRAVEL) and self._beyond(
                "sideways", follower.sideways, max(_TOUCHES, _SLIDES * follower.force)):
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N felt out of the surface and "
                                     f"{follower.sideways:.1f} N along it, which is no push; look whether the force "
                                     "sensor is alive, and check its axes")
        if isinstance(follower, ContourFollower) and follower.phase is Phase.TRAVEL and self._beyond(
                "forecast", follower.recedes, _RECEDES * scene.force):
            raise EmergencyStopError("force", t, f"the contour lies deeper by {follower.recedes:.1f} N than it was "
                                     f"felt to go on {LATELY:.2f} s ago; look whether the force sensor is alive")
        if self._beyond("motors", self._motors.excess, _BY_MOTORS * (most_force(scene.force) - scene.force)):
            raise EmergencyStopError("force", t, f"the motors feel {self._motors.excess:.0f} N more than the "
                                     f"{follower.force:.0f} N of the force sensor; look whether it is alive, and "
                                     "whether its bias has moved")

    def _beyond(self, sign: str, value: float, limit: float) -> bool:
        """Whether a value is beyond its limit; keeps how near it came."""
        self.nearest[sign] = max(self.nearest.get(sign, 0.0), value / limit)
        return value > limit

    def _check_height(self, t: float) -> None:
        """The tip is higher or deeper than it can be with what is felt."""
        follower = self._follower
        height = START_HEIGHT - follower.descended
        if follower.phase is Phase.SETTLE and height > self._ceiling:
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N felt in the air, {1e3 * height:.1f} mm above "
                                     "the path's start; look whether the force sensor's bias has leapt")
        if follower.phase in (Phase.APPROACH, Phase.SETTLE) and height < self._floor:
            raise EmergencyStopError("force", t, f"the tip is {-1e3 * height:.1f} mm below the path's start, where "
                                     f"the calibration felt more than is wanted, and {follower.force:.1f} N are felt; "
                                     "look whether the force sensor is alive")
