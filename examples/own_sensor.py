"""A sensor of your own, fused with the camera: 20 ms late, it looks 30 mm ahead of the tool."""

from scenes import Reading, load_scene, run_scene


class ProfileSensor:
    """Measures how far the line is to the left of where it looks; simulated, it looks at the scene's world."""

    name, looks = "profile", (0.03, 0.0, 0.0)
    mount = lambda self, world: setattr(self, "world", world)  # noqa: E731

    def arrived(self, t: float) -> list[Reading]:
        """One reading a cycle: when, from where in the tool frame, how far [m], and its variance [m²]."""
        stamp = max(t - 0.02, 0.0)
        return [Reading(stamp, self.looks, self.world.distance(stamp, self.looks), 1e-4**2)]


calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
scene = load_scene("straight").changed(line={"points": [(0.4, 0.0), (0.8, 0.0)]}, calibration=calibrated)
print(result := run_scene(scene, sensors=[ProfileSensor()]), result.sensors["profile"])
