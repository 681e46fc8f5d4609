"""A feedforward of your own beside the built-in ones in one comparison table."""

import ideal_robot as ir
from scenes import compare_scene, load_scene


class OneCycleAhead(ir.Feedforward):
    """Commands where the arm shall be one cycle later."""

    n_d = 2
    t_ipo = 0.012

    def init(self, q0):
        """No state is needed."""
        return None

    def step(self, state, q_d, tau_ext_d=None):
        """The command of this cycle, of the desired positions ``(n_d, n)`` of this and the next one."""
        return q_d[1], state


calibrated = {"by_moving": False, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "lateral_mm": 0, "principal_px": 0}
scene = load_scene("straight").changed(line={"points": [(0.4, 0.0), (0.8, 0.0)]}, calibration=calibrated)
comparison = compare_scene(scene, methods=["none", "sensor_path", OneCycleAhead(), "ideal"])
print(comparison)
