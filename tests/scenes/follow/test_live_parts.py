"""What stands between devices and planning: times, sound readings, the journal, the calibration's file."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.interface import RobotState
from ideal_robot.rsi.message import RsiError
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import OutputError
from scenes.online.camera_process import CalibratedCamera, CameraProcess, Header, calibrated_camera
from scenes.online.camera_worker import _Worker, work
from scenes.online.cycle import holding_share
from scenes.online.journal import Journal, left_behind, owned, rescue
from scenes.online.live_arm import FollowStoppedError, LiveArm, moves
from scenes.online.live_sensors import LiveCamera, LiveForce
from scenes.online.log import TaskLog
from scenes.online.processes import stopping_on_signals
from scenes.online.run import _recorded, load_cell
from scenes.scene_files.drawn_line import CameraTable, believed_camera
from scenes.scene_files.scene import SceneError
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings
from sensing.clock_relation import ClockRelation
from sensing.force.sensors import Reading, ReadingCounts
from tests.scenes.follow.pair import Tame
from tests.sensing.camera import synthetic
from tests.sources import ROOT


@pytest.fixture(name="link")
def _link() -> Tame:
    return Tame()


@pytest.fixture(name="arm")
def _arm(link: Tame, tmp_path: Path) -> LiveArm:
    return LiveArm(link, Journal(tmp_path, link.robot, {"scene": "x"}))


@pytest.mark.parametrize(("program", "unknown"), [
    pytest.param("import scenes.commands.devices, scenes.online.camera_process, scenes.outputs;"
                 "import scenes.scene_files.scene, scenes.online.run as s; s.load_cell('line'), s.load_cell('glue')",
                 ("sim", "pybullet"), id="the follower knows no simulator"),
    pytest.param("import scenes.commands.devices; from scenes.online.run import _job, load_cell; "
                 "from scenes.online.devices import Devices; from scenes.commands.common import closed, progress_bar; "
                 "[_job(load_cell(scene), Devices('rsi:'), None, None).rehearse() for scene in ('glue',)]",
                 ("pandas", "pyarrow", "matplotlib", "scipy.signal", "cv2"),
                 id="who leads the arm loads neither tables nor plots")])
def test_what_a_process_does_not_load(program: str, unknown: tuple[str, ...]) -> None:
    code = f"{program}; import sys; raise SystemExit(str([m for m in {unknown} if m in sys.modules] or ''))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""


def test_a_lost_cycle_is_none_of_the_paths_time(link: Tame, arm: LiveArm) -> None:
    link.lost = (20, 40)
    for _ in range(60):
        arm.cycle(link.robot.home)
    T = arm.t_ipo
    assert arm.t == pytest.approx(60 * T)
    # 62 cycles of the controller; its begin is that of this computer's clock here.
    host = [link.arrived - k * T for k in (0, 10, 30, 50)]
    np.testing.assert_allclose([arm.play_time(h) for h in host], [60 * T, 50 * T, 31 * T, 12 * T], atol=1e-6)
    assert arm.play_time(link.arrived + 0.004) == pytest.approx(60 * T + 0.004, abs=1e-6)


def test_where_the_controller_went_on_the_path_goes_on_with_it(link: Tame, arm: LiveArm) -> None:
    link.lost, link.repeats = (20, 40), True
    for k in range(60):
        state = arm.cycle(link.robot.home + 0.001 * k)
    # Two cycles are planned for what was lost and are not commanded; the path's time is the controller's.
    assert (len(link.taken), len(link.skipped)) == (58, 2)
    assert arm.t == pytest.approx(link._k * arm.t_ipo)
    assert state.t == arm.t
    T = arm.t_ipo
    host = [link.arrived - k * T for k in (0, 10, 30, 50)]
    np.testing.assert_allclose([arm.play_time(h) for h in host], [60 * T, 50 * T, 30 * T, 10 * T], atol=1e-6)


@pytest.mark.parametrize("heard", [False, True])
def test_cycles_made_good_show_what_was_heard_too_late(heard: bool, link: Tame, arm: LiveArm) -> None:
    """Between two states that are known the arm is taken to go straight on."""
    link.repeats, link.lost, receive, T = True, (20,), link.receive, arm.t_ipo
    bent = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])

    def late() -> RobotState:
        state = receive()
        link.unanswered = (RobotState(20 * T, link.robot.home + bent, np.ones(6)),) if heard and link.gone_on else ()
        return state

    link.receive = late  # type: ignore[method-assign]
    states = [arm.cycle(link.robot.home) for _ in range(24)]
    shown = np.array([state.q - link.robot.home for state in states])
    assert np.abs(shown).max() == pytest.approx(0.01 if heard else 0.0, abs=1e-3)


@pytest.mark.parametrize("repeats", [False, True])
def test_pictures_are_recorded_by_the_clock_of_the_motor_angles(repeats: bool, link: Tame, tmp_path: Path) -> None:
    """Whatever came before the run, and whatever packets are lost on the way: poses are looked up at ``cam_t``."""
    journal = Journal(tmp_path, link.robot, {})
    arm, log, instants, T = LiveArm(link, journal), TaskLog(), [], link.t_ipo
    link.repeats, link.lost = repeats, (60, 64, 68, 90)
    arm.lead(np.tile(link.robot.home, (50, 1)))
    arm.begin()
    for k in range(70):
        log.t.append(k * T)
        arm.cycle(link.robot.home)
        if k % 3 == 2 and arm.steps == 1:
            instants.append(arm.controller_time - 0.25 * T)
            log.add_points(LineField(arm.t - 0.25 * T, np.zeros((1, 3)), *np.zeros((4, 1)), np.ones(1, dtype=bool),
                                     True, ""), 1)
    job: Any = SimpleNamespace(log=log, columns=lambda t: dict(log.point_columns(t, 1)))
    recording = _recorded(journal, job)
    seen = np.isfinite(recording.columns["cam_t"])
    np.testing.assert_allclose(recording.columns["cam_t"][seen], instants, atol=1e-9)
    assert np.all((instants <= recording.t[seen]) & (recording.t[seen] < np.add(instants, 2.0 * T)))
    assert recording.meta["run_begins_at"] == pytest.approx(50 * T)


@pytest.mark.parametrize("repeats", [False, True])
def test_torques_behind_lost_cycles_belong_to_no_motion(repeats: bool, link: Tame, arm: LiveArm) -> None:
    link.lost, link.repeats = (20,), repeats
    cycles = [(bool(np.isfinite(arm.cycle(link.robot.home).tau).all()), arm.steps) for _ in range(30)]
    # Where the controller goes on, states are thought of between those before and after: none is a cycle too far.
    assert cycles == [(True, 1) if repeats or k != 19 else (False, 2) for k in range(30)]


@pytest.mark.parametrize(("every", "ends"), [(2, True), (5, False)])
def test_a_cycle_that_is_not_held_ends_following(every: int, ends: bool, link: Tame, arm: LiveArm) -> None:
    """Behind late answers forces are met too late: on a computer too slow for 4 ms a sound sensor felt 112 N."""
    link.lost, link.repeats = tuple(range(every, 400, every)), True
    for _ in range(100):
        arm.cycle(link.robot.home)
    assert (arm.stop_reason is not None) == ends
    assert not ends or "no answer in time" in str(arm.stop_reason)
    assert not ends or "--cycle" in str(arm.stop_reason)


def test_a_fault_and_a_gone_arm_end_following(link: Tame, arm: LiveArm) -> None:
    arm.check(0.0)
    link.fault = "joint 2 does not move"
    with pytest.raises(FollowStoppedError, match="joint 2 does not move"):
        arm.check(0.5)
    link.raises = RsiError("no packet from the controller")
    with pytest.raises(FollowStoppedError, match=r"no packet from the controller$"):
        arm.cycle(link.robot.home)


def test_a_controller_that_gave_up_over_late_answers_is_no_riddle(link: Tame, arm: LiveArm) -> None:
    link.lost, link.repeats = (3, 4), True
    for _ in range(8):
        arm.cycle(link.robot.home)
    link.raises = RsiError("no packet from the controller")
    with pytest.raises(FollowStoppedError, match=r"no packet.*; in 1 of the last 7 cycles .* no answer in time"):
        arm.cycle(link.robot.home)


def test_the_arm_is_held_while_something_is_worked_out(link: Tame, arm: LiveArm) -> None:
    """Postures to turn a tool in took 30 ms, in which the controller got no answer: a cell at 4 ms ended it."""
    arm.lead(moves(link.robot, [link.commanded.copy()], 0.0))

    def work() -> str:
        while len(link.taken) < 20:
            time.sleep(1e-3)
        return "found"

    assert arm.meanwhile(work) == "found"
    np.testing.assert_array_equal(np.ptp(link.taken, axis=0), 0.0)
    with pytest.raises(SceneError, match="none"):
        arm.meanwhile(lambda: (_ for _ in ()).throw(SceneError("none")))
    link.fault = "joint 2 does not follow"
    with pytest.raises(FollowStoppedError, match="joint 2"):
        arm.meanwhile(lambda: time.sleep(0.1))


def test_an_arm_that_stands_elsewhere_is_not_moved(link: Tame, arm: LiveArm) -> None:
    with pytest.raises(SceneError, match="joint 3 stands at"):
        arm.approach(link.robot.home + np.array([0, 0, 0.1, 0, 0, 0]))
    assert not link.taken
    arm.approach(link.robot.home + 0.004)
    np.testing.assert_allclose(link.taken[-1], link.robot.home + 0.004)


def test_moves_keep_their_share_of_the_limits(link: Tame) -> None:
    robot = link.robot
    motion = moves(robot, [robot.home, robot.home + 0.5, robot.home - 0.2], 0.1)
    speed = np.diff(motion, axis=0) / robot.t_ipo
    assert (np.abs(speed).max(axis=0) <= 0.36 * robot.v_max).all()
    assert (np.abs(np.diff(speed, axis=0)).max(axis=0) / robot.t_ipo <= 0.27 * robot.a_max).all()


def test_a_held_command_costs_the_speed_of_that_moment(link: Tame) -> None:
    robot = link.robot
    q_c = robot.home + np.zeros((50, 6))
    assert holding_share(q_c, robot) == 0.0
    q_c[20:] += np.arange(30)[:, None] * np.array([0.0, 2.5 * robot.a_max[1] * robot.t_ipo**2, 0.0, 0.0, 0.0, 0.0])
    assert holding_share(q_c, robot) == pytest.approx(2.5)


def test_a_run_s_folder_is_its_process_s_alone(tmp_path: Path) -> None:
    """A second run took the live journal of the first for that of one that was killed."""
    folder = tmp_path / "out"
    program = ("from pathlib import Path; from scenes.online.journal import owned; "
               f"owner = owned(Path({str(folder)!r})); owner.__enter__(); print('mine', flush=True); input()")
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
                          ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "mine\n"
        with pytest.raises(InputError, match="another run is under way"), owned(folder):
            pass
        first.kill()
        first.wait()
    with owned(folder), pytest.raises(InputError, match="--out"), owned(folder):
        pass
    assert not folder.exists() or not list(folder.iterdir())


def test_signals_are_left_to_the_main_thread() -> None:
    """A follower in a thread of its own was refused with a bare ValueError."""
    with ThreadPoolExecutor(1) as beside:
        def work() -> str:
            with stopping_on_signals(lambda reason: None):
                return "done"

        assert beside.submit(work).result() == "done"


def test_a_journal_survives_its_program(tmp_path: Path) -> None:
    program = (f"import os, numpy as np; from pathlib import Path; from tests.scenes.follow.pair import Tame;"
               f"from scenes.online.journal import Journal; from scenes.online.live_arm import LiveArm;"
               f"link = Tame(); journal = Journal(Path({str(tmp_path)!r}), link.robot, dict(scene='x'));"
               "arm = LiveArm(link, journal);"
               "[arm.cycle(link.robot.home + 0.001 * k) for k in range(50)];"
               "os.kill(os.getpid(), 9)")
    assert subprocess.run([sys.executable, "-c", program], check=False, cwd=ROOT).returncode == -9
    saved = left_behind(tmp_path)
    assert saved is not None
    assert len(saved.t) == 50
    assert saved.meta["scene"] == "x"
    np.testing.assert_allclose(saved.joints("q_c")[:, 0] - saved.joints("q_c")[0, 0], 0.001 * np.arange(50), atol=1e-12)
    place = rescue(tmp_path)
    assert place is not None
    assert Recording.read(place).hash == saved.hash
    assert left_behind(tmp_path) is None


def test_a_broken_journal_is_taken_away_and_no_reason_to_fail(tmp_path: Path) -> None:
    (tmp_path / "journal.rows").write_bytes(b"nothing")
    (tmp_path / "journal.json").write_text("{")
    assert rescue(tmp_path) is None
    assert not list(tmp_path.iterdir())


def test_a_journal_that_cannot_be_made_a_recording_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = Tame()
    journal = Journal(tmp_path, link.robot, {})
    LiveArm(link, journal).cycle(link.robot.home)

    def full(*_: object) -> Path:
        raise OutputError("the disk is full")

    monkeypatch.setattr(Recording, "write", full)
    with pytest.raises(OutputError):
        rescue(tmp_path)
    assert left_behind(tmp_path) is not None


def test_rows_that_a_full_disk_takes_in_part_are_missing_and_spoil_no_other(tmp_path: Path,
                                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder vanishes too: what was written is read from the file that is open."""
    link = Tame()
    journal = Journal(tmp_path / "run", link.robot, {})
    arm, write, room = LiveArm(link, journal), os.pwrite, iter([None, 100, 0, None])

    def full(descriptor: int, row: Any, place: int) -> int:
        most = next(room)
        if most == 0:
            raise OSError(28, "No space left on device")
        return write(descriptor, memoryview(row).cast("B")[:most], place)

    monkeypatch.setattr(os, "pwrite", full)
    for k in range(4):
        arm.cycle(link.robot.home + 0.001 * k)
    shutil.rmtree(tmp_path / "run")
    recording = journal.recording()
    np.testing.assert_allclose(recording.joints("q_c")[:, 0] - link.robot.home[0], [0.0, 0.003], atol=1e-12)
    assert journal.unwritten == 2
    assert arm.controller_time == recording.t[-1]


def test_a_run_to_which_no_arm_came_leaves_nothing(tmp_path: Path) -> None:
    Journal(tmp_path / "deep" / "run", Tame().robot, {}).close()
    assert list(tmp_path.iterdir()) == []


class Handmade:
    """A ``WrenchSource`` that gives what it is handed."""

    def __init__(self) -> None:
        self.clock, self.counts = ClockRelation(), ReadingCounts()
        self.given: list[Reading] = []

    def read(self, timeout: float) -> list[Reading]:
        readings, self.given = self.given, []
        time.sleep(0.001)
        return readings

    def close(self) -> None:
        return


@pytest.mark.parametrize(("wrench", "count"), [
    (lambda k: np.full(6, np.nan), "impossible"), (lambda k: np.full(6, 1e9), "impossible"),
    (lambda k: np.array([1.0, 2, 3, 4, 5, 6]), "stuck"), (lambda k: np.arange(6) + 0.01 * k, ""),
])
def test_readings_that_cannot_be_count_as_missing(link: Tame, arm: LiveArm, wrench: object, count: str) -> None:
    source = Handmade()
    force = LiveForce(source, arm)
    for k in range(60):
        arm.cycle(link.robot.home)
        source.clock.add(link.arrived, link.arrived)
        source.given = [Reading(link.arrived - 0.001, wrench(k))]  # type: ignore[operator]
        while source.given:
            time.sleep(0.001)
        time.sleep(0.002)
        force.arrived(arm.t)
    force.close()
    if count:
        assert getattr(force.signs, count) > 20
        assert force.silent(arm.t) > 0.3
        assert count in force.why_silent()
    else:
        assert force.silent(arm.t) < 0.05
        assert len(force.samples) > 50


class Slow(Handmade):
    """Whose packets are read one by one."""

    def read(self, timeout: float) -> list[Reading]:
        time.sleep(0.0005)
        return [self.given.pop(0)] if self.given else []


@pytest.mark.parametrize("came", [True, False])
def test_packets_that_are_not_read_yet_are_no_silence(came: bool, link: Tame, arm: LiveArm) -> None:
    """This program stood still for 0.12 s: whether the sensor was silent is known when all was read that came."""
    source, T = Slow(), arm.t_ipo
    force = LiveForce(source, arm)
    link._begun -= 60.0
    for k in range(60):
        stood = 10 if k == 40 else 1
        link._k += stood - 1
        arm.cycle(link.robot.home)
        source.clock.add(link.arrived, link.arrived)
        if came or k != 40:
            source.given = [Reading(link.arrived - i * T - 0.001, np.arange(6) + 0.01 * k + i)
                            for i in reversed(range(stood))]
        if k != 40:
            while source.given:
                time.sleep(0.001)
            time.sleep(0.002)
        else:
            arm._k = link._k * 1.0
            arm._played[-1] = arm.t
            force.take(arm.t)
            assert (force.trouble(arm.t) is None) == came
            break
        force.take(arm.t)
    force.close()


class Eye:
    """A ``CameraProcess`` without a process."""

    def __init__(self) -> None:
        self.ended: str | None = None
        self.messages: list[object] = []
        self.asked: list[float] = []

    def poll(self) -> list[object]:
        messages, self.messages = self.messages, []
        return messages

    def ask(self, number: int, t: float, prediction: object, detection: object) -> None:
        self.asked.append(t)


@pytest.mark.parametrize("behind", [0, 2, 7])
def test_what_is_sensed_while_this_computer_is_behind_waits_for_its_cycle(behind: int, link: Tame, arm: LiveArm
                                                                          ) -> None:
    """Nobody knows where the arm was in cycles that were not read yet; what was felt then is not thrown away."""
    source, eye, T = Handmade(), Eye(), arm.t_ipo
    camera = LiveCamera(eye, arm, DetectionSettings())  # type: ignore[arg-type]
    camera.predict = lambda t: None  # type: ignore[assignment, return-value]
    force, given, taken = LiveForce(source, arm), 0, list[float]()
    # It is later by this computer's clock than all that is read.
    link._begun -= 60.0
    for k in range(60):
        arm.cycle(link.robot.home)
        source.clock.add(link.arrived, link.arrived)
        late = behind if 20 <= k < 40 else 0
        host = link.arrived + late * T - 0.001
        if late or k != 40:
            source.given = [Reading(host, np.arange(6) + 0.01 * k)]
            eye.messages = [Header(k, host, link.arrived, host)]
            given += 1
        while source.given:
            time.sleep(0.001)
        time.sleep(0.002)
        samples = force.arrived(arm.t)
        assert all(sample.t <= arm.t + 0.5 * T for sample in samples)
        taken += [sample.t for sample in samples]
        assert all(t <= arm.t + 0.5 * T for t in eye.asked)
    force.close()
    assert force.untimely == 0
    assert len(taken) == given


def test_pictures_with_impossible_stamps_are_counted_and_a_gone_camera_stops(link: Tame, arm: LiveArm) -> None:
    eye = Eye()
    camera = LiveCamera(eye, arm, DetectionSettings())  # type: ignore[arg-type]
    camera.predict = lambda t: None  # type: ignore[assignment, return-value]
    # Every packet is waited for, however busy the computer is.
    link._begun += 60.0
    for k in range(50):
        arm.cycle(link.robot.home)
        off = {20: 0.1, 30: -0.6}.get(k, 0.0)
        eye.messages = [Header(k, link.arrived - 0.04 + off, link.arrived, link.arrived - 0.04 + off)]
    assert (camera.early, camera.late) == (1, 1 + 3)
    np.testing.assert_allclose(np.diff(eye.asked)[:10], arm.t_ipo, atol=1e-6)
    eye.ended = "the camera's process has ended"
    arm.cycle(link.robot.home)
    with pytest.raises(FollowStoppedError, match="camera's process"):
        arm.check(1.0)


def test_a_clock_that_becomes_known_better_is_no_stamps_that_wander(link: Tame, arm: LiveArm) -> None:
    """Where stamps are related by arrivals alone, instants by this computer's clock shift by milliseconds at first."""
    eye, rng = Eye(), np.random.default_rng(1)
    camera = LiveCamera(eye, arm, DetectionSettings())  # type: ignore[arg-type]
    camera.predict = lambda t: None  # type: ignore[assignment, return-value]
    link._begun += 60.0
    for k in range(60):
        arm.cycle(link.robot.home)
        taken = link.arrived - 0.04 + 0.005 * rng.standard_normal()
        eye.messages = [Header(k, taken, link.arrived + 0.002 * rng.standard_normal(), 12.0 + arm.t_ipo * k)]
    assert len(eye.asked) > 50
    assert arm.stop_reason is None


@pytest.mark.parametrize("film", ["film.avi", pytest.param("none.avi", marks=pytest.mark.slow)])
def test_a_camera_that_is_ready_when_nobody_waits_any_more_ends_quietly(
    film: str, tmp_path: Path, capfd: pytest.CaptureFixture[str],
) -> None:
    camera = believed_camera(CameraTable())
    synthetic.film(tmp_path / "film.avi", [np.zeros((camera.height, camera.width), np.uint8)] * 3)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(f"file:{tmp_path / film}", 0.0, camera, "edge_pairs", theirs))
    process.start()
    theirs.close()
    ours.close()
    process.join(120.0)
    assert process.exitcode == 0
    assert "Traceback" not in capfd.readouterr().err


def test_a_camera_that_cannot_be_opened_is_named_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def here(args: tuple[Any, ...], **_: object) -> SimpleNamespace:
        return SimpleNamespace(start=lambda: work(*args[1:]), join=lambda _: None, is_alive=lambda: False)

    monkeypatch.setattr(_Worker, "rehearse", lambda self: None)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(multiprocessing, "get_context",
                        lambda _: SimpleNamespace(Pipe=multiprocessing.Pipe, Process=here))
    with pytest.raises(InputError) as refusal:
        CameraProcess("stream:host:port", 0.0, believed_camera(CameraTable()), "edge_pairs")
    assert str(refusal.value) == "--camera: expected an address such as stream://192.168.1.30:50000 (got 'host:port')"


def test_a_calibration_is_kept_and_wrong_files_are_refused(tmp_path: Path) -> None:
    by_hand, file = believed_camera(CameraTable()), tmp_path / "camera.json"
    assert calibrated_camera(by_hand, None).wanted is False
    assert calibrated_camera(by_hand, file).wanted is True
    calibrated = CalibratedCamera(by_hand.perturbed(roll=0.01, height=0.002), file, time_offset=0.002)
    file.write_text(json.dumps(calibrated.json()))
    read = calibrated_camera(by_hand, file)
    assert (read.wanted, read.time_offset) == (False, 0.002)
    np.testing.assert_allclose(read.camera.T_tool_camera.homogeneous, calibrated.camera.T_tool_camera.homogeneous)
    for text in ("", "[]", json.dumps({**calibrated.json(), "rotation": [[1, 0], [0, 1]]}),
                 json.dumps({**calibrated.json(), "time_offset_s": 9}), json.dumps({**calibrated.json(), "width": 64}),
                 json.dumps({**calibrated.json(), "residual_mm": [0.1]})):
        file.write_text(text)
        with pytest.raises(InputError):
            calibrated_camera(by_hand, file)


def test_a_real_cells_scene_holds_no_world(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('kind = "line"\ntitle = "A real cell"\nrobot = "kr6"\nspeed = 0.2\n[surface]\n'
                    'origin = [0.98, -0.6, 0.35]\nheading_deg = 90.0\n[line]\nformula = "0*x"\nlength = 0.5\n'
                    '[camera]\nwidth = 640\nheight = 480\n')
    assert load_cell(file).name == "cell"
    file.write_text('kind = "path"\n')
    with pytest.raises(InputError, match="line, force"):
        load_cell(file)
