"""Camera faults of a ``glue`` scene during the run: fields do not arrive, or show something else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from planning.follower import Follower
from scenes.scene_files.force_scene import CameraTrouble
from sensing.camera.camera_device import Camera, Field, Window, WindowsAt
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine


class Trouble:
    """Camera faults by time, from the beginning of a travel on.

    Args:
        table: spans of time, and how large it is.
        rng: random generator of the faults, separate from that of the picture noise.

    Attributes:
        follower: the follower whose travel it is; without it there are no faults.
    """

    def __init__(self, table: CameraTrouble, rng: np.random.Generator) -> None:
        self._table, self._rng = table, rng.spawn(1)[0]
        self.follower: Follower | None = None

    def _during(self, span: tuple[float, ...], t: float) -> bool:
        """Whether ``t`` [s] lies in a span."""
        start = np.inf if self.follower is None else getattr(self.follower, "t_travel", np.inf)
        return bool(span) and start + span[0] <= t < start + span[1]

    def lost(self, t: float) -> bool:
        """Whether a field exposed at ``t`` [s] does not arrive."""
        return self._during(self._table.loss, t)

    def seen(self, field: Field, seen: LineField) -> LineField:
        """The field with its faults: perhaps points beside the line, each marked as valid."""
        return self.garbage(seen) if self._during(self._table.garbage, field.t_stamp) else seen

    def garbage(self, seen: LineField) -> LineField:
        """The field with its points moved beside the line, by a common and a small random displacement each."""
        size = 1e-3 * self._table.garbage_mm
        beside = size * self._rng.uniform(-1, 1) + 0.2 * size * self._rng.standard_normal(len(seen.points_tcp))
        points = seen.points_tcp.copy()
        points[:, 1] += beside
        return replace(seen, points_tcp=points)


@dataclass(frozen=True)
class TroubledCamera:
    """A ``Camera`` with faults."""

    camera: Camera
    trouble: Trouble

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """Asks for the fields of a cycle before it begins; see ``Camera.request``."""
        def wanted(exposure: float) -> Sequence[Window] | None:
            return None if self.trouble.lost(exposure) else windows(exposure)

        self.camera.request(t0, t1, wanted)

    def arrived(self, t: float) -> list[Field]:
        """The fields that have arrived by the controller time ``t`` [s]; see ``Camera.arrived``."""
        return self.camera.arrived(t)


@dataclass(frozen=True)
class TroubledDetector:
    """A ``LineDetector`` with faults."""

    name: ClassVar[str] = "troubled"
    detector: LineDetector
    trouble: Trouble

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """Line points of a field, in the tool frame; see ``LineDetector.detect``."""
        return self.trouble.seen(field, self.detector.detect(field, camera, prediction, settings))
