"""Corrects a joint path given as arrays; the error that is left is what the identified model expects."""

import numpy as np

import ideal_robot as ir
from scenes import shipped_model

robot, model = ir.Robot.load("kr15"), ir.Model.load(shipped_model("kr15"))
t = np.arange(0.0, 2.0, robot.t_ipo)
q_d = robot.home + 0.1 * np.outer(1 - np.cos(np.pi * t), np.ones(6))
path = ir.precorrect(t, q_d, model, robot)
print(path)
path.recording.write("corrected.csv")
