"""How fast may the arm go? Follows the line at several speeds and prints the error of each run."""

from scenes import load_scene, run_scene

for speed in (0.4, 0.7, 1.0):
    error = run_scene(load_scene("line"), speed=speed).control_error
    print(f"{speed:.1f} m/s: mean {1e3 * error.mean:.3f} mm, 95 % within {1e3 * error.p95:.3f} mm")
