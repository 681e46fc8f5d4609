"""Play in the gear, crossed where the load changes sign, as the TCP shows it."""

from __future__ import annotations

from ideal_robot.effects.arm.backlash_by_load import ArmBacklashByLoad
from ideal_robot.effects.tcp.at_tool import AtTool


class ToolBacklashByLoad(AtTool):
    """Play in the gear, crossed where the load changes sign: ``delta x = J_j delta q_j``."""

    inner = ArmBacklashByLoad()
