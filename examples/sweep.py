"""How fast may the arm go? One row a run, speeds times seeds."""

from scenes import load_scene, sweep_scene

if __name__ == "__main__":
    calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
    scene = load_scene("straight").changed(line={"points": [(0.4, 0.0), (0.8, 0.0)]}, calibration=calibrated)
    runs = sweep_scene(scene, speeds=[0.4, 0.7, 1.0], seeds=[1], processes=2)
    print(runs[["scene", "speed_m_s", "seed", "control_error_mm.mean"]].to_string(index=False))
    print(f"worst mean: {runs['control_error_mm.mean'].max():.3f} mm")
