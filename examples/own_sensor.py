"""A sensor of your own, fused with the camera: 20 ms late, it looks 30 mm ahead of the tool."""

from scenes import DeviationSensor, Reading, load_scene, run_scene


class ProfileSensor(DeviationSensor):
    """Measures how far the line is to the left of where it looks; simulated, it looks at the scene's world."""

    name = "profile"
    looks = (0.03, 0.0, 0.0)
    delay = 0.02

    def mount(self, world):
        """Called before the run with what a simulated sensor can see of the scene; a real one does without."""
        self.world = world

    def arrived(self, t):
        """One reading a cycle: when, from where in the tool frame, how far [m], and its variance [m²]."""
        stamp = max(t - self.delay, 0.0)
        return [Reading(stamp, self.looks, self.world.distance(stamp, self.looks), 1e-4**2)]


calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
scene = load_scene("straight").changed(line={"points": [(0.4, 0.0), (0.8, 0.0)]}, calibration=calibrated)
result = run_scene(scene, sensors=[ProfileSensor()])
print(result)
print("values of the sensor, and how many were fused:", result.sensors["profile"])
