"""Finds what a model misses in a recording and draws it: here joint 4 sticks more at low speed."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model, t = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15")), np.arange(0.0, 8.0, 0.004)
q = robot.home + np.sin(2.0 * np.pi * np.outer(t, np.linspace(0.3, 1.3, 6))) * np.linspace(0.3, 0.07, 6)
qd = np.gradient(q, t, axis=0)
tau = model.inverse_dynamics(q, qd, np.gradient(qd, t, axis=0)) + np.random.default_rng(1).normal(0.0, 0.3, q.shape)
tau[:, 3] += 6.0 * np.sign(qd[:, 3]) * np.exp(-((qd[:, 3] / 0.1) ** 2))
print(found := ir.diagnose(ir.Recording.from_arrays(t, q=q, tau=tau), robot, model=model))
found.plot().savefig("diagnosis.png")
