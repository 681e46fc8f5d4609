"""What each part of the task is worth: the same runs with one part switched off at a time."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from ideal_robot.errors import IdealRobotError
from planning.force import force_follower
from planning.line import line_follower
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement
from scenes.arms import arm_of
from scenes.commands.common import whole_numbers
from scenes.force import cell as force_cell
from scenes.force.kind import run as run_force
from scenes.line.kind import run as run_line
from scenes.line.play import POINTS
from scenes.methods import ADAPTED, IDEAL, SENSOR_PATH
from scenes.models import model_for
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_device import Field
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.sensors import WrenchSample
from sim.equipped_arm import CarriedCamera, CarriedForceSensor
from studies.report import head, row, scene_of

WRONG_GUESS = 1.3
"""True over guessed elasticity where no calibration has found it, one standard deviation of what is expected."""


class Forgetful(DeviationFilter):
    """Knows of each measurement alone, and of nothing before it."""

    def take(self, measurement: Measurement) -> Fused:
        """See ``DeviationFilter.take``."""
        self.hypotheses.begin()
        self._buffer.clear()
        return super().take(measurement)


@dataclass(frozen=True)
class Part:
    """One part, and how a run goes without it.

    Attributes:
        name: what is switched off.
        changes: of the scene.
        method: the scene's own if None.
        model: makes another model of the scene's.
        without: what is replaced meanwhile, each an object, the name of its attribute, and what it is then.
    """

    name: str
    changes: dict[str, Any] | None = None
    method: str | None = None
    model: Callable[[Any], Any] | None = None
    without: tuple[tuple[Any, str, Any], ...] = ()


def _fields_at_arrival(camera: CarriedCamera, t: float, arrived: Any = CarriedCamera.arrived) -> list[Field]:
    return [replace(field, t_stamp=field.t_arrival) for field in arrived(camera, t)]


def _forces_at_arrival(sensor: CarriedForceSensor, t: float, arrived: Any = CarriedForceSensor.arrived
                       ) -> list[WrenchSample]:
    return [replace(sample, t=sample.t_arrival) for sample in arrived(sensor, t)]


def _not_calibrated(scene: ForceScene) -> tuple[ToolLoad, ContactElasticity]:
    """A tool whose data sheet is right and a sensor without bias; a contact as stiff as somebody guesses."""
    load = ToolLoad(np.zeros(6), scene.sensor.mass, np.asarray(scene.sensor.com), np.zeros(2))
    return load, ContactElasticity(scene.tip.stiffness / WRONG_GUESS, 0.3 * scene.tip.stiffness, 0.0)


def _rigid(model: Any) -> Any:
    return replace(model, gears=None)


LINE = (
    Part("nothing"),
    Part("polynomial: each point of a field on its own", method=POINTS),
    Part("fusion: the last field alone", without=((line_follower, "DeviationFilter", Forgetful),)),
    Part("adaptation of friction", method=IDEAL),
    Part("feedforward: the sensed path as it is", method=SENSOR_PATH),
    Part("inverse: precorrection as printed in [G]", method="precorrected-printed"),
    Part("horizon: the current cycle alone", {"n_d": 1}),
    Part("latency: a field belongs to when it arrives", without=((CarriedCamera, "arrived", _fields_at_arrival),)),
    Part("calibration of the camera", {"calibration": {"by_moving": False}}),
    Part("stiffness of the gears in the model", model=_rigid),
)
FORCE = (
    Part("nothing"),
    Part("fusion: the last forces alone", without=((force_follower, "DeviationFilter", Forgetful),)),
    Part("adaptation of friction", method=IDEAL),
    Part("feedforward: the sensed path as it is", method=SENSOR_PATH),
    Part("latency: a force belongs to when it arrives", without=((CarriedForceSensor, "arrived", _forces_at_arrival),)),
    Part("estimate of the elasticity on the way", {"assumed": {"elasticity_estimated": False}}),
    Part("calibration of tool and contact", without=((force_cell, "calibrated", _not_calibrated),)),
    Part("friction as a dry run shows it", without=((force_cell, "friction_shown", lambda scene: None),)),
    Part("stiffness of the gears in the model", model=_rigid),
)


def parts(seeds: str = "1,2,3", scenes: str = "line,force_wave") -> None:
    """Each part of the task switched off by itself: distance from the line in mm, error of the force in N.

    `line` and `force_wave` in the workshop with the method `adapted`; a run that has to stop is said with why.
    """
    head("without", "mean mm, or RMS N, each seed", "times as much", "stopped")
    numbers = whole_numbers(seeds, "--seeds")
    for name in scenes.split(","):
        whole = math.nan
        for part in LINE if name != "force_wave" else FORCE:
            errors, stops = zip(*(_played(name, seed, part) for seed in numbers), strict=True)
            mean = float(np.mean(errors))
            whole = mean if part.name == "nothing" else whole
            stopped = [stop for stop in stops if stop]
            row(f"`{name}`: {part.name}", ", ".join(f"{error:.3f}" for error in errors), f"{mean / whole:.2f}",
                f"{len(stopped)} of {len(stops)}: {stopped[0].partition(',')[0]}" if stopped else "")


def _played(name: str, seed: int, part: Part) -> tuple[float, str]:
    """Error of a run [mm or N], and why it ended early."""
    with _without(part), tempfile.TemporaryDirectory() as folder:
        try:
            if name == "force_wave":
                scene: Any = scene_of(ForceScene, name).changed(seed=seed, **(part.changes or {}))
            else:
                scene = scene_of(LineScene, name).changed(seed=seed, **(part.changes or {}))
            if part.model is not None:
                model = part.model(model_for(scene, arm_of(scene.robot)))
                scene = scene.model_copy(update={"model": str(model.save(Path(folder) / "model.json"))})
            run: Any = (run_force if name == "force_wave" else run_line)(scene, method=part.method or ADAPTED)
        except IdealRobotError as refused:
            return math.nan, str(refused)
    error = run.figures.rms if name == "force_wave" else 1e3 * run.control_error.mean
    return float(error), run.failure or ""


@contextmanager
def _without(part: Part) -> Iterator[None]:
    with ExitStack() as stack:
        for of, attribute, other in part.without:
            stack.enter_context(mock.patch.object(of, attribute, other))
        yield
