"""Plays a path on a driver of your own: anything with a cycle time that takes a command and gives a state."""

import numpy as np

import ideal_robot as ir


class LateArm:
    """An arm that is where it was told to be one cycle ago."""

    t, t_ipo, q = 0.0, 0.012, np.zeros(6)

    def cycle(self, q_c):
        """Hands over a command ``(6,)`` [rad], waits one cycle, returns the state at its end."""
        self.t, before, self.q = self.t + self.t_ipo, self.q, q_c
        return ir.RobotState(self.t, before, np.zeros(6))


q_d = 0.1 * np.outer(1 - np.cos(np.linspace(0, 2 * np.pi, 400)), np.ones(6))
print(ir.play(LateArm(), ir.feedforward("none", None, ir.Robot.load("kr6")), q_d))
