"""Joints that the controller counts together: logs are of the URDF's joints again, and the work is the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.clean import cleaned
from ideal_robot.signals.recording import Recording


def arm(folder: Path, table: str = "") -> Robot:
    (folder / "arm.toml").write_text(table, encoding="utf-8")
    return Robot.load(Robot.load("kr6").urdf, folder / "arm.toml")


TABLE = "[[coupled]]\njoint = 3\nby = 2\nshare = -1.0\n[[coupled]]\njoint = 5\nby = 4\nshare = 0.25\n"


def logged() -> Recording:
    t = 0.004 * np.arange(1000)
    rates, home = np.linspace(1.1, 2.3, 6), Robot.load("kr6").home
    q = home + 0.3 * np.sin(t[:, None] * rates)
    return Recording.from_arrays(t, q=q, q_c=home + 0.3 * np.sin((t[:, None] + 0.01) * rates),
                                 qd=0.3 * rates * np.cos(t[:, None] * rates),
                                 tau=40.0 * np.cos(t[:, None] * rates) + 5.0 * q)


def test_what_a_controller_counts_together_is_taken_apart(tmp_path: Path) -> None:
    plain, coupled = arm(tmp_path), arm(tmp_path, TABLE)
    own = logged()
    C = coupled.counted
    np.testing.assert_array_equal(C[2], [0, -1, 1, 0, 0, 0])
    by_controller = {kind: own.joints(kind) @ C.T for kind in ("q", "q_c", "qd")}
    counted = Recording.from_arrays(own.t, tau=own.joints("tau") @ np.linalg.inv(C), **by_controller)
    # Each does the same work as the URDF's joints do.
    np.testing.assert_allclose(np.sum(counted.joints("tau") * counted.joints("qd"), axis=1),
                               np.sum(own.joints("tau") * own.joints("qd"), axis=1), atol=1e-9)
    apart, asked = (cleaned(one, robot, commands=True) for one, robot in ((counted, coupled), (own, plain)))
    for kind in ("q", "q_c", "qd", "tau"):
        np.testing.assert_allclose(apart.recording.joints(kind), asked.recording.joints(kind), atol=1e-9)
    assert any(text.startswith("coupled: ") and "joint 3 with -1 of joint 2" in text for text in apart.acts)


def test_what_the_program_has_recorded_is_of_the_urdf_s_joints(tmp_path: Path) -> None:
    own = logged()
    named = replace(own, meta={**own.meta, "robot": "kr6"})
    np.testing.assert_array_equal(cleaned(named, arm(tmp_path, TABLE)).recording.joints("q"), own.joints("q"))


@pytest.mark.parametrize(("table", "field"), [
    (TABLE.replace("joint = 3", "joint = 7"), "coupled.0.joint"), (TABLE.replace("by = 2", "by = 3"), "coupled.0.by"),
    (TABLE.replace("-1.0", '"much"'), "share"), (TABLE.replace("joint = 3\n", ""), "joint"),
    (TABLE + "[[coupled]]\njoint = 2\nby = 3\nshare = -1.0\n", "coupled")])
def test_a_coupling_that_cannot_be_is_refused(tmp_path: Path, table: str, field: str) -> None:
    with pytest.raises(InputError) as refused:
        arm(tmp_path, table)
    assert field in str(refused.value)
