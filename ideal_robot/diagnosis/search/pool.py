"""The pool of a search: every effect at every joint where it may sit, with values of theta to start from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.effects import Effect, Signals


def candidates(effects: Sequence[Effect], signals: Signals, undecided: dict[int, str],
               absorbed: bool) -> Iterator[list[Candidate]]:
    """For every effect and joint the list of its starts, joints that move too little left out.

    Args:
        effects: to try.
        signals: of the recording.
        undecided: joints that cannot be decided.
        absorbed: whether effects may be tried that the model's own parameters can take over.
    """
    for effect in effects:
        if effect.absorbed_by_base and not absorbed:
            continue
        for joint in effect.joints(signals):
            if joint in undecided or not effect.usable(signals, joint):
                continue
            if effect.scanned:
                yield [Candidate(effect, joint)]
                continue
            starts = effect.starts(signals, joint)
            yield [Candidate(effect, joint, theta, len(starts)) for theta in starts]
