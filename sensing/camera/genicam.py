"""Industrial cameras: GenICam (GigE Vision, USB3 Vision) through the package ``harvesters``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from sensing.camera.field import Gray
from sensing.camera.frame_source import Frame
from sensing.clock.clock_relation import ClockRelation
from sensing.sensing_error import SensingError

_GRAY_OF = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono14": 14, "Mono16": 16}
"""Formats that are taken, with the bits that count. Packed and coloured ones are not: set ``PixelFormat``."""


class GenICamCamera:
    """A ``FrameSource`` over a harvesters image acquirer; stamps are of the camera's own clock.

    Args:
        acquirer: an ``ImageAcquirer`` of harvesters, or whatever has its ``start``, ``fetch``, ``stop``, ``destroy``.
        least_delay: from the camera's stamp (begin of exposure with most) to the picture's arrival, at least [s].
        library: what made the acquirer, to be reset at the end.

    Raises:
        InputError: a pixel format that is not taken.
    """

    def __init__(self, acquirer: Any, least_delay: float = 0.0, library: Any = None) -> None:
        self._acquirer, self._library = acquirer, library
        self.clock, self.stamps = ClockRelation(least_delay), "camera"
        self._number = 0
        acquirer.start()
        first = self._fetched(5.0)
        if first is None:
            self.close()
            raise InputError("the camera is there but sends no picture; is it triggered?", field="camera")
        self.height, self.width = first[1].shape

    @classmethod
    def open(cls, producer: Path, serial: str | None = None, least_delay: float = 0.0) -> GenICamCamera:
        """A camera by its producer's GenTL file.

        Args:
            producer: the ``.cti`` file that came with the camera.
            serial: number of the camera; the first one found if None.
            least_delay: see the class.

        Raises:
            InputError: harvesters is not installed, no such file or camera.
        """
        try:
            from harvesters.core import Harvester
        except ImportError as error:
            raise InputError("GenICam cameras need the package harvesters: pip install 'ideal-robot[genicam]'",
                             field="camera") from error
        if not producer.is_file():
            raise InputError("no such GenTL producer (.cti), which the camera's maker supplies", field="camera",
                             value=str(producer))
        library = Harvester()
        library.add_file(str(producer))
        library.update()
        if not library.device_info_list:
            library.reset()
            raise InputError("the producer finds no camera", field="camera", value=str(producer))
        return cls(library.create(0 if serial is None else {"serial_number": serial}), least_delay, library)

    def read(self, timeout: float) -> Frame | None:
        """See ``FrameSource.read``."""
        found = self._fetched(timeout)
        if found is None:
            return None
        stamp, image = found
        if image.shape != (self.height, self.width):
            raise SensingError("the camera changed its picture's size on the way")
        arrived = time.perf_counter()
        if not self.clock.add(stamp, arrived):
            return None
        self._number += 1
        return Frame(self._number, stamp, arrived, image)

    def close(self) -> None:
        """See ``FrameSource.close``."""
        self._acquirer.stop()
        self._acquirer.destroy()
        if self._library is not None:
            self._library.reset()

    def _fetched(self, timeout: float) -> tuple[float, Gray] | None:
        buffer = self._acquirer.try_fetch(timeout=timeout)
        if buffer is None:
            return None
        with buffer:
            parts = buffer.payload.components
            if not parts:
                return None
            part = parts[0]
            bits = _GRAY_OF.get(part.data_format)
            if bits is None:
                raise InputError(f"expected a pixel format of {', '.join(_GRAY_OF)}; set it with the camera's own tool",
                                 field="camera", value=part.data_format)
            # Copied: the buffer goes back to the camera.
            gray = np.array(part.data, copy=True).reshape(part.height, part.width)
            stamp = 1e-9 * float(buffer.timestamp_ns)
        return stamp, gray if bits == 8 else (gray >> (bits - 8)).astype(np.uint8)
