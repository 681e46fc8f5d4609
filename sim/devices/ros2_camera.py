"""A simulated camera's pictures on a topic of ROS 2, with ``CameraInfo`` beside it as drivers publish it."""

from __future__ import annotations

import os
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ideal_robot.errors import InputError
from sensing.camera.camera_model import CameraModel

FRAME = "camera_optical_frame"
"""Name of the frame in the headers: x right, y down, z along the view."""


class ImageTopic:
    """Publishes ``sensor_msgs/Image`` (mono8) on a topic, ``sensor_msgs/CameraInfo`` on ``camera_info`` beside it.

    Args:
        name: full name of the topic of the pictures.
        camera: size, camera matrix and distortion of the calibrated camera.

    Raises:
        InputError: ROS 2 does not start here, or a topic cannot be called so.
    """

    def __init__(self, name: str, camera: CameraModel) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        import rclpy
        from sensor_msgs.msg import CameraInfo, Image

        self._rclpy, self._context, self._kind = rclpy, rclpy.Context(), Image
        try:
            rclpy.init(context=self._context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            self._node = rclpy.create_node("simulated_camera", context=self._context, enable_rosout=False,
                                           start_parameter_services=False)
            self._images = self._node.create_publisher(Image, name, 5)
            self._infos = self._node.create_publisher(CameraInfo, f"{name.rpartition('/')[0]}/camera_info", 5)
        except Exception as error:  # exceptions of the middleware, whose types differ
            raise InputError(f"no pictures can be published there ({' '.join(str(error).split())})", field="topic",
                             value=name[:80]) from error
        P = np.column_stack([camera.K, np.zeros(3)])
        self._info = CameraInfo(width=camera.width, height=camera.height, distortion_model="plumb_bob",
                                d=[float(value) for value in camera.distortion], k=camera.K.ravel().tolist(),
                                r=np.eye(3).ravel().tolist(), p=P.ravel().tolist())

    @property
    def watched(self) -> bool:
        """Whether the pictures have a subscriber."""
        return bool(self._images.get_subscription_count() > 0)

    def send(self, stamp: float, gray: NDArray[np.uint8]) -> None:
        """Publishes a picture.

        Args:
            stamp: mid-exposure, for the header [s].
            gray: gray values ``(height, width)``.
        """
        image: Any = self._kind(height=gray.shape[0], width=gray.shape[1], encoding="mono8", step=gray.shape[1])
        # An array of bytes is accepted as it is; other types are checked byte by byte.
        image.data = array("B", gray.tobytes())
        for message in (image, self._info):
            message.header.frame_id = FRAME
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * stamp), 10**9)
        self._images.publish(image)
        self._infos.publish(self._info)

    def close(self) -> None:
        """Destroys the node, so that it leaves the ROS graph."""
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)
