"""A gear that gives, as the TCP shows it."""

from __future__ import annotations

from ideal_robot.effects.arm.joint_elasticity import ArmElasticity
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.tcp.at_tool import AtTool


class ToolElasticity(AtTool):
    """A gear that gives: ``delta x = J_j delta q_j``."""

    inner = ArmElasticity()

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """What the gear gives beyond what was known."""
        return LoopChange(further_compliance=coefficients[0])
