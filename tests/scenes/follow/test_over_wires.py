"""Follower and simulated cell as processes of their own: they do the job, and each may be killed, frozen, restarted.

Everything here is in real time, takes minutes, and fails on a computer that has something else to do.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from os import kill
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from scenes.online.devices import Devices
from scenes.online.run import follow, load_cell
from scenes.serve.carried import CameraDevice, ServedCamera
from sensing.camera.camera_model import CameraModel, default_mount
from sensing.camera.cameras import StreamCamera
from sim.camera.camera import CameraSettings
from sim.camera.live_camera import NOTHING, LiveCamera
from sim.camera.surface import DrawnLine
from sim.devices.stream_server import DeviceClock, Unkindness
from tests.scenes.follow.loaded_late import LATE
from tests.scenes.follow.pair import Cell, children, rows, served, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.real_time]
MIDDLE = 150
"""Cycles after which the arm is on the line."""


def finished(follower: subprocess.Popen[str], seconds: float = 120.0) -> tuple[int, str]:
    _, output = follower.communicate(timeout=seconds)
    return follower.returncode, output


def resting_within_limits(cell: Cell, session: int) -> None:
    truth = cell.truth(session)
    assert truth["at_rest"]
    assert truth["largest_acceleration_share"] <= 1.0


def whole(folder: Path, least: int) -> Recording:
    recording = Recording.read(folder / "out" / "recording.parquet")
    assert len(recording.t) >= least
    assert np.isfinite(recording.joints("q")).all()
    assert np.isfinite(recording.joints("q_c")).all()
    return recording


@pytest.mark.parametrize(("scene", "figure", "most"), [
    ("line", lambda t: t["control_error_mm"]["mean"], 3.0), ("force_wave", lambda t: t["force_N"]["rms_error"], 3.0),
    ("contour", lambda t: t["force_N"]["rms_error"], 3.0), ("glue", lambda t: t["control_error_mm"]["mean"], 0.5)])
def test_the_job_is_done_over_wires(scene: str, figure: Callable[[dict], float], most: float, tmp_path: Path) -> None:
    """The camera of ``line`` is as mounted by hand, with its errors of millimetres; that of ``glue`` calibrated."""
    options = ("--calibration", str(tmp_path / "camera.json")) if scene == "glue" else ()
    with served(scene, tmp_path) as cell:
        code, output = finished(cell.follow(scene, *options, program="tests.scenes.follow.loaded_late"), 300.0)
        assert code == 0, output
        # Code that is compiled while an arm waits takes a second in a new installation, and ends the run.
        assert output.rsplit(LATE, 1)[1].split() == []
        assert figure(cell.truth(1)) < most
        resting_within_limits(cell, 1)
        whole(tmp_path, 250)
        for device in cell.figures()["devices"].values():
            assert abs(device["clock"]["drift_ppm"]) < 200.0


def test_whatever_happens_to_the_follower_the_arm_rests_and_the_next_start_works(tmp_path: Path) -> None:
    def act(number: int) -> Callable[[subprocess.Popen[str]], None]:
        return lambda follower: follower.send_signal(number)

    def camera(number: int) -> Callable[[subprocess.Popen[str]], None]:
        return lambda follower: kill(next(child for child in children(follower.pid)
                                          if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()), number)

    faults = [(act(signal.SIGTERM), 1, "stopped by the system"), (act(signal.SIGINT), 1, "stopped by the user"),
              (camera(signal.SIGKILL), 1, "camera's process has ended"), (camera(signal.SIGSTOP), 1, "line"),
              (act(signal.SIGSTOP), 1, ""), (act(signal.SIGKILL), -9, "")]
    with served("line", tmp_path) as cell:
        for session, (happen, code, reason) in enumerate(faults, 1):
            follower = cell.follow("line")
            wait_until(lambda: rows(tmp_path) >= MIDDLE, 240.0)
            happen(follower)
            if session == len(faults) - 1:
                resting_within_limits(cell, session)
                follower.send_signal(signal.SIGCONT)
            ended, output = finished(follower)
            assert ended == code, output
            assert reason in output
            resting_within_limits(cell, session)
            if code == 1:
                assert cell.figures()["failure"]
                assert reason in (tmp_path / "out" / "report.html").read_text().replace("&#39;", "'")
                whole(tmp_path, MIDDLE)
        follower = cell.follow("line")
        ended, output = finished(follower, 300.0)
        assert ended == 0, output
    # The run that was killed had left a journal, of which the next one made a recording.
    assert len(Recording.read(tmp_path / "out" / "recording_killed.parquet").t) >= MIDDLE


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_cell_that_is_gone_ends_the_run_and_its_recording_is_whole(number: int, tmp_path: Path) -> None:
    with served("line", tmp_path) as cell:
        follower = cell.follow("line")
        wait_until(lambda: rows(tmp_path) >= MIDDLE, 240.0)
        cell.process.send_signal(number)
        code, output = finished(follower)
        assert code == 1
        assert "no packet from the controller within 1 s" in output
        whole(tmp_path, MIDDLE)
    with served("line", tmp_path) as cell:
        code, output = finished(cell.follow("line"), 300.0)
        assert code == 0, output


def test_the_line_is_followed_by_an_arm_behind_rtde(tmp_path: Path) -> None:
    with served("line", tmp_path, protocol="rtde") as cell:
        code, output = finished(cell.follow("line"), 300.0)
        assert code == 0, output
        assert cell.truth(1)["control_error_mm"]["mean"] < 3.0
        resting_within_limits(cell, 1)
        assert cell.figures()["devices"]["arm"]["link"]["cycles"] > 250


def test_lost_late_and_doubled_packets_are_survived_within_the_limits(tmp_path: Path) -> None:
    with served("line", tmp_path, "--loss", "0.02", "--late", "0.003", "--late-by", "30", "--doubled", "0.02",
                "--drift", "50") as cell:
        code, output = finished(cell.follow("line"), 300.0)
        assert code == 0, output
        resting_within_limits(cell, 1)
        assert cell.truth(1)["control_error_mm"]["mean"] < 3.0
        link = cell.figures()["devices"]["arm"]["link"]
        assert link["lost"] > 0
        assert link["repeated"] > 0


# What a served cell does while nobody looks, and cycles that no controller has.

@pytest.mark.parametrize("cycle", [0.0, -0.004, 0.0045, 1.0, float("nan")])
def test_a_cycle_that_no_controller_has_is_refused(cycle: float) -> None:
    with pytest.raises(InputError, match="whole milliseconds"):
        follow(load_cell("line"), Devices("rsi:", camera="stream://127.0.0.1:1", cycle=cycle))


def camera_device() -> CameraDevice:
    points = np.column_stack([np.linspace(0.0, 0.3, 200), np.zeros((200, 2))])
    eye = LiveCamera(CameraModel(120, 80, np.array([[300.0, 0.0, 60.0], [0.0, 300.0, 40.0], [0.0, 0.0, 1.0]]),
                                 np.zeros(5), default_mount()), DrawnLine(points, pin.SE3.Identity()),
                     CameraSettings(), np.random.default_rng(0))
    return CameraDevice(eye, 100.0, ("127.0.0.1", 0), DeviceClock(100.0, 0.0), Unkindness(), np.random.default_rng(1))


def test_pictures_come_from_a_process_of_their_own_which_may_end() -> None:
    """Without a camera's process the cell goes on, and nobody waits for it."""
    tool = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.0, 0.0]))
    camera = ServedCamera(camera_device(), CameraSettings(), lambda t: tool, lambda t: NOTHING,
                          np.random.default_rng(1))
    stream = StreamCamera(*camera.address)
    frames, begun = [], time.perf_counter()
    while len(frames) < 5 and time.perf_counter() < begun + 20.0:
        camera.carry(0.0, 0.01, time.perf_counter())
        if (frame := stream.read(0.01)) is not None:
            frames.append(frame)
    assert len(frames) == 5
    assert np.ptp(frames[-1].image) > 50.0
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))
    camera._process.kill()
    camera._process.join()
    for _ in range(20):
        camera.carry(0.0, 0.01, time.perf_counter())
    stream.close()
    camera.close()


def test_a_port_that_is_taken_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        device = replace(camera_device(), address=listener.getsockname())
        with pytest.raises(OSError, match="in use"):
            ServedCamera(device, CameraSettings(), lambda t: pin.SE3.Identity(), lambda t: NOTHING,
                         np.random.default_rng(1))
