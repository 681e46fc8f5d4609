"""What is written down while a contact is followed."""

from __future__ import annotations

from dataclasses import dataclass, field

from ideal_robot.row_log import RowLog
from planning.follower import ForceFollower
from scenes.cycle import CycleLog


@dataclass
class ForceLog(CycleLog):
    """What is written down while a scene is played.

    Attributes:
        phase, s, planned: of the follower in each cycle: phase, arc length [m], planned deviation [m].
        samples: of each cycle with samples: time of the newest [s], normal force [N], innovation squared per value.
        wrenches: of all samples of the force sensor the time [s] and the wrench [N, N m].
        fields: for ``glue``: time stamp [s], values used, why not all.
    """

    phase: list[str] = field(default_factory=list)
    s: RowLog = field(default_factory=RowLog)
    planned: RowLog = field(default_factory=RowLog)
    samples: RowLog = field(default_factory=RowLog)
    wrenches: RowLog = field(default_factory=RowLog)
    fields: list[tuple[float, int, str]] = field(default_factory=list)

    def add(self, t: float, follower: ForceFollower) -> None:
        """One cycle that begins at ``t`` [s]."""
        self.phase.append(follower.phase.value)
        self.s.append(follower.s_at(t))
        self.planned.append(follower.planned())
