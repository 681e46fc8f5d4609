"""Every cycle of a run, written to a file as it happens: what is done is kept even if the program is killed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import write_text

_ROWS, _META = "journal.npy", "journal.json"
_QUANTITIES = ("q_d", "q_c", "q", "tau")


class Journal:
    """Rows in a file that is memory to this program: the system writes it out, whatever becomes of the program.

    Args:
        folder: of the run; made if it is not there.
        rows: cycles it holds; further ones are dropped.
        robot: the arm.
        meta: what the recording's metadata shall hold.
    """

    def __init__(self, folder: Path, rows: int, robot: Robot, meta: dict[str, Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._files = folder / _ROWS, folder / _META
        self._robot, self._count = robot, 0
        self.meta = {"robot": robot.name, "cycle_time": robot.t_ipo, "source": "follow",
                     "units": {"t": "s", "q_d": "rad", "q_c": "rad", "q": "rad", "tau": "N m", "current": "A"}, **meta}
        write_text(self._files[1], json.dumps({**self.meta, "gain": robot.drive_gain.tolist()}) + "\n")
        self._rows = np.lib.format.open_memmap(
            self._files[0], mode="w+", dtype=np.float64, shape=(rows, 2 + len(_QUANTITIES) * robot.n))
        # Written once here: pages that are only promised would be fetched while a controller waits.
        self._rows[:] = np.nan

    def add(self, t: float, state: RobotState, q_d: Array, q_c: Array) -> None:
        """One cycle.

        Args:
            t: time of the run at its end [s].
            state: of the arm then; its time is the controller's.
            q_d: desired position of the cycle ``(n,)`` [rad].
            q_c: commanded position of the cycle ``(n,)`` [rad].
        """
        if self._count >= len(self._rows):
            return
        row, n = self._rows[self._count], self._robot.n
        row[1] = state.t
        for i, values in enumerate((q_d, q_c, state.q, state.tau)):
            row[2 + i * n : 2 + (i + 1) * n] = values
        # Last: a row whose time is a number is whole.
        row[0] = t
        self._count += 1

    def recording(self) -> Recording:
        """The rows so far."""
        return _recording(self._rows, self.meta, self._robot.drive_gain)

    def close(self) -> None:
        """The run has ended as it should, its recording is written: the journal goes."""
        del self._rows
        for file in self._files:
            file.unlink(missing_ok=True)


def left_behind(folder: Path) -> Recording | None:
    """What a run that was killed has left in its folder; None where there is nothing. It is removed there."""
    rows, meta = folder / _ROWS, folder / _META
    if not (rows.is_file() and meta.is_file()):
        return None
    try:
        known = json.loads(meta.read_text(encoding="utf-8"))
        gain = np.array(known.pop("gain"), dtype=float)
        found = _recording(np.load(rows, mmap_mode="r", allow_pickle=False), known, gain)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    finally:
        rows.unlink(missing_ok=True)
        meta.unlink(missing_ok=True)
    return found if len(found.t) else None


def _recording(rows: Array, meta: dict[str, Any], gain: Array) -> Recording:
    # The time of a cycle's end is positive; rows not reached yet hold NaN, or zeros for a moment at the beginning.
    filled = rows[rows[:, 0] > 0.0]
    n = (rows.shape[1] - 2) // len(_QUANTITIES)
    columns = {name: np.array(filled[:, 2 + i * n : 2 + (i + 1) * n]) for i, name in enumerate(_QUANTITIES)}
    tau = columns.pop("tau")
    if np.isfinite(tau).all():
        columns |= {"current": tau / gain, "tau": tau}
    # The controller's time goes on through calibration and run; that of the run begins anew.
    return Recording.from_arrays(np.array(filled[:, 1]), meta=meta, source="follow", **columns)
