"""How fast may the arm go? One row a run, speeds times seeds."""

from scenes import sweep_scene

if __name__ == "__main__":
    runs = sweep_scene("line", methods=["ideal"], speeds=[0.7, 1.4], seeds=[1], processes=2)
    print(runs[["scene", "method", "speed_m_s", "seed", "control_error_mm.mean"]].to_string(index=False))
    print(f"worst mean: {runs['control_error_mm.mean'].max():.3f} mm")
