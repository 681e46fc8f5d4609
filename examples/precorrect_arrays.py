"""Corrects a joint path given as arrays; the error that is left is what the identified model expects."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15"))

# All joints out and back by 0.2 rad in two seconds, at the controller's interpolation cycle.
t = np.arange(0.0, 2.0, robot.t_ipo)
q_d = robot.home + 0.1 * np.outer(1 - np.cos(np.pi * t), np.ones(6))

path = ir.precorrect(t, q_d, model, robot)
print(path)

# What to send instead of q_d: commands at the same cycle, with rest before and behind the path.
with_commands, without = (1e3 * np.sqrt(np.mean(error**2, axis=0)) for error in path.expected)
for joint, (left, plain) in enumerate(zip(with_commands, without, strict=True), 1):
    print(f"joint {joint}: {plain:.2f} mrad expected without correction, {left:.3f} with")
print(f"largest change of a command: {np.abs(path.q_c - path.q_d).max():.4f} rad")

path.recording.write("corrected.csv")
path.plot().savefig("corrected.png")
