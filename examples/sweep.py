"""How fast may the arm go? One row a run, speeds times seeds."""

from scenes import load_scene, sweep_scene

if __name__ == "__main__":
    # A short line and a camera without mounting errors, so that a run takes seconds.
    calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
    scene = load_scene("straight").changed(line={"points": [(0.4, 0.0), (0.8, 0.0)]}, calibration=calibrated)

    # A data frame with all figures of every run; the processes need the guard above.
    runs = sweep_scene(scene, speeds=[0.4, 0.7, 1.0], seeds=[1], processes=2)
    print(runs[["scene", "speed_m_s", "seed", "control_error_mm.mean"]].to_string(index=False))

    by_speed = runs.groupby("speed_m_s")["control_error_mm.p95"].max()
    for speed, p95 in by_speed.items():
        print(f"{speed} m/s: 95 % of the way within {p95:.3f} mm")
    allowed = by_speed[by_speed < 0.2]
    print(f"fastest within 0.2 mm: {allowed.index.max()} m/s" if len(allowed) else "none within 0.2 mm")
    runs.to_csv("sweep.csv", index=False)
