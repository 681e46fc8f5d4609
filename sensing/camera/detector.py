"""The interface of line detectors: from a field cut to windows and a predicted line to line points."""

from __future__ import annotations

from typing import ClassVar, Protocol

from ideal_robot.registry import Registry
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import LineField, detect_line
from sensing.camera.line_search import DetectionSettings, PredictedLine


class LineDetector(Protocol):
    """Finds the line in the windows of a field, one point a window.

    Attributes:
        name: key in tables and options.
    """

    name: ClassVar[str]

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """Line points of a field, in the tool frame; raises ``InputError`` without one window per predicted point.

        Args:
            field: the pixels of the windows that ``search_windows`` returned.
            camera: the camera as it is calibrated.
            prediction: where the line should be, in the tool frame; point i belongs to window i.
            settings: how the line looks and what is accepted.
        """
        ...


class EdgePairs:
    """Edge pairs with gates of width and contrast, then a least-squares fit of a blurred box to all pixels."""

    name: ClassVar[str] = "edge_pairs"

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """Line points of a field, in the tool frame; see ``LineDetector.detect``."""
        return detect_line(field, camera, prediction, settings)


DETECTORS: Registry[type[LineDetector]] = Registry("detector", "ideal_robot.line_detectors", {
    "edge_pairs": "sensing.camera.detector:EdgePairs",
    "opencv": "sensing.camera.opencv_detector:OpenCVProfiles",
})
"""Line detectors by name."""
