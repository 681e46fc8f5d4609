"""A robot of your own, URDF and drive data beside this file: from a recording to a corrected path.

The recording is made up: motion, then the torque for it, then the command with which a P/PI cascade gives that torque.
"""

import numpy as np
from scipy.signal import lfilter

import ideal_robot as ir

robot = ir.Robot.load(__file__.replace(".py", ".urdf"))

# One joint, in sines of many speeds: inertia 2 kg m², viscous friction 6 N m s/rad, dry friction 4 N m.
t = np.arange(0.0, 20.0, 0.002)
q = np.tanh(t**2) * (np.sin(np.outer(t, [1.1, 2.3, 4.7, 11.0])) @ [0.6, 0.3, 0.1, 0.03])
qd = np.gradient(q, t)
tau = 2.0 * np.gradient(qd, t) + 6.0 * qd + 4.0 * np.tanh(100.0 * qd)
q_c = q + (qd + lfilter([1.0, -1.0], [1.0, -0.96], tau) / 100.0) / 10.0
tau += np.random.default_rng(1).normal(0.0, 0.1, len(t))

result = ir.identify(ir.Recording.from_arrays(t, q_c=q_c, q=q, tau=tau), robot)
print(result)

# Any path of the joint, corrected by what was identified. One that began with a leap of acceleration would be refused.
t_d = t[:2000]
x = np.clip(t_d / 2.0, 0.0, 1.0)[:, None]
q_d = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
print(ir.precorrect(t_d, q_d, result.model, robot))
