"""``ideal-robot run`` of a force scene: a tool kept on a wavy surface, and its force over time."""

import numpy as np

from scenes import load_scene, run_scene

scene = load_scene("force_wave").changed(line={"length": 0.2})
result = run_scene(scene, method="ideal")
print(result)

# The true normal force every half millisecond, while the tip travels.
t, force = result.history["t"], result.history["normal"]
touching = t[force > 0.0]
first, last = np.searchsorted(t, [touching[0], touching[-1]])
share = np.mean(np.abs(force[first:last] - scene.force) < 0.1 * scene.force)
print(f"wanted {scene.force:g} N; within 10 % for {100.0 * share:.0f} % of the time in contact")

figures = result.to_dict()
print(f"RMS force error {figures['force_error_N']['rms']:.2f} N, largest force {figures['max_force_N']:.1f} N")
result.plot().savefig("force.png")
