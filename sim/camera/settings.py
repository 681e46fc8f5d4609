"""What a simulated camera does to the picture and to its time: rate, exposure, noise, latency, stamps, lost fields."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ideal_robot.errors import InputError


@dataclass(frozen=True)
class CameraSettings:
    """What the camera does to the picture and to its time.

    Attributes:
        rate: fields per second [Hz].
        phase: time of the first mid-exposure [s].
        exposure: exposure time [s]; motion blur comes from ``sub_exposures`` pictures along the true pose.
        sub_exposures: pictures averaged over one exposure, each displaced by a fraction of a sample.
        supersampling: samples per pixel and axis in each of them.
        noise: standard deviation of gray noise, the same at all levels; of a sensor that has one, before its mosaic.
        full_well: electrons of a pixel that is just white; their number is Poisson's. 0 for no noise of the light.
        mosaic: whether pixels lie behind red, green and blue filters (RGGB) and the gray value is made of neighbours.
        defocus_px: radius of the disc that a point becomes in the picture [px].
        vignetting: share of the light that the lens loses in the picture's corners.
        jpeg_quality: 1 to 100 of the file's compression; 0 for none.
        latency: from mid-exposure to the data's arrival [s].
        jitter: standard deviation of the latency [s].
        stamp_offset: constant error of the time stamp [s].
        stamp_drift: by how much the clock of the time stamps runs fast [s/s].
        stamp_noise: standard deviation of the time stamp [s].
        loss: probability that a field is lost.
        doubled: probability that a field arrives twice.
        rolling: time from the first row's exposure to the last row's [s]; 0 where all rows are exposed together. Fields
            are timed by their middle row.
        auto_exposure: time constant with which the exposure follows the light [s]; 0 for a fixed one.
        resolution: texel of the drawn surface [m].
    """

    rate: float = 50.0
    phase: float = 0.005
    exposure: float = 0.002
    sub_exposures: int = 3
    supersampling: int = 2
    noise: float = 3.0
    full_well: float = 0.0
    mosaic: bool = False
    defocus_px: float = 0.0
    vignetting: float = 0.0
    jpeg_quality: int = 0
    latency: float = 0.040
    jitter: float = 0.001
    stamp_offset: float = 0.0
    stamp_drift: float = 0.0
    stamp_noise: float = 0.00005
    loss: float = 0.0
    doubled: float = 0.0
    rolling: float = 0.0
    auto_exposure: float = 0.0
    resolution: float = 0.00025

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not math.isfinite(value):
                raise InputError("must be finite", field=f"camera.{f.name}", value=value)
            if f.name not in ("phase", "stamp_offset", "stamp_drift") and value < 0:
                raise InputError("must not be negative", field=f"camera.{f.name}", value=value)
        for name in ("rate", "sub_exposures", "supersampling", "resolution"):
            if getattr(self, name) <= 0:
                raise InputError("must be positive", field=f"camera.{name}", value=getattr(self, name))
        if self.exposure * self.rate > 1.0:
            raise InputError("the exposure cannot be longer than the time between two fields", field="camera.exposure",
                             value=self.exposure)
        if self.rolling * self.rate > 1.0:
            raise InputError("the rows cannot be read out more slowly than fields come", field="camera.rolling_ms",
                             value=1e3 * self.rolling)
        if self.jpeg_quality > 100:
            raise InputError("expected a quality of up to 100", field="camera.jpeg_quality", value=self.jpeg_quality)
        for name in ("loss", "doubled", "vignetting"):
            if getattr(self, name) >= 1.0:
                raise InputError("expected a share below 1", field=f"camera.{name}", value=getattr(self, name))
