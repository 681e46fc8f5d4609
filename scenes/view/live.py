"""Shows a run on devices in a browser while it goes on: the arm, its path, and the run's state.

It reads the journal that the follower writes, in a process of its own: the process that commands the arm is not
affected.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from scenes.online.journal import ROWS, journal_rows
from scenes.view.viewer import GHOST, Viewer

SILENT = 1.0
"""Time without a new cycle after which the page says so [s]."""
_SHORTEST = 1e-4
"""No interpolation cycle is shorter [s]."""
_RECENT = 5000
"""Cycles that are read: of a long run the last ones."""
_SHOWN = 400
"""Points of the way that are drawn."""
_COLOUR = (0, 110, 190)  # a blue


class LiveView:
    """Shows the run in a folder up to its present state; ``state`` is the page's text."""

    def __init__(self, viewer: Viewer, folder: Path) -> None:
        self.viewer, self._folder = viewer, folder
        self._panel = viewer.server.gui.add_markdown("")
        self._plot: Any = None
        self._begun, self._grown, self._size = time.time(), time.monotonic(), -1
        self.state = ""
        self._say(f"waiting for a run in `{folder}`")

    def update(self) -> None:
        """Shows what was added since the last call; to be called repeatedly."""
        try:
            size = (self._folder / ROWS).stat().st_size
            count = size // (8 * (2 + 4 * self.viewer.robot.n))
            if size != self._size and count:
                begun = float(journal_rows(self._folder, 0, 1)[0][0, 1])
                rows, meta = journal_rows(self._folder, max(count - _RECENT, 0))
                period = float(meta["cycle_time"])
                if rows.shape[1] != 2 + 4 * self.viewer.robot.n or not _SHORTEST <= period <= SILENT:
                    raise ValueError("the journal of another arm, or none")
        except (OSError, ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError):
            self._ended()
            return
        if size == self._size:
            quiet = time.monotonic() - self._grown
            if quiet > SILENT and size:
                self._say(f"**no new cycle for {quiet:.0f} s**: the run has ended, or the arm or the follower stands "
                          "still")
            return
        self._size, self._grown = size, time.monotonic()
        if count:
            self._show(rows, meta, period, count, begun)

    def _show(self, rows: Array, meta: dict[str, Any], T: float, count: int, begun: float) -> None:
        """The last rows of a run of ``count`` cycles of ``T`` [s] that began at ``begun`` [s]."""
        n = self.viewer.robot.n
        q_d, q_c, q = (rows[:, 2 + i * n : 2 + (i + 1) * n] for i in range(3))
        self.viewer.show(q[-1])
        self.viewer.show(q_c[-1], GHOST)
        some = np.unique(np.linspace(0, len(q) - 1, min(len(q), _SHOWN)).astype(int))
        if len(some) > 1:
            self.viewer.draw("way of the tool", self.viewer.robot.tool_places(q[some]), _COLOUR)
        recent = slice(-max(round(5.0 / T), 2), None)
        t, off = rows[recent, 1], 1e3 * np.abs(q_d - q)[recent].max(axis=1)
        lost = round((rows[-1, 1] - begun) / T) + 1 - count
        self._draw(t, off)
        self._say(f"**{meta.get('scene')}**, {meta.get('method')}: running\n\n"
                  f"{rows[-1, 1]:.1f} s by the controller, {count} cycles of {1e3 * T:.0f} ms, "
                  f"{lost} lost\n\n"
                  f"motor angles beside what is desired: {off[-1]:.2f} mrad, at most {off.max():.2f} in the last 5 s")

    def _draw(self, t: Array, off: Array) -> None:
        if len(t) < 2:
            return
        if self._plot is None:
            self._plot = self.viewer.server.gui.add_uplot((t, off), (
                {"label": "t [s]"}, {"label": "off [mrad]", "stroke": f"rgb{_COLOUR}"}),
                scales={"x": {"time": False}}, aspect=2.0)
        else:
            self._plot.data = (t, off)

    def _ended(self) -> None:
        """Shows the report of a run that is over, where it has left one."""
        file = self._folder / "report.json"
        self._size = -1
        try:
            if file.stat().st_mtime < self._begun:
                return
            report = dict(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, RecursionError):
            return
        failure = report.get("failure")
        self._say(f"**{report.get('scene')}**, {report.get('method')}: "
                  + (f"**ended early:** {failure}" if failure else "the whole path was followed")
                  + f"\n\n{report.get('cycles')} cycles; page: `{report.get('report')}`")

    def _say(self, text: str) -> None:
        if text != self.state:
            self.state = self._panel.content = text


def watch(robot: Robot, folder: Path, port: int, curves: dict[str, Array]) -> LiveView:
    """Opens the page that shows a folder's runs.

    Args:
        robot: the arm.
        folder: of the runs.
        port: TCP port on this machine; the next free one where it is taken.
        curves: further ones to be drawn ``(N, 3)`` [m].
    """
    viewer = Viewer(robot, port)
    for name, points in curves.items():
        viewer.draw(name, points, (40, 40, 40))
    return LiveView(viewer, folder)
