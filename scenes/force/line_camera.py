"""The camera of a ``glue`` scene: fields of the drawn line on the curved surface, and what can go wrong with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.force.contact import FORCE_ERRORS
from planning.force.force_follower import SurfaceFollower
from planning.force.line_on_surface import LineOnSurface, SightSettings
from planning.line.deviation_model import PathDeviation
from planning.line.fusion import DeviationFilter
from scenes.force.known import N_D, Known
from scenes.force.scene import ForceScene
from sensing.camera.detector import DETECTORS, LineDetector
from sensing.camera.field import Field, Window
from sensing.camera.line_detection import DetectionSettings, LineField, search_windows
from sensing.camera.rolling_readout import at_middle_row

KNOWN = 1e-6
"""Standard deviation of a relative error that is not estimated."""
CONFIRM = 0
"""No rival hypotheses: with two sensors one that agrees would always outvote the other."""


def glue_fusion(cell: Known) -> DeviationFilter:
    """One filter for both sensors: a map in two directions, and the camera's own errors."""
    sight = SightSettings()
    assumed = cell.scene.assumed
    camera = (sight.yaw, sight.stamp, sight.scale if assumed.distance_estimated else KNOWN)
    force = FORCE_ERRORS if assumed.elasticity_estimated else (KNOWN, FORCE_ERRORS[1])
    ahead = (N_D + 6) * cell.robot.t_ipo * cell.profile.top_speed + 0.2
    model = PathDeviation(cell.reference, directions=2, ahead=ahead, behind=0.04, knot=0.02, displacement=0.02,
                          rotation=0.05, shape=0.01, length=0.1)
    return DeviationFilter(model, biases={"camera": camera, "force": force}, confirm=CONFIRM)


class GlueCamera:
    """The camera in the loop of a ``glue`` scene.

    Args:
        cell: what is known of the scene.
        follower: whose map the fields go into.
        rng: draws what garbage shows, where the scene has such trouble.
    """

    def __init__(self, cell: Known, follower: SurfaceFollower, rng: np.random.Generator) -> None:
        scene: ForceScene = cell.scene
        self._rng, self.follower, self._trouble = rng, follower, scene.trouble
        self.camera = cell.camera
        self.detection = DetectionSettings(line_width=1e-3 * scene.line.width_mm,
                                           dark=scene.line.gray < scene.line.background)
        reference = cell.reference
        span = (scene.reference.run_up, reference.length - scene.reference.run_out)
        sight = SightSettings(latency=scene.camera.latency, distance_ratio=scene.assumed.distance_ratio)
        self.sight = LineOnSurface(follower, self.camera.T_tool_camera, sight, span)
        self.detector: LineDetector = DETECTORS.get(scene.camera.detector)()
        self.fields: list[tuple[float, int, str]] = []
        self.first_used = float("nan")

    def windows(self, exposure: float) -> Sequence[Window] | None:
        """The windows to read out of the field exposed at ``exposure`` [s]; None while nothing arrives."""
        if self._during(self._trouble.loss, exposure):
            return None
        ahead = self.sight.predict(exposure).seen_by(self.camera, exposure, self.follower.history.row_pose)
        return search_windows(self.camera, ahead, self.detection)

    def sense(self, t: float, arrived: Sequence[Field]) -> None:
        """Evaluates the fields that have arrived by ``t`` [s] and fuses them."""
        for item in arrived:
            ahead = self.sight.predict(item.t_stamp).seen_by(self.camera, item.t_stamp, self.follower.history.row_pose)
            seen = at_middle_row(self.detector.detect(item, self.camera, ahead, self.detection), self.camera,
                                 self.follower.history.row_pose)
            if self._during(self._trouble.garbage, item.t_stamp):
                seen = self._garbage(seen)
            fused = self.sight.update(seen)
            dof = 0 if fused is None else fused.dof
            if dof and not np.isfinite(self.first_used):
                self.first_used = t
            self.fields.append((item.t_stamp, dof, seen.reason if fused is None else fused.reason))

    def _during(self, span: tuple[float, ...], t: float) -> bool:
        """Whether ``t`` lies in a span that counts from the beginning of the travel."""
        start = self.follower.t_travel
        return len(span) == 2 and start + span[0] <= t < start + span[1]

    def _garbage(self, seen: LineField) -> LineField:
        """Another field than the camera took: points anywhere beside the line, each claiming to be good."""
        size = 1e-3 * self._trouble.garbage_mm
        beside = size * self._rng.uniform(-1, 1) + 0.2 * size * self._rng.standard_normal(len(seen.points_tcp))
        points = seen.points_tcp.copy()
        points[:, 1] += beside
        return LineField(seen.t, points, seen.pixels, seen.lateral, seen.sigma, seen.quality, seen.used, seen.seen,
                         seen.reason)
