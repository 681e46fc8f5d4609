"""Checks whether a real sensor's force is plausible: its direction, the surface's place, and the motor torques."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from planning.follower import Phase
from planning.force.contact import ASKED, EmergencyStopError, most_force
from planning.force.contour import LATELY, ContourFollower
from planning.force.felt_by_motors import BeyondSensor
from planning.force.force_follower import SurfaceFollower
from scenes.online.felt_force import Surface
from scenes.online.live_sensors import LiveForce
from scenes.scene_files.force_scene import ForceScene
from sensing.force.force_calibration import ContactElasticity

_BELOW = 0.5
"""Depth below where the surface was touched at which the tip is stopped, as the force that it takes: this share of the
way from the wanted one to what the surface bears."""
_IN_AIR = 0.003
"""Height above where the calibration touched the surface at which nothing can be felt [m]."""
_RECEDES = 0.3
"""Share of the wanted force by which a contour may lie deeper than forecast: 0.1 with a sound sensor, over 0.3 within
0.1 s with one that is stuck (``python -m studies device-faults``)."""
_TOUCHES = 3.0
"""Force that need not be a push [N]."""
_SLIDES, _BEFORE = (0.5, 0.25), 1.2
"""Force along the surface as a share of the push with which a sound sensor is believed: 0.5 in any case, a quarter more
than the tip showed when it began to slide, which is what a slope of 14° adds; before that what no tip's friction comes
to, of rubber on steel neither."""
_SLIDING = (0.2, 0.7)
"""Time of the travel in which the tip shows its friction [s]: it has begun to slide, and is at most 0.1 m further."""
_BY_MOTORS = 0.65
"""Share of the force that the surface bears beyond the wanted one of which the motors' word is enough."""
_PULLS = -3.0
"""Force that no surface exerts [N]."""
_UNSEEN = 5
"""Fusions of forces, 0.06 s of them, after which no field is fused before the sensor's signs of life are looked at."""


class ContactWitness:
    """Checks a force sensor's readings against what else is known of the contact.

    Args:
        scene: the scene, which says the desired force.
        follower: receives the fused forces.
        force: the sensor, and its signs of life.
        elasticity: of tip and surface, and where that was touched, from calibration.
        model: of the arm, for the external force from its motor torques.
        surface: the point where the path begins, and the normal there.
        unsure: whether the arm may not move as it is commanded, by which no sensor is to be judged then.

    Attributes:
        nearest: largest value of each test so far, as a share of its limit.
    """

    def __init__(self, scene: ForceScene, follower: SurfaceFollower | ContourFollower, force: LiveForce,
                 elasticity: ContactElasticity, model: Model, surface: Surface,
                 unsure: Callable[[], bool] = lambda: False) -> None:
        self._unsure = unsure
        self._surface = surface
        self._scene, self._follower, self._force = scene, follower, force
        self._stiffness = elasticity.stiffness
        deepest = scene.force + _BELOW * (most_force(scene.force) - scene.force)
        self._floor = elasticity.touch - deepest / elasticity.stiffness
        """Height at the start of the path below which the tip does not go, and above which it feels nothing [m]."""
        self._ceiling = elasticity.touch + _IN_AIR
        self._motors = BeyondSensor(model, follower.robot.t_ipo)
        # Forces and heights of the tip's oscillation that are not yet checked, see ``SurfaceFollower.felt``.
        self._swung = list[Array]()
        # Start of the travel [s], and tangential force over normal force while the tip began to slide.
        self._travelling = np.inf
        self._slid = list[float]()
        self.nearest = dict[str, float]()

    @property
    def owes(self) -> bool:
        """Whether data have been fused since the last health check; see ``scenes.online.task.Sensor``."""
        return len(self._swung) >= _UNSEEN

    def fused(self, innovation: float, values: int) -> None:
        """Adds how well forces fit the map of a surface; see ``scenes.online.contact.Witness.fused``."""
        if self._unsure():
            return
        if not isinstance(self._follower, SurfaceFollower):
            return
        felt = self._follower.felt
        if self._follower.phase is Phase.SETTLE:
            # Checked already here, so that a sensor that fails as the travel begins is noticed.
            self._force.signs.swings(felt)
        elif self._follower.phase is Phase.TRAVEL:
            self._force.signs.fits(innovation, values)
            self._travelling = min(self._travelling, float(felt[0, 0]))
            self._swung.append(felt)

    def stood(self) -> None:
        """Notes that the arm stood; see ``scenes.online.contact.Witness``."""
        self._swung.clear()
        self._force.signs.begin()
        self._motors.stood()

    def look(self) -> None:
        """Checks that the sensor shows the tip's oscillation, and compares it with the motor torques."""
        self._motors.weigh()
        if self._swung:
            self._force.signs.swings(np.concatenate(self._swung))
            self._force.signs.answers(self._stiffness, ASKED)
            self._swung.clear()

    def ended(self, t0: float, measured: RobotState, torque: Array) -> None:
        """Notes the end of the cycle that began at ``t0`` [s]; see ``Sensor.ended``."""
        if self._follower.phase is Phase.TRAVEL:
            self._motors.hear(measured, torque[0] / self._scene.force, self._follower.force,
                              self._follower.speed_at(t0))

    def check(self, t: float) -> None:
        """Raises ``EmergencyStopError`` where the force at ``t`` [s] is implausible."""
        if self._follower.phase is Phase.TRAVEL:
            self._travelling = min(self._travelling, t)
        self._check_felt(t)
        self._check_height(t)

    def _check_felt(self, t: float) -> None:
        """What is felt is no push, fits no contour, or is not what the motors feel."""
        follower, scene = self._follower, self._scene
        if follower.force < _PULLS:
            raise EmergencyStopError("force", t, "the force sensor shows that the surface pulls with "
                                     f"{-follower.force:.1f} N; check its sign, its axes, and whether its bias has "
                                     "changed")
        if follower.phase in (Phase.SETTLE, Phase.TRAVEL) and self._beyond(
                "sideways", follower.sideways, max(_TOUCHES, self._most_along(t) * follower.force)):
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N measured out of the surface and "
                                     f"{follower.sideways:.1f} N along it, which is not a contact force; check "
                                     "that the force sensor works, and its axes")
        if isinstance(follower, ContourFollower) and follower.phase is Phase.TRAVEL and self._beyond(
                "forecast", follower.recedes, _RECEDES * scene.force):
            raise EmergencyStopError("force", t, f"the contour lies deeper than its course until {LATELY:.2f} s ago "
                                     "predicts, by a distance that would change the force by "
                                     f"{follower.recedes:.1f} N; check that the force sensor works")
        if self._beyond("motors", self._motors.excess, _BY_MOTORS * (most_force(scene.force) - scene.force)):
            raise EmergencyStopError("force", t, f"the motor torques show {self._motors.excess:.0f} N more than the "
                                     f"{follower.force:.0f} N of the force sensor; check that it works, and "
                                     "whether its bias has changed")

    def _most_along(self, t: float) -> float:
        """Largest force along the surface at ``t`` [s] as a share of the push; learns the tip's friction."""
        follower = self._follower
        if follower.phase is not Phase.TRAVEL:
            return _BEFORE
        since = t - self._travelling
        if _SLIDING[0] <= since <= _SLIDING[1] and follower.force > 0.0:
            self._slid.append(follower.sideways / follower.force)
        if since <= _SLIDING[1] or not self._slid:
            return _BEFORE
        return min(max(_SLIDES[0], median(self._slid) + _SLIDES[1]), _BEFORE)

    def _beyond(self, sign: str, value: float, limit: float) -> bool:
        """Whether a value is beyond its limit; keeps how near it came."""
        self.nearest[sign] = max(self.nearest.get(sign, 0.0), value / limit)
        return value > limit

    def _check_height(self, t: float) -> None:
        """The tip is higher or deeper than it can be with what is felt."""
        follower = self._follower
        # The measured tip position, as in the calibration: the command lies deeper by the arm's following error.
        height = float(self._surface.heights(follower.history.pose(t).translation[None])[0])
        if follower.phase is Phase.SETTLE and height > self._ceiling:
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N measured in the air, {1e3 * height:.1f} mm "
                                     "above the path's start; check whether the force sensor's bias has jumped")
        if follower.phase in (Phase.APPROACH, Phase.SETTLE) and height < self._floor:
            raise EmergencyStopError("force", t, f"the tip is {-1e3 * height:.1f} mm below the path's start, where "
                                     "the calibration measured more than the desired force, and "
                                     f"{follower.force:.1f} N are measured; check that the force sensor works")
