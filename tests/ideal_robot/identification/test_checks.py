"""Wrong recordings: a clear error or a named warning, never a silent wrong model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked, require_motion
from ideal_robot.identification.idim import identify
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.arm import record, robot, truth


@pytest.fixture(scope="module")
def good() -> Recording:
    return record(truth(), np.random.default_rng(0), rate=100.0)


def changed(recording: Recording, **columns: np.ndarray | None) -> Recording:
    values = {**recording.columns, **columns}
    return Recording({k: np.array(v) for k, v in values.items() if v is not None}, recording.meta, recording.source)


def test_a_good_recording_passes(good: Recording) -> None:
    usable, warnings = checked([good], robot())
    assert warnings == []
    assert usable[0].hash == good.hash


def test_missing_columns(good: Recording) -> None:
    with pytest.raises(InputError, match="tau_3"):
        identify([changed(good, tau_3=None)], robot())
    with pytest.raises(InputError, match="q_1"):
        identify([changed(good, q_1=None)], robot())
    with pytest.raises(InputError, match="t \\[s\\]"):
        changed(good, t=None)


def test_other_joint_count(good: Recording) -> None:
    with pytest.raises(InputError, match=r"5 joints .*has 6"):
        identify([changed(good, q_6=None)], robot())


def test_a_recording_of_another_shipped_arm(good: Recording) -> None:
    """A path of the KR 15 read with the KR 6's URDF gave kinematic errors of 46 mm instead of a word."""
    named = Recording(dict(good.columns), {"robot": "kr15"}, "path.parquet")
    with pytest.raises(InputError, match=r"of kr15, not of kr6; give --urdf kr15"):
        checked([named], Robot.load("kr6"))


def test_time_going_backwards(good: Recording) -> None:
    t = np.array(good.t)
    t[50] = t[48]
    with pytest.raises(InputError, match="does not increase at sample 50"):
        identify([changed(good, t=t)], robot())


def test_degrees_are_seen_from_the_limits(good: Recording) -> None:
    degrees = {f"q_{i + 1}": np.degrees(good.columns[f"q_{i + 1}"]) for i in range(6)}
    with pytest.raises(InputError, match="degrees"):
        identify([changed(good, **degrees)], robot())


def test_no_torque(good: Recording) -> None:
    with pytest.raises(InputError, match="every torque is zero"):
        identify([changed(good, **{f"tau_{i + 1}": np.zeros(len(good.t)) for i in range(6)})], robot())
    with pytest.raises(InputError, match="tau_4"):
        identify([changed(good, tau_4=np.zeros(len(good.t)))], robot())


def test_too_short(good: Recording) -> None:
    with pytest.raises(InputError, match="too short"):
        identify([Recording({k: v[:60].copy() for k, v in good.columns.items()})], robot())


def test_no_recording() -> None:
    with pytest.raises(InputError, match="no recording"):
        identify([], robot())


def test_a_few_nans_are_left_out_and_said(good: Recording) -> None:
    q = np.array(good.columns["q_2"])
    q[[100, 101, 500]] = np.nan
    usable, warnings = checked([changed(good, q_2=q)], robot())
    assert len(usable[0].t) == len(good.t) - 3
    assert warnings[0].startswith("not-a-number: 3 samples")
    q[: len(q) // 4] = np.nan
    with pytest.raises(InputError, match="q_2"):
        checked([changed(good, q_2=q)], robot())


def test_a_joint_that_never_moves_is_said_and_keeps_its_nominal_values() -> None:
    what = truth()
    moving = record(what, np.random.default_rng(0), rate=100.0)
    still = changed(moving, q_6=np.full(len(moving.t), 0.3))
    result = identify([still], robot(), friction="viscous_coulomb")
    names = [w.split(":")[0] for w in result.warnings]
    assert "joint-never-moves" in names
    assert "not-excited" in names
    assert np.all(np.isfinite(result.model.inverse_dynamics(*np.zeros((3, 1, 6)))))


def test_current_becomes_torque(good: Recording) -> None:
    arm = robot()
    columns = {k: v for k, v in good.columns.items() if not k.startswith("tau")}
    columns |= {f"current_{i + 1}": good.columns[f"tau_{i + 1}"] / arm.drive_gain[i] for i in range(6)}
    usable, warnings = checked([Recording(columns)], arm)
    np.testing.assert_allclose(usable[0].joints("tau"), good.joints("tau"))
    assert warnings == []
    _, warnings = checked([Recording(columns)], replace(arm, drive_gain=np.ones(6)))
    assert warnings[0].startswith("unknown-drive-gain")


def test_joints_named_by_a_bag_are_put_in_the_robots_order(good: Recording) -> None:
    names = list(robot().pinocchio.names)[1:]
    order = [3, 1, 0, 5, 4, 2]
    columns = {"t": good.t, **{f"{p}_{i + 1}": good.columns[f"{p}_{j + 1}"] for p in ("q", "tau")
                               for i, j in enumerate(order)}}
    usable, _ = checked([Recording(columns, {"joints": [names[j] for j in order]})], robot())
    np.testing.assert_array_equal(usable[0].joints("q"), good.joints("q"))


def test_an_arm_at_rest_tells_nothing(good: Recording) -> None:
    still = changed(good, **{f"q_{i}": 1e-6 * good.columns[f"q_{i}"] for i in range(1, good.n + 1)})
    with pytest.raises(InputError, match="no joint moves"):
        identify([still], robot())
    require_motion([still, good])
