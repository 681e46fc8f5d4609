"""Follows a line drawn by an SVG file of your own."""

from pathlib import Path

from scenes import load_scene, run_scene

# The first path of the file is the line; svg_length says how long it is [m].
Path("wave.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 C 150 -60 300 -60 500 0"/></svg>')

# The scene says where surface and line lie; files are looked for beside the scene, here in the working folder.
scene = load_scene("svg").beside(Path.cwd())

# A camera without mounting errors needs no calibration before the run.
calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
result = run_scene(scene, line={"svg": "wave.svg", "svg_length": 0.5}, calibration=calibrated)
print(result)

error = result.control_error
print(f"{1e3 * error.mean:.3f} mm beside the line in the mean, {1e3 * error.max:.3f} mm at most")
result.plot().savefig("wave.png")
