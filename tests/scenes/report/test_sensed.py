"""What the sensors felt, in the base frame: the weight of the tool and the sensor's bias are not the environment's."""

from __future__ import annotations

import numpy as np

from ideal_robot.signals.recording import Recording
from scenes.report.sensed import sensed_force, sensed_line
from tests.scenes.report.test_replay import ROBOT, _replay


def test_the_force_of_the_environment_comes_back() -> None:
    q = _replay(50).q
    true = np.tile([3.0, -4.0, 12.0], (50, 1))
    bias, mass = np.array([1.0, 2.0, -3.0, 0.0, 0.0, 0.0]), 0.8
    pose = ROBOT.fk()
    weight = np.array([0.0, 0.0, -9.81 * mass])
    felt = np.array([pose(row).rotation.T @ (force + weight) for row, force in zip(q, true, strict=True)])
    columns = {name: felt[:, i] + bias[i] for i, name in enumerate(("fx", "fy", "fz"))}
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={"tool": {"bias": bias.tolist(), "mass": mass}}, q=q)
    recording = Recording({**plain.columns, **columns}, plain.meta, "test")
    np.testing.assert_allclose(sensed_force(ROBOT, recording), true, atol=1e-9)
    some = sensed_force(ROBOT, recording, np.array([3, 7]))
    assert some is not None
    assert some.shape == (2, 3)


def test_recordings_without_sensors_have_neither() -> None:
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={}, q=_replay(50).q)
    assert sensed_force(ROBOT, plain) is None
    assert len(sensed_line(ROBOT, plain)) == 0
