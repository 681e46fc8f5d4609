"""Does a late camera matter? Three latencies, with the ideal robot and with direct sensor feedback."""

from scenes import load_scene, run_scene

for latency in (0.02, 0.04, 0.08):
    scene = load_scene("line").changed(camera={"latency": latency})
    ideal = run_scene(scene, method="ideal").control_error.mean
    direct = run_scene(scene, method="direct_feedback", gains=(0.09, 0.0)).control_error.mean
    print(f"{1e3 * latency:.0f} ms: ideal robot {1e3 * ideal:.3f} mm, direct feedback {1e3 * direct:.3f} mm")
