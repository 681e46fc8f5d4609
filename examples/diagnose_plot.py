"""Finds what a model misses in a recording and draws it: here joint 4 sticks more at low speed."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model, rng = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15")), np.random.default_rng(1)
t = np.arange(0.0, 30.0, 0.004)
q = robot.home + sum(np.sin(np.outer(t, rng.uniform(0.6, 3.8, 6)) + rng.uniform(0.0, 6.3, 6)) for _ in range(5)) / 6.0
sticking = [0.0, 0.0, 0.0, 6.0, 0.0, 0.0] * np.sign(qd := np.gradient(q, t, axis=0)) * np.exp(-abs(qd) / 0.2)
tau = model.inverse_dynamics(q, qd, np.gradient(qd, t, axis=0)) + sticking + rng.normal(0.0, 0.3, q.shape)
print(diagnosis := ir.diagnose(ir.Recording.from_arrays(t, q=q, tau=tau), robot, model=model))
diagnosis.plot().savefig("diagnosis.png")
