"""Finds what a model misses in a recording and draws it: here joint 4 sticks more at low speed."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model, rng = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15")), np.random.default_rng(1)

# A lively motion: five sines a joint, of random frequencies and phases.
t = np.arange(0.0, 30.0, 0.004)
q = robot.home + sum(np.sin(np.outer(t, rng.uniform(0.6, 3.8, 6)) + rng.uniform(0.0, 6.3, 6)) for _ in range(5)) / 6.0
qd = np.gradient(q, t, axis=0)
qdd = np.gradient(qd, t, axis=0)

# The model's torques, with 12 N m more friction in joint 4 that decays with speed, and noise.
sticking = [0.0, 0.0, 0.0, 12.0, 0.0, 0.0] * np.sign(qd) * np.exp(-abs(qd) / 0.2)
tau = model.inverse_dynamics(q, qd, qdd) + sticking + rng.normal(0.0, 0.3, q.shape)

diagnosis = ir.diagnose(ir.Recording.from_arrays(t, q=q, tau=tau), robot, model=model)
print(diagnosis)
for channel in diagnosis.channels:
    print(f"{channel.channel}: {channel.rms_before:.2f} {channel.unit} before, {channel.rms_after:.2f} after")
diagnosis.plot().savefig("diagnosis.png")
