"""How a controller's time stamps rise, found from its first packets: by the cycle in ms, by one, or not at all."""

from __future__ import annotations

from ideal_robot.rsi.rsi_error import RsiError

_RANGE = 2**32
"""Where a 32-bit time stamp starts anew."""
_STILL = 5
"""Packets in a row with the same stamp, right at the start, after which the stamp counts as never rising."""
_SLOW_START = 3
"""Steps within which the expected rise has to show."""


class Stamps:
    """Cycles between packets by their time stamps.

    Args:
        step: interpolation cycle [ms].

    Attributes:
        rise: what the stamp rises by in a cycle, 0 if it never rises; None until it is known.
        in_step: whether two packets in a row have come.
    """

    def __init__(self, step: int) -> None:
        self.step = step
        self.rise: int | None = None
        self.in_step = False
        self._same = self._steps = 0

    def cycles(self, before: int, after: int) -> int:
        """Cycles from one stamp to another: 0 for the same packet again, negative for an older one.

        Raises:
            RsiError: the stamp rises neither by the cycle nor by one.
        """
        since = (after - before + _RANGE // 2) % _RANGE - _RANGE // 2
        if self.rise == 0:
            return 1
        if since <= 0:
            return self._never(since)
        if self.rise is None:
            self.rise = self._found(since)
        if since % self.rise:
            raise self._wrong(since)
        cycles = since // self.rise
        self.in_step = self.in_step or cycles == 1
        self._steps += 1
        # One large step is a loss, three from the start are another cycle time.
        if not self.in_step and self._steps >= _SLOW_START:
            raise self._wrong(since)
        return cycles

    def newer(self, before: int, after: int) -> bool:
        """Whether of two packets that wait the second came after the first."""
        return self.rise == 0 or (after - before + _RANGE // 2) % _RANGE > _RANGE // 2

    def described(self) -> str:
        """For the report."""
        if self.rise is None:
            return "not known"
        return {0: "do not rise: repeated and late packets cannot be told", self.step: f"rise by {self.step} ms a cycle"
                }.get(self.rise, "rise by 1 a packet: the cycle cannot be checked by them")

    def _never(self, since: int) -> int:
        self._same = self._same + 1 if since == 0 and self.rise is None else 0
        if self._same >= _STILL:
            self.rise, self.in_step = 0, True
            return 1
        return min(since, 0)

    def _found(self, since: int) -> int:
        if since % self.step == 0:
            return self.step
        # No controller has a cycle of 2 or 3 ms: that is a stamp that counts packets, and one that was lost.
        if since <= 3:
            return 1
        raise self._wrong(since)

    def _wrong(self, since: int) -> RsiError:
        return RsiError(f"the controller's time stamp rose by {since} in a cycle; {self.step} (ms) or 1 (a packet) are "
                        "expected; tell the controller's cycle with --cycle, or t_ipo in the robot's data")
