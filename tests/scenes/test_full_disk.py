"""A disk that is full: an arm that moves is brought to rest, what was there before stays, and one line says so."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest

from ideal_robot import row_log
from ideal_robot.robots.robot import Robot
from scenes.cycle import CycleLog, CycleSettings, play_cycles
from scenes.result import silent
from tests.scenes.test_pinned_findings import Drifting


def test_an_arm_whose_log_finds_no_room_is_brought_to_rest_on_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is lost: rows that no file takes stay in memory."""
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(row_log, "KEPT", 512)
    monkeypatch.setattr(os, "pwrite", full)
    task, log = Drifting(sound=1e9, step=1e-4), CycleLog()
    play_cycles(task, Robot.load("kr6"), task, log, CycleSettings(5.0, 0.1, 20.0, 20.0, ""), silent)
    assert log.failure is not None
    assert "stopped on the path" in log.failure
    assert "make room" in log.failure
    commands = np.array(task.commands)
    assert 512 < len(commands) < 1000
    np.testing.assert_array_equal(np.array(log.q_c), commands)
    assert np.ptp(commands[-5:], axis=0).max() < 1e-9
    assert np.all(np.diff(commands, axis=0) > -1e-12)
