"""Play in the gear, as the TCP shows it."""

from __future__ import annotations

from ideal_robot.effects.arm.backlash import ArmBacklash
from ideal_robot.effects.tcp.at_tool import AtTool


class ToolBacklash(AtTool):
    """Play in the gear: ``delta x = J_j delta q_j``."""

    inner = ArmBacklash()
