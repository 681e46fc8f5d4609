"""Follows a line drawn by an SVG file of your own."""

from pathlib import Path

from scenes import load_scene, run_scene

Path("wave.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 C 150 -60 300 -60 500 0"/></svg>')
calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
scene = load_scene("svg").beside(Path.cwd())
result = run_scene(scene, line={"svg": "wave.svg", "svg_length": 0.5}, calibration=calibrated)
print(result)
