"""ROS 2 against controllers written from its documentation, over the middleware itself."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="a sourced ROS 2, or pip install 'ideal-robot[ros2]'")

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.interfaces import LinkSettings, interface_of, read_arm
from ideal_robot.robots.address import Address
from ideal_robot.robots.robot import Robot
from ideal_robot.ros2.node import Ros2Error, full_name
from ideal_robot.ros2.robot import Ros2Robot, opened
from scenes.online.path_player import PathPlayer
from scenes.scene_files.drawn_line import CameraTable, believed_camera
from sensing.camera.cameras import open_camera
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.ros2_arm import Ros2Arm
from sim.devices.ros2_camera import ImageTopic

pytestmark = [pytest.mark.slow, pytest.mark.real_time]
ROBOT = Robot.load("kr6")
T = ROBOT.t_ipo
FORWARD = "ros2://"
TRAJECTORY = "ros2://?trajectory=/joint_trajectory_controller/joint_trajectory"


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A domain of this process's own, so that nobody else on this computer is heard."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))


@contextmanager
def led(address: str = FORWARD, patience: float = 20.0, slowed: float = 6.0, **options: Any
        ) -> Iterator[tuple[Ros2Robot, Ros2Arm]]:
    """A link that is connected to controllers in a thread."""
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        arm.cycle(arm.truth.q_m)
        controllers = Ros2Arm(arm, **options)
        # Slower than true time: both sides share one interpreter, and a busy computer.
        thread = threading.Thread(target=controllers.play, kwargs={"slowed": slowed}, daemon=True)
        thread.start()
        link = opened(Address.parse(address), ROBOT, LinkSettings(bridge=0.5))
        link._timeout = 5.0
        try:
            with link:
                link.connect(patience)
                yield link, controllers
        finally:
            controllers.stop()
            thread.join(10.0)
            controllers.close()


def way(k: int, span: int = 60) -> Array:
    u = min(max(k, 0) / span, 1.0)
    return np.asarray(ROBOT.home + 0.2 * u**3 * (10 - 15 * u + 6 * u**2))


def path(rows: int = 80) -> Array:
    return np.array([way(k) for k in range(rows)])


def played(link: Ros2Robot, q_d: Array) -> Any:
    return PathPlayer(link, PassThrough(T), q_d, 0).played([])


@pytest.mark.parametrize("address", [FORWARD, TRAJECTORY])
def test_joints_are_found_by_name_and_commands_go_by_the_controllers_order(address: str) -> None:
    with led(address, shuffled=[4, 1, 0, 5, 3, 2]) as (link, controllers):
        run = played(link, path())
    assert run.failure is None
    # Where a joint state came too late for its cycle the path went on with the controller.
    q_c, rows = run.recording.joints("q_c"), np.round(run.recording.t / T).astype(int)
    assert len(q_c) > 20
    if address == TRAJECTORY:
        np.testing.assert_allclose(q_c, [way(k) for k in rows - rows[0]], atol=1e-9)
    np.testing.assert_allclose(controllers.run.commands[-1], way(80), atol=1e-4)
    np.testing.assert_allclose(run.recording.joints("q")[-1], way(80), atol=5e-3)
    assert run.counts["partial"] > 0
    assert run.recording.has("tau")
    # Time is that of the headers.
    steps = np.diff(run.recording.t) / T
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_who_was_behind_once_is_not_behind_for_ever_and_what_came_meanwhile_is_not_lost() -> None:
    with led(slowed=0.0) as (link, controllers):
        controllers.timeout = T
        link.cycle(way(0))
        time.sleep(6 * T)
        controllers.timeout = 0.5
        for k in range(1, 6):
            state = link.cycle(way(k))
            if k == 1:
                older = [one.t for one in link.unanswered]
            # What was answered last is what was published last, so that no command is older than it has to be.
            assert link._last == pytest.approx(controllers._stamp, abs=1e-6) or k == 1
    assert link.counts.lost == 0
    assert link.counts.late == len(older) >= 3
    np.testing.assert_allclose(np.diff(older), T, atol=1e-6)
    assert state.t > older[-1]


def test_a_trajectorys_horizon_bridges_what_is_lost_and_late() -> None:
    rng = np.random.default_rng(3)

    def delivered(k: int) -> list[float]:
        return [[], [0.0, 0.0], [0.03], [0.0]][rng.choice(4, p=[0.03, 0.03, 0.05, 0.89])]

    with led(TRAJECTORY, delivered=delivered) as (link, controllers):
        run = played(link, path(120))
    assert run.failure is None
    assert run.counts["lost"] > 0
    commands = np.array(controllers.run.commands)
    # The references of the controller stay a path: no jump where a state or its answer was missed.
    acceleration = np.abs(np.diff(commands, 2, axis=0)).max(axis=0) / T**2
    assert np.all(acceleration < 1.5 * ROBOT.a_max)
    np.testing.assert_allclose(commands[-1], way(120), atol=1e-6)


def test_who_falls_silent_lets_the_trajectory_come_to_rest() -> None:
    with led(TRAJECTORY) as (link, controllers):
        for k in range(30):
            link.cycle(way(k))
        count = len(controllers.run.commands)
        while len(controllers.run.commands) < count + 40:
            link._node.spin(0.01)
    commands = np.array(controllers.run.commands)[count - 5 :]
    assert np.abs(np.diff(commands, axis=0))[-5:].max() < 1e-9
    assert np.abs(np.diff(commands, 2, axis=0)).max() < np.max(ROBOT.a_max) * T**2 * 1.5


@pytest.mark.parametrize(("address", "options", "says"), [
    ("ros2://other", {}, r"no node publishes /other/joint_states; topics of .* are /joint_states"),
    ("ros2://?states=/forward_position_controller/commands", {}, "cannot be subscribed to as JointState"),
    ("ros2://?commands=/velocity_controller/commands", {}, "no node subscribes to /velocity_controller/commands"),
    ("ros2://?trajectory=/forward_position_controller/commands", {}, "expects std_msgs/msg/Float64MultiArray"),
    ("ros2://", {"durable": True}, "quality of service of simulated_controllers"),
    ("ros2://", {"degrees": True}, "look like degrees"),
    ("ros2://", {"domain": 101}, "no node publishes /joint_states; there is no topic")])
def test_what_does_not_match_is_named_before_anything_moves(address: str, options: dict, says: str) -> None:
    with pytest.raises(Ros2Error, match=says), led(address, patience=3.0, **options):
        pass


def test_best_effort_states_are_heard() -> None:
    with led(reliable=False) as (link, _):
        assert link.cycle(way(0)).t > 0


def test_a_second_publisher_of_commands_is_named_before_and_while_the_arm_moves() -> None:
    import rclpy
    from std_msgs.msg import Float64MultiArray

    context = rclpy.Context()
    rclpy.init(context=context)
    other = rclpy.create_node("somebody_else", context=context, enable_rosout=False, start_parameter_services=False)
    try:
        with led() as (link, _):
            link._looked = 0.0
            other.create_publisher(Float64MultiArray, "/forward_position_controller/commands", 1)
            k = 0
            while link.fault is None and k < 400:
                link.cycle(way(0))
                k += 1
            assert "somebody_else publishes" in link.fault
        with pytest.raises(Ros2Error, match="somebody_else publishes"), led():
            pass
    finally:
        other.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(("change", "says"), [
    (lambda arm: setattr(arm, "frozen", True), "stand still or go back"),
    (lambda arm: setattr(arm, "silent", True), "no message on /joint_states|has not all joints")])
def test_time_that_stands_and_silence_are_said(change: Callable[[Ros2Arm], None], says: str) -> None:
    def goes(link: Ros2Robot, controllers: Ros2Arm) -> None:
        link._timeout = 0.5
        for k in range(60):
            if k == 10:
                change(controllers)
            link.cycle(way(0))

    with led() as (link, controllers), pytest.raises(Ros2Error, match=says):
        goes(link, controllers)


def test_another_cycle_is_said() -> None:
    with led() as (link, _), pytest.raises(Ros2Error, match=r"comes every 8 ms, 12 ms are expected; --cycle 0\.008"):
        link._check_cycle(np.full(8, 0.008))


@pytest.mark.parametrize(("address", "says"), [
    ("ros2://?commands=a&trajectory=b", "either commands or trajectory"), ("ros2://?state=/x", "did you mean 'states'"),
    ("ros2://?joints=a,b", "expected the joints of kr6"), ("ros2://?discovery=moon", "localhost or subnet"),
    ("ros2://?sim_time=2", "from 0 to 1")])
def test_addresses_that_cannot_be(address: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        opened(interface_of(address)[1], ROBOT, LinkSettings())


def test_names_in_a_namespace() -> None:
    assert full_name("left/arm", "joint_states") == "/left/arm/joint_states"
    link = opened(Address.parse("ros2://left/arm?commands=c"), ROBOT, LinkSettings())
    assert (link.states, link.commands) == ("/left/arm/joint_states", "/left/arm/c")


# Who does not lead the arm reads along.

@contextmanager
def playing(**options: Any) -> Iterator[Ros2Arm]:
    """Controllers in a thread that nobody leads."""
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        arm.cycle(arm.truth.q_m)
        controllers = Ros2Arm(arm, **options)
        thread = threading.Thread(target=controllers.play, daemon=True)
        thread.start()
        try:
            yield controllers
        finally:
            controllers.stop()
            thread.join(10.0)
            controllers.close()


def test_states_are_read_without_leading_the_arm() -> None:
    with playing(shuffled=[4, 1, 0, 5, 3, 2]) as controllers, read_arm("ros2://", ROBOT, 10.0, "--camera-of") as states:
        read = [state for _ in range(40) for state in states.read(1.0)]
        assert controllers.run.heard == 0
    assert len(read) >= 40
    np.testing.assert_allclose(np.diff([state.t for state in read]), T, atol=1e-6)
    np.testing.assert_allclose([state.q for state in read], np.tile(ROBOT.home, (len(read), 1)), atol=1e-2)


def test_states_of_another_arm_are_bad_input() -> None:
    with playing(degrees=True), pytest.raises(InputError, match="look like degrees"), read_arm(
            "ros2://", ROBOT, 10.0, "--camera-of"):
        pass
    with playing() as controllers:
        names, controllers._names = controllers._names, [*controllers._names[:5], "another"]
        assert len(names) == 6
        with pytest.raises(InputError, match=f"has not all joints of kr6: {names[0]}"), read_arm(
                "ros2://", ROBOT, 2.0, "--camera-of"):
            pass


def test_pictures_on_a_topic_are_what_a_camera_reads() -> None:
    camera = believed_camera(CameraTable())
    shown = np.random.default_rng(1).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)
    topic = ImageTopic("/cell/camera/image_raw", camera)
    ended = threading.Event()

    def send() -> None:
        k = 0
        while not ended.wait(0.02):
            topic.send(100.0 + 0.02 * k, shown)
            k += 1

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        eye = open_camera("ros2:///cell/camera/image_raw", 0.03)
        assert topic.watched
        frames = [frame for frame in (eye.read(2.0) for _ in range(12)) if frame is not None]
        eye.close()
    finally:
        ended.set()
        thread.join(5.0)
        topic.close()
    assert len(frames) >= 10
    np.testing.assert_array_equal(frames[-1].image, shown)
    assert 50.0 * (frames[-1].stamp - 100.0) == pytest.approx(round(50.0 * (frames[-1].stamp - 100.0)), abs=1e-6)
