"""The camera of an arm elsewhere: what is known of its motion, when it exposes, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.state_reader import ReportedState, no_radians
from scenes.commands.devices import SimulateOptions, simulate
from scenes.serve.elsewhere import ArmElsewhere, CameraOfArm
from sim.devices.stream_server import DeviceClock

ROBOT = Robot.load("kr6")
DRIFT, OFFSET = 80e-6, 4711.0
"""Of the controller's clock against this computer's."""


def angles(t: float) -> Array:
    return np.asarray(ROBOT.home + 0.2 * np.sin(3.0 * t + np.arange(6.0)))


def host_of(t: float) -> float:
    return OFFSET + t / (1.0 + DRIFT)


def states(times: Array, rng: np.random.Generator, late: float = 3e-4) -> list[ReportedState]:
    """Each arrives after a delay of its own."""
    return [ReportedState(float(t), host_of(t) + late * (1.0 + float(rng.exponential())), angles(t)) for t in times]


class Eye:
    """A ``ServedCamera`` that notes what it exposes."""

    def __init__(self) -> None:
        self.exposed: list[tuple[float, float, float]] = []

    def expose(self, t: float, instant: float, clock: DeviceClock) -> None:
        self.exposed.append((t, instant, clock.shows(instant)))


def test_angles_between_states_are_known_whatever_becomes_of_some() -> None:
    rng = np.random.default_rng(1)
    times = 0.004 * np.arange(300)
    sent = states(times[rng.random(300) > 0.05], rng)
    # One comes twice, two overtake each other, one is no state.
    sent[40:40] = [sent[39]]
    sent[80], sent[81] = sent[81], sent[80]
    sent.append(ReportedState(1.3, host_of(1.3), np.full(6, np.nan)))
    arm = ArmElsewhere(ROBOT)
    arm.add(sent)
    first, last = arm.known
    assert last - first > 1.1
    for t in rng.uniform(first, last, 50):
        np.testing.assert_allclose(arm.q_at(t), angles(t), atol=2e-6)
    assert arm.restarts == 0


def test_pictures_are_stamped_with_the_instant_of_the_controllers_clock_in_which_the_arm_was_there() -> None:
    rng, eye = np.random.default_rng(2), Eye()
    arm = ArmElsewhere(ROBOT)
    camera = CameraOfArm(arm, eye, SimpleNamespace(rate=50.0, exposure=0.002))  # type: ignore[arg-type]
    for part in np.array_split(0.004 * np.arange(2000), 700):
        arm.add(states(part, rng))
        camera.look()
    t, instant, stamp = np.array(eye.exposed).T
    assert len(t) > 380
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    np.testing.assert_allclose(stamp, t, atol=1e-9)
    # By this computer's clock but for the least delay of the states, which a follower's clock of the arm holds, too.
    late = instant[100:] - np.array([host_of(x) for x in t[100:]])
    assert np.all((late > 2.9e-4) & (late < 5e-4))


@pytest.mark.parametrize("new", [0.0, 500.0])
def test_a_simulation_that_begins_anew_begins_a_new_clock(new: float) -> None:
    eye = Eye()
    arm = ArmElsewhere(ROBOT)
    camera = CameraOfArm(arm, eye, SimpleNamespace(rate=50.0, exposure=0.002))  # type: ignore[arg-type]
    for begin in (100.0, new):
        for t in begin + 0.004 * np.arange(300):
            arm.add([ReportedState(float(t), 60.0 + (begin == new) * 2.0 + t - begin, angles(t))])
            camera.look()
    assert arm.restarts == 1
    before, after = ([t for t, *_ in eye.exposed if abs(t - begin) < 3.0] for begin in (100.0, new))
    assert min(len(before), len(after)) > 50
    assert np.all(np.array(arm.path)[:, 0] >= new)


def test_degrees_are_no_radians() -> None:
    names = tuple(ROBOT.pinocchio.names)[1:]
    assert no_radians(ROBOT, names, ROBOT.home, "/joint_states") is None
    assert "look like degrees" in str(no_radians(ROBOT, names, np.degrees(ROBOT.home), "/joint_states"))
    assert no_radians(ROBOT, names, np.full(6, np.nan), "/joint_states") is not None


@pytest.mark.parametrize(("scene", "given", "says"), [
    ("line", {"camera_of": "rsi://127.0.0.1:49152"}, r"reports to nobody but .*expected rtde:// or ros2://"),
    ("line", {"camera_of": "rtde://127.0.0.1:1", "wait": 0.2}, "no controller at 127.0.0.1:1"),
    ("line", {"camera_of": "127.0.0.1"}, "expected an address"),
    ("line", {"camera_of": "rtde://127.0.0.1", "serve": True}, "either --serve or --camera-of"),
    ("force_wave", {"camera_of": "rtde://127.0.0.1"}, "only scenes of kind line"),
    ("line", {}, "--camera-of ADDRESS"),
])
def test_an_arm_that_cannot_be_read_is_bad_input(scene: str, given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        simulate(SimulateOptions(scene=scene, **given))
