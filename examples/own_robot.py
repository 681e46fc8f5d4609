"""A robot of your own, URDF and drive data beside this file: from a recording to a corrected path.

The recording is made up: motion, then the torque for it, then the command with which a P/PI cascade gives that torque.
"""

import numpy as np
from scipy.signal import lfilter

import ideal_robot as ir

robot, t = ir.Robot.load(__file__.replace(".py", ".urdf")), np.arange(0.0, 20.0, 0.002)
q = np.tanh(t**2) * (np.sin(np.outer(t, [1.1, 2.3, 4.7, 11.0])) @ [0.6, 0.3, 0.1, 0.03])
tau = 2.0 * np.gradient(qd := np.gradient(q, t), t) + 6.0 * qd + 4.0 * np.tanh(100.0 * qd)
q_c = q + (qd + lfilter([1.0, -1.0], [1.0, -0.96], tau) / 100.0) / 10.0
tau += np.random.default_rng(1).normal(0.0, 0.1, len(t))
model = ir.identify(ir.Recording.from_arrays(t, q_c=q_c, q=q, tau=tau), robot).model
print(ir.precorrect(t[:2000], 0.5 - 0.5 * np.cos(np.pi * t[:2000, None] / 2), model, robot))
