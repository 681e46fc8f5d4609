"""A long run keeps a bounded number of rows in memory and loses none."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot import row_log
from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import KEPT
from ideal_robot.signals import column_store
from ideal_robot.signals.recording import Recording
from sim.arm import history as of_arm
from sim.arm.arm import SimulatedArm
from sim.arm.history import History
from sim.arm.kernel import LOGGED
from sim.arm.world import World


def fill(history: History, rows: int) -> None:
    for _ in range(rows):
        history.reserve(1)
        history.next_row[:] = history.rows + np.arange(len(history.next_row)) / 100.0
        history.next_row[0] = history.rows * history.step
        history.rows += 1


def test_rows_in_memory_are_bounded_and_all_rows_are_there() -> None:
    history, rows = History(1, 0.002), 3 * KEPT + 500
    fill(history, rows)
    assert history.kept <= KEPT
    early = history.columns()
    fill(history, KEPT)
    assert history.kept <= KEPT
    found = history.columns()
    assert len(early["t"]) == rows
    assert len(found["t"]) == rows + KEPT
    np.testing.assert_allclose(found["t"], 0.002 * np.arange(rows + KEPT))
    for i, name in enumerate(LOGGED):
        np.testing.assert_array_equal(found[name][:, 0], np.arange(rows + KEPT) + (1 + i) / 100.0)


def test_a_pose_of_long_ago_is_known() -> None:
    history = History(1, 0.002)
    fill(history, KEPT + 100)
    now = np.zeros(1)
    for row in (3, KEPT - 1, KEPT, KEPT + 50):
        at = history.pose(row * 0.002, 1e9, now, now)
        np.testing.assert_allclose(at, row + (1 + LOGGED.index("q_a")) / 100.0, atol=1e-9)


def test_a_recording_of_many_pieces_is_that_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def played() -> tuple[Recording, Array]:
        robot = Robot.load("kr6")
        with SimulatedArm(robot, World.from_table("kr6", {}), np.random.default_rng(3)) as arm:
            for k in range(150):
                arm.cycle(robot.home + 1e-4 * k)
            return arm.recording(external=True), arm.tcp_path()[1]

    whole, tool = played()
    for module in (row_log, of_arm, column_store):
        monkeypatch.setattr(module, "KEPT", 512)
    pieces, tool_of_pieces = played()
    assert len(whole.t) > 512
    assert column_store.in_file(pieces.t)
    assert not column_store.in_file(whole.t)
    assert pieces.hash == whole.hash
    np.testing.assert_array_equal(tool_of_pieces, tool)
