"""``ideal-robot inspect``: what a recording holds, and what of it does not fit the arm."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15"))

# A recording as somebody may have it: joint 3 was logged with the other sign.
t = np.arange(0.0, 20.0, 0.004)
rng = np.random.default_rng(1)
angle = np.outer(t, rng.uniform(0.6, 2.0, robot.n)) + rng.uniform(0.0, 6.3, robot.n)
q = robot.home + 0.3 * np.sin(angle)
qd = np.gradient(q, t, axis=0)
tau = model.inverse_dynamics(q, qd, np.gradient(qd, t, axis=0)) + rng.normal(0.0, 1.0, q.shape)
tau[:, 2] *= -1.0

inspection = ir.inspect(ir.Recording.from_arrays(t, q=q, tau=tau), robot)
print(inspection)
for finding in inspection.contradictions:
    print(f"- joints {finding.joints}: {finding.text}")
