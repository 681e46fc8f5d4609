"""Follows a line drawn by an SVG file of your own."""

from pathlib import Path

from scenes import load_scene, run_scene

Path("wave.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 C 150 -60 300 -60 500 0"/></svg>')
scene = load_scene("svg").beside(Path.cwd())
error = run_scene(scene, line={"svg": "wave.svg", "svg_length": 0.5}).control_error
print(f"mean {1e3 * error.mean:.3f} mm, 95 % within {1e3 * error.p95:.3f} mm")
