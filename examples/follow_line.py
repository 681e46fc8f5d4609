"""``ideal-robot run``: follows a drawn line with a late camera; figures, picture and recording of the run."""

import numpy as np

from scenes import load_scene, run_scene

# A shipped scene, in the ideal world and over a short line, so that the example takes seconds.
scene = load_scene("straight").changed(
    world="bench",
    speed=0.5,
    line={"points": [(0.4, 0.0), (0.8, 0.02)]},
    camera={"latency": 0.04},
    # How well the camera is known, where it is not calibrated by moving over the line first.
    calibration={"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0},
)

result = run_scene(scene, method="adapted")
print(result)

# Signed distance of the tool from the line, along the line; a controller does not know it, the simulation does.
error = result.control_error
print(f"mean distance {1e3 * error.mean:.3f} mm, 95 % within {1e3 * error.p95:.3f} mm, "
      f"worst at {1e3 * error.s[np.argmax(np.abs(error.lateral))]:.0f} mm along the line")

# What a controller would have logged, for whatever else is to be done with it.
result.recording.write("line.parquet")
result.plot().savefig("line.png")
