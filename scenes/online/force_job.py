"""Following a surface by force on devices: the planning of ``scenes.force`` with sensors that are elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import WRENCH
from planning import PlanningError
from planning.force.contact import ASKING, most_force
from scenes.online.configured import Configured, force_task
from scenes.online.contact import ContactSensor
from scenes.online.contact_witness import ContactWitness
from scenes.online.devices import Job
from scenes.online.felt_force import WITHIN, FeltForce, Surface, stiffness_of
from scenes.online.force_calibration import elasticity_by_pressing, tool_by_turning
from scenes.online.force_known import BRAKING, LONGEST, Known, force_reference
from scenes.online.live_arm import START_TOLERANCE, LiveArm, moves, near_start
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, ImaginedForce, LiveCamera, LiveForce, rehearse
from scenes.online.task import Task
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import CameraTrouble, ForceScene
from scenes.scene_files.scene import SceneError
from sensing.force.force_calibration import ContactElasticity, ToolLoad

_OTHER_TOOL, _OTHER_SURFACE = 0.05, 1.5
"""Difference of the tool's mass from the last run's that is no scatter [kg], and ratio of elasticities. On the
simulated cell three scenes differ by 0.006 kg and 1 %."""
# Until pressing and turning have told them.
_GUESS = ContactElasticity(4000.0, 1000.0, 0.0)  # [N/m]
_NO_LOAD = ToolLoad(np.zeros(6), 0.0, np.zeros(3), np.zeros(2))  # [N], [kg]


class ForceJob(Job):
    """A surface, a contour, or a line on a surface."""

    braking = BRAKING
    before: Mapping[str, Any] = MappingProxyType({})
    """Figures of the last run of this scene, with which the calibrations are compared."""
    scene: ForceScene
    _known: Known

    def _set_up(self) -> None:
        scene, robot = self.scene, self.robot
        self.needs = ("force", "camera") if scene.task == "glue" else ("force",)
        # What happens to the simulated camera is the world's.
        emergency = scene.emergency.model_copy(update={"force": min(scene.emergency.force, most_force(scene.force))})
        self.scene = scene.model_copy(update={"trouble": CameraTrouble(), "emergency": emergency})
        reference, profile = force_reference(scene, robot, reference_points(scene))
        self._known = Known(scene=self.scene, robot=robot, delay=self.delay, model=self.model, reference=reference,
                            profile=profile, camera=self.calibration.camera, asking=ASKING, detection=self.detection,
                            detector=FoundBefore())
        self.expected = profile.duration + 4.0
        self.longest = self.expected + LONGEST
        self.configured = self._new_task()
        self._force: LiveForce | None = None
        self._felt: FeltForce | None = None

    def _new_task(self) -> Configured:
        return force_task(self._known, self.method, _NO_LOAD, _GUESS, newest=True)

    def rehearse(self) -> None:
        """See ``Job``: the touch-down and a piece of the travel, felt at once."""
        configured, camera, force = self._new_task(), ImaginedCamera(), ImaginedForce()
        configured.connect(force, camera)
        if configured.camera is not None:
            camera.predict = configured.camera.predicted
        task, T = configured.task, self.robot.t_ipo
        try:
            rehearse(task, self.robot, math.ceil(0.2 / T))
            force.wrench = np.array([0.0, 0.0, -self.scene.force, 0.0, 0.0, 0.0])
            rehearse(task, self.robot, math.ceil(1.5 / T), first=math.ceil(0.2 / T))
        except PlanningError:
            # What is felt fits no surface: that is no matter here, the code is loaded.
            return

    def approach(self, arm: LiveArm, force: LiveForce | None) -> None:
        """See ``Job.approach``: up, where the tool is weighed, and down to the start as slowly as a touch asks for."""
        if force is None:
            raise SceneError("following a surface needs a force sensor")
        near_start(arm.link.commanded, self.q_start, START_TOLERANCE)
        self.watch_following(arm)
        self._felt = felt = arm.meanwhile(lambda: self._watch(force))
        arm.at_begin.append(felt.begin)
        arm.guard.watches.append(felt)
        felt.tool, above = tool_by_turning(self._known, self.q_start, arm, force)
        self._as_before("tool_mass_kg", mass := felt.tool.mass, "kg", lambda last: abs(mass - last) > _OTHER_TOOL)
        arm.lead(moves(self.robot, [above, self.q_start], 2 * self.robot.t_ipo))

    def _watch(self, force: LiveForce) -> FeltForce:
        """The force sensor as a watch over every motion."""
        known, frames = self._known, self._known.reference.frames(np.zeros(1))
        up = frames.up[0]
        surface = Surface(frames.position[0], up, WITHIN, stiffness_of(known.model, self.robot, self.q_start, up))
        return FeltForce(force, self.robot, surface, self.scene.emergency.force)

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """See ``Job.ready``: the elasticity by pressing."""
        felt = self._felt
        if force is None or felt is None or felt.tool is None:
            raise SceneError("following a surface needs a force sensor, and its tool weighed")
        tool = felt.tool
        elasticity = elasticity_by_pressing(self._known, self.q_start, arm, force, felt)
        self._as_before("elasticity_N_m", E := elasticity.stiffness, "N/m",
                        lambda last: max(E, last) > _OTHER_SURFACE * min(E, last))
        task, contact, eye = self.configured.task, self.contact, self.configured.camera
        arm.meanwhile(lambda: contact.calibrated(tool, elasticity))
        witness = ContactWitness(self.scene, contact.follower, force, elasticity, self.model)
        contact.witnessed(witness, arm.t_ipo < contact.at_once)
        self.configured.connect(force, camera)
        self._force = force
        felt.wanted = self.scene.force
        task.lead(arm)
        if camera is not None and eye is not None:
            camera.use(self.calibration.camera, self.calibration.time_offset)
            camera.predict = eye.predicted
        return task

    @property
    def contact(self) -> ContactSensor:
        """The force sensor of the task."""
        contact = self.configured.contact
        assert contact is not None  # of every scene of this kind
        return contact

    def _as_before(self, figure: str, value: float, unit: str, other: Callable[[float], bool]) -> None:
        """Raises ``SceneError`` where ``other`` says that a calibration differs from the figure of the last run."""
        last = self.before.get(figure)
        if isinstance(last, float) and last > 0.0 and other(last):
            raise SceneError(f"{figure} is {value:.3g} {unit} and was {last:.3g} {unit} at the last calibration; look "
                             "whether the tool is the same and firmly mounted, and if it is to be another one, follow "
                             "once with --no-check")

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: the wrench as sensed and the felt normal force; NaN before the first and behind the last."""
        columns: dict[str, Array] = {}
        sensed: Any = [] if self._force is None else self._force.samples
        for names, samples in ((("f_normal",), self.log.samples), (WRENCH, sensed)):
            if samples:
                rows = np.array(samples)
                order = np.argsort(rows[:, 0])
                columns |= {name: np.interp(t, rows[order, 0], rows[order, i], left=np.nan, right=np.nan)
                            for i, name in enumerate(names, start=1)}
        return columns

    def planned(self) -> Array:
        """See ``Job``."""
        return self.log.desired

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        log, wanted = self.log, self.scene.force
        moving = log.travel
        felt = np.array([force for t, force, *_ in log.samples if moving and moving[0] <= t <= moving[-1]])
        figures: dict[str, Any] = {"force_N": {
            "wanted": wanted, "rms_error": float(np.sqrt(np.mean((felt - wanted) ** 2))) if len(felt) else float("nan"),
            "largest": float(max((force for _, force, *_ in log.samples), default=float("nan")))},
            **self._calibrated()}
        if self.configured.camera is not None:
            figures["fields"] = {"seen": len(log.fields), "used": sum(1 for field in log.fields if field.values)}
        return figures

    def _calibrated(self) -> dict[str, float]:
        """What calibrations have found, the last run's where this one has not come so far."""
        keys = "elasticity_N_m", "tool_mass_kg"
        if self._force is None:
            return {key: float(self.before.get(key) or math.nan) for key in keys}
        return dict(zip(keys, (self.contact.elasticity.stiffness, self.contact.tool.mass), strict=True))
