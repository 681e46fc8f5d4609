"""Plays a path on a driver of your own: anything with a cycle time that takes a command and gives a state."""

import numpy as np

import ideal_robot as ir


class LateArm:
    """An arm that is where it was told to be one cycle ago."""

    t_ipo = 0.012

    def __init__(self, n: int) -> None:
        self.t = 0.0
        self.q = np.zeros(n)

    def cycle(self, q_c: np.ndarray) -> ir.RobotState:
        """Hands over a command ``(n,)`` [rad], waits one cycle, returns the state at its end."""
        self.t += self.t_ipo
        before, self.q = self.q, q_c
        return ir.RobotState(self.t, before, np.zeros(len(q_c)))


robot = ir.Robot.load("kr6")
phase = np.linspace(0.0, 2.0 * np.pi, 400)
q_d = 0.1 * np.outer(1.0 - np.cos(phase), np.ones(robot.n))
result = ir.play(LateArm(robot.n), ir.feedforward("none", None, robot), q_d)
print(result)
result.plot().savefig("own_driver.png")
