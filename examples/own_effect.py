"""An effect of your own, found by ``diagnose``: drag that grows with the square of the speed."""

from pathlib import Path

import numpy as np

import ideal_robot as ir


class AirDrag(ir.Effect):
    """``tau = drag qd |qd|``."""

    name = "air_drag"
    coefficient_names = ("drag",)
    coefficient_units = ("N m s²/rad²",)

    def columns(self, signals, joint, theta):
        """The torque of a unit coefficient at each sample."""
        qd = signals.qd[:, joint - 1]
        return signals.on_joint(joint, qd * np.abs(qd))


ir.register_effect(AirDrag())

# A pendulum with known inertia and friction, and the drag that no model has.
t = np.arange(0.0, 30.0, 0.004)
q = np.sin(np.outer(t, [1.1, 2.3, 4.7])) @ [0.6, 0.3, 0.1]
qd = np.gradient(q, t)
tau = 2.2 * np.gradient(qd, t) + 5.0 * np.tanh(100.0 * qd) + 3.0 * qd + 1.5 * qd * np.abs(qd)
noise = np.random.default_rng(1).normal(0.0, 0.05, len(t))

robot = ir.Robot.load(str(Path(__file__).with_name("own_robot.urdf")))
print(ir.diagnose(ir.Recording.from_arrays(t, q=q, tau=tau + noise), robot))
