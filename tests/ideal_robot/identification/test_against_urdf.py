"""A recording that is not what it seems is said to be so, with the remedy; one that is what it seems is not accused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.identification.against_urdf import (
    EXCHANGED,
    NO_GRAVITY,
    TURNED,
    WRONG_SCALE,
    WRONG_SIGN,
    Finding,
    findings,
)
from ideal_robot.identification.inspection import inspect
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.clean import cleaned
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.test_excitation import logged, record, robot, truth
from tests.sources import DATA

GRAVITY = 9.81


@cache
def good(seed: int = 0) -> Recording:
    return record(truth(), np.random.default_rng(seed), rate=100.0)


def torques(change: Callable[[np.ndarray], np.ndarray], seed: int = 0) -> Recording:
    """The recording with other torques ``(N, 6)``."""
    recording = good(seed)
    tau = change(recording.joints("tau"))
    return replace(recording, columns={**recording.columns, **{f"tau_{j + 1}": tau[:, j] for j in range(6)}})


def found(recording: Recording, arm: Robot | None = None) -> dict[str, Finding]:
    return {finding.kind: finding for finding in findings(recording, arm or robot())}


def gravity(q: np.ndarray) -> np.ndarray:
    model = robot().pinocchio
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, one) for one in q])


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_recording_that_is_what_it_seems_is_not_accused(seed: int) -> None:
    assert found(good(seed)) == {}


def along_a_line(seed: int, seconds: float) -> Recording:
    """A small motion between two rests, as along a line, of an arm whose friction the comparison does not know."""
    arm, rng = robot(), np.random.default_rng(seed)
    t = np.arange(0.0, seconds + 1.0, 0.01)
    share = np.clip((t - 0.5) / seconds, 0.0, 1.0)
    # A minimum-jerk step: rest, one push, rest.
    steps = [share**3 * (10.0 - 15.0 * share + 6.0 * share**2), 30.0 * share**2 * (1.0 - share) ** 2 / seconds,
             60.0 * share * (1.0 - share) * (1.0 - 2.0 * share) / seconds**2]
    way = rng.uniform(-0.5, 0.5, arm.n)
    q, qd, qdd = (np.outer(step, way) for step in steps)
    recording = logged(truth(), rng, t, (arm.home + q, qd, qdd), 0.002)
    # Friction that falls with speed, turns over slowly and is larger to one side: 4 % of the torque that is allowed.
    beside = 0.04 * arm.tau_max * np.tanh(qd / 0.02 + 0.3) * (1.0 + 1.5 * np.exp(-np.abs(qd) / 0.1))
    tau = recording.joints("tau") + beside
    return replace(recording, columns={**recording.columns, **{f"tau_{j + 1}": tau[:, j] for j in range(arm.n)}})


@pytest.mark.parametrize("seconds", [4.0, 12.0])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, 3, 4, 5, 6, 7))])
def test_a_motion_that_hardly_tells_accuses_nobody(seed: int, seconds: float) -> None:
    # A free fit of 244 columns leaves nothing of 30 rows: as noise it made every recording of a short line wrong.
    assert found(along_a_line(seed, seconds)) == {}


@pytest.mark.parametrize("joints", [(2, 5), *(
    pytest.param(joints, marks=pytest.mark.slow) for joints in ((6,), (1, 2, 3, 4, 5, 6)))])
def test_signs_are_said_by_joint(joints: tuple[int, ...]) -> None:
    sign = np.where(np.isin(np.arange(1, 7), joints), -1.0, 1.0)
    said = found(torques(lambda tau: sign * tau))
    assert said.keys() == {WRONG_SIGN}
    assert said[WRONG_SIGN].joints == joints
    assert "multiply tau_" in said[WRONG_SIGN].text


@pytest.mark.parametrize("pair", [(2, 3), pytest.param((5, 6), marks=pytest.mark.slow)])
def test_exchanged_columns_are_said(pair: tuple[int, int]) -> None:
    order = list(range(6))
    a, b = (joint - 1 for joint in pair)
    order[a], order[b] = order[b], order[a]
    said = found(torques(lambda tau: tau[:, order]))
    assert said[EXCHANGED].joints == pair


def test_torques_without_gravity_are_said() -> None:
    q = good().joints("q")
    assert NO_GRAVITY in found(torques(lambda tau: tau - 1.03 * gravity(q)))


@pytest.mark.parametrize("unit", [1.0 / np.array([125.0, 125, 100, 68, 62, 48]),
                                  pytest.param(
                                      1e3 / np.array([500.0, 500, 300, 40, 40, 25]), marks=pytest.mark.slow),
                                  pytest.param(np.full(6, 1e3), marks=pytest.mark.slow)])
def test_other_units_are_said(unit: np.ndarray) -> None:
    said = found(torques(lambda tau: unit * tau))
    assert WRONG_SCALE in said
    assert not {WRONG_SIGN, NO_GRAVITY} & said.keys()
    # Half the unit and half the masses explain as much: a factor was off by two.
    pairs = re.findall(r"tau_(\d) × ([\d.]+)", said[WRONG_SCALE].text)
    factors = {int(joint): float(factor) for joint, factor in pairs}
    assert len(factors) >= 3
    for joint, factor in factors.items():
        assert abs(np.log(factor * unit[joint - 1])) < np.log(1.25 if joint <= 3 else 2.0)


@pytest.mark.parametrize("degrees", [90.0, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (20.0, 180.0))])
def test_an_arm_that_is_mounted_otherwise_is_said(degrees: float) -> None:
    arm = robot()
    model = arm.pinocchio.copy()
    angle = np.radians(degrees)
    model.gravity.linear = GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    recording, data = good(), model.createData()
    q = recording.joints("q")
    turned = np.array([pin.computeGeneralizedGravity(model, data, one) for one in q]) - gravity(q)
    said = found(torques(lambda tau: tau + turned))
    assert said.keys() == {TURNED}
    assert float(said[TURNED].text.split("acts ")[1].split("°")[0]) == pytest.approx(degrees, abs=6.0)


def test_inspection_says_it_and_what_was_read() -> None:
    seen = inspect(torques(lambda tau: tau * [1, -1, 1, 1, 1, 1]), robot())
    assert not seen.usable
    assert seen.to_dict()["contradictions"][0]["joints"] == [2]
    assert inspect(good(), robot()).usable
    assert dict(inspect(good(), robot()).summary())["does not fit"] == "nothing"
    beyond = inspect(torques(lambda tau: tau * [1, 1, 1, 1, 1, 30]), robot())
    assert not beyond.ranges[-1].fits
    assert "tau_6" in dict(beyond.summary())["does not fit"]
    assert inspect(replace(good(), columns={**good().columns, "t": np.zeros(len(good().t))}), robot()).refused


MEASURED = [("ur10e/free_12harm_30s", "ur10e/ur10e"), ("panda/panda_a", "panda/panda"),
            ("tiago/tiago_b", "tiago/tiago"), ("ur5/ur5_no7", "ur5/ur5"), ("emps/emps_estimation", "emps/emps")]


@pytest.mark.skipif(not DATA.exists(), reason="measured data (../shared/data) are not there")
@pytest.mark.parametrize(("file", "arm"), [pytest.param(*one, marks=() if k == 1 else pytest.mark.slow)
                                           for k, one in enumerate(MEASURED)])
def test_measured_arms_are_not_accused(file: str, arm: str) -> None:
    loaded = Robot.load(DATA / f"{arm}.urdf")
    done = cleaned(Recording.read(DATA / f"{file}.parquet"), loaded)
    assert findings(done.recording, loaded, amperes=done.amperes) == ()
