"""An effect of your own, found by ``diagnose``: drag that grows with the square of the speed."""

import numpy as np

import ideal_robot as ir


class AirDrag(ir.Effect):
    """``tau = drag qd |qd|``."""

    name, coefficient_names, coefficient_units = "air_drag", ("drag",), ("N m s²/rad²",)
    columns = lambda self, s, joint, theta: s.on_joint(joint, s.qd[:, joint - 1] * abs(s.qd[:, joint - 1]))  # noqa: E731


ir.register_effect(AirDrag())
q = np.sin(np.outer(t := np.arange(0.0, 30.0, 0.004), [1.1, 2.3, 4.7])) @ [0.6, 0.3, 0.1]
tau = 2.2 * np.gradient(qd := np.gradient(q, t), t) + 5.0 * np.tanh(100.0 * qd) + 3.0 * qd + 1.5 * qd * abs(qd)
recording = ir.Recording.from_arrays(t, q=q, tau=tau + np.random.default_rng(1).normal(0.0, 0.05, len(t)))
print(ir.diagnose(recording, ir.Robot.load(__file__.replace("effect.py", "robot.urdf"))))
