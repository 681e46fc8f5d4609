"""Samples taken irregularly and stamped as if they were regular."""

import numpy as np
import pytest

from ideal_robot.identification.checks import checked
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling_jitter import sampling_instants
from ideal_robot.signals.stamps import regular_stamps


def _motion(t: np.ndarray, n: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    phase, size = rng.uniform(0.0, 6.28, (n, 4)), rng.uniform(0.1, 0.4, (n, 4))
    return np.column_stack([sum(size[j, k] * np.sin(2 * np.pi * 0.15 * (k + 1) * t + phase[j, k]) for k in range(4))
                            for j in range(n)])


@pytest.mark.parametrize(("step", "encoder"), [(0.01, 1e-4), (0.004, 1e-5)])
def test_instants_are_told_by_the_motion(step: float, encoder: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 20.0, step)
    late = rng.uniform(-0.15, 0.15, len(t)) * step
    q = np.round(_motion(t + late, 5) / encoder) * encoder
    at, spread = sampling_instants(t, q)
    assert spread == pytest.approx(np.std(late), rel=0.2)
    # What a filter of 5 Hz takes for motion stays.
    inner = slice(50, -50)
    assert np.std((at - t - late)[inner]) < 0.45 * np.std(late)


def test_regular_samples_stay_where_they_are() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    q = np.round(_motion(t, 5) / 1e-4) * 1e-4
    assert sampling_instants(t, q)[1] == 0.0
    # Vibrations are no clock: they do not follow each joint's speed.
    shake = 3e-4 * np.sin(2 * np.pi * 17.0 * t)[:, None] * np.array([1.0, -0.5, 0.8, 0.3, -1.0])
    assert sampling_instants(t, q + shake)[1] == 0.0


def test_stamps_that_are_right_are_kept() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 20.0, 0.01) + rng.uniform(-0.0015, 0.0015, 2000)
    assert sampling_instants(t, np.round(_motion(t, 5) / 1e-4) * 1e-4)[1] == 0.0


def test_checked_recording_says_so() -> None:
    rng = np.random.default_rng(3)
    robot = Robot.load("kr6")
    t = np.arange(0.0, 20.0, 0.01)
    q = _motion(t + rng.uniform(-0.0015, 0.0015, len(t)), robot.n)
    columns = {"t": t, **{f"q_{j + 1}": q[:, j] for j in range(robot.n)},
               **{f"tau_{j + 1}": np.sin(t + j) for j in range(robot.n)}}
    (made,), warnings = checked([Recording(columns, {}, "jittery")], robot)
    assert any(text.startswith("irregular-sampling") for text in warnings)
    assert np.std(made.t - t) == pytest.approx(0.0015 / np.sqrt(3.0), rel=0.2)


def test_joints_that_move_in_step_are_no_clock() -> None:
    """Strokes whose acceleration jumps are as fast as any jitter, and in all joints alike."""
    t = np.arange(0.0, 20.0, 0.01)
    stroke = np.cumsum(np.cumsum(8.0 * np.sign(np.sin(2 * np.pi * 1.3 * t))) * 0.01) * 0.01
    stroke -= np.polyval(np.polyfit(t, stroke, 1), t)
    q = stroke[:, None] * np.array([0.8, -0.5, 1.0, 0.3, -0.7])
    assert sampling_instants(t, np.round(q / 1e-4) * 1e-4)[1] == 0.0


@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_irregular_samples_with_jittering_stamps_are_not_put_on_a_clock(lost: float) -> None:
    """A clock made of such stamps is less rough than they are, and was taken for the one that had sampled."""
    rng = np.random.default_rng(4)
    robot = Robot.load("kr6")
    # Some steps are a fifth longer, as a logger has them that waits for its controller.
    at = np.cumsum(rng.choice([0.0100, 0.0120], size=4000, p=[0.7, 0.3]))
    stamps = np.sort(at + np.clip(rng.normal(scale=1e-3, size=len(at)), -1.9e-3, 1.9e-3))
    q = np.round(_motion(at, robot.n) / 1e-4) * 1e-4
    keep = rng.random(len(at)) >= lost
    columns = {"t": stamps, **{f"q_{j + 1}": q[:, j] for j in range(robot.n)},
               **{f"tau_{j + 1}": np.sin(at + j) for j in range(robot.n)}}
    (made,), _ = checked([Recording({name: v[keep] for name, v in columns.items()}, {}, "jittery")], robot)
    error = (made.t - at[keep])[50:-50]
    assert np.std(error) < 0.5 * np.std((stamps - at)[keep])
    q_now, _ = regular_stamps(made.t, made.joints("q"))
    np.testing.assert_array_equal(q_now, made.t)
