"""Behind short cycles the answer goes first: what a field costs is paid when nobody waits."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning import PlanningError
from planning.follower import Phase
from planning.force.force_follower import SurfaceFollower
from planning.line.measurement import Fused
from scenes.arms import shipped_model
from scenes.online.cell_check import CalibrationMotion, Piece, calibrated_by_moving
from scenes.online.contact import IN_CYCLE
from scenes.online.contact_witness import ContactWitness
from scenes.online.cycle import CycleSettings, play_cycles
from scenes.online.devices import Devices
from scenes.online.job import Job
from scenes.online.journal import Journal, Later
from scenes.online.line_known import START, KnownLine, line_follower, span_of
from scenes.online.live_arm import LiveArm
from scenes.online.live_sensors import EvaluatedField, ImaginedCamera, ImaginedForce
from scenes.online.log import TaskLog
from scenes.online.run import _job, load_cell
from scenes.online.task import Ahead, Work
from scenes.result import silent
from scenes.scene_files.drawn_line import believed_camera, reference_points
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CalibrationError, CameraModel
from sensing.camera.hand_eye import HandEye, calibrate
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine
from tests.scenes.follow.pair import Tame
from tests.sensing.camera.test_hand_eye import measuring_error

_CYCLES = round(START / 0.004) + 40
_EVERY = 5


class Wire(Tame):
    """Writes down what goes over it."""

    said: list[str]

    def send(self, q_c: Array) -> None:
        super().send(q_c)
        self.said.append("answer")

    def receive(self) -> RobotState:
        state = super().receive()
        self.said.append("packet")
        return state


class Seen(ImaginedCamera):
    """A field every few cycles, of a picture taken ``_EVERY`` cycles before it arrives; lies 0.2 mm beside the line."""

    def __init__(self, T: float, later: int) -> None:
        super().__init__()
        self._T, self._later = T, later

    def arrived(self, t: float) -> list[Field]:
        k = round(t / self._T) - self._later
        if k < 2 * _EVERY or k % _EVERY:
            return []
        field = self._field((k - _EVERY) * self._T)
        field.seen.points_tcp[:, 1] += 2e-4
        return [field]


def _played(tmp_path: Path, *, ahead: bool, later: int = 0, failing: int = -1) -> tuple[Wire, TaskLog]:
    """Forty cycles on the way; ``later``: cycles by which fields are late, ``failing``: one that cannot be planned."""
    job = _job(load_cell("line"), Devices("rsi:", cycle=0.004), None, None)
    assert isinstance(job.known, KnownLine)
    link = Wire(robot=job.robot)
    link.said, link.commanded = [], job.q_start
    arm, task, known = LiveArm(link, Journal(tmp_path, link.robot, {})), job.configured.task, job.known
    camera = Seen(job.robot.t_ipo, later)
    camera.predict = lambda t: known.follower.predict(t).seen_from(known.follower.history.pose(t))
    job.configured.connect(camera=camera)  # type: ignore[arg-type]
    update, plan = known.follower.update, known.follower.horizon

    def fused(*given: Any) -> Any:
        link.said.append("field")
        return update(*given)

    def planned(t: float, anew: bool = True) -> Array:
        link.said.append("plan")
        if round(t / job.robot.t_ipo) == failing:
            raise PlanningError("nothing to be planned")
        return plan(t, anew)

    known.follower.update = fused  # type: ignore[method-assign]
    known.follower.horizon = planned  # type: ignore[method-assign]
    if ahead:
        task.lead(arm)
    link.said.clear()
    link.taken.clear()
    arm.begin()
    end = _CYCLES * job.robot.t_ipo
    play_cycles(arm, job.robot, task, job.log, CycleSettings(job.braking, 0.05, end, end, ""), silent)
    return link, job.log


def test_between_packet_and_answer_there_is_no_field(tmp_path: Path) -> None:
    link, log = _played(tmp_path, ahead=True)
    fields = [i for i, event in enumerate(link.said) if event == "field"]
    assert len(fields) >= _CYCLES // _EVERY - 2
    assert {tuple(link.said[i - 1 : i + 2]) for i in fields} == {("answer", "field", "plan")}
    # Nor is a plan made there, not even the first.
    before = [link.said[i - 1] for i, event in enumerate(link.said) if event == "plan"]
    assert set(before) == {"answer", "field"}
    assert log.failure is not None
    assert "not done" in log.failure


class Waited(Wire):
    """A packet was waited for as long as it is told; one that was there before, less than nothing."""

    spare = 1e-3

    def receive(self) -> RobotState:
        state = super().receive()
        self.arrived = time.perf_counter() + self.spare
        return state


def _glued(tmp_path: Path, link: Waited, job: Job, camera: Seen, *, fails: bool = False) -> None:
    """Forty cycles of a glue scene; ``fails``: a field cannot be fused."""
    task, vision, contact = job.configured.task, job.configured.camera, job.contact
    link.said, link.commanded = [], job.q_start
    arm, follower = LiveArm(link, Journal(tmp_path, link.robot, {})), contact.follower
    assert vision is not None
    camera.predict = lambda t: vision.sight.predict(t).seen_from(vision.history.pose(t))
    job.configured.connect(ImaginedForce(), camera)  # type: ignore[arg-type]
    update = vision.sight.update

    def fused(*given: Any) -> Any:
        link.said.append("field")
        if fails:
            raise PlanningError("nothing to be seen")
        return update(*given)

    horizon = follower.horizon

    def planned(t: float, anew: bool = True) -> Array:
        link.said.append("plan" if anew else "goes on")
        return horizon(t, anew)

    measured, known = follower.measured, contact._fused

    def felt(t: Array, contact: Array) -> Any:
        link.said.append("felt")
        return measured(t, contact)

    def pressed(t: Array, told: Any) -> None:
        link.said.append("force")
        known(t, told)

    vision.sight.update = fused  # type: ignore[method-assign]
    follower.horizon = planned  # type: ignore[method-assign]
    follower.measured, contact._fused = felt, pressed  # type: ignore[method-assign]
    contact.witnessed(SimpleNamespace(owes=False, fused=lambda *_: None, look=lambda: None, check=lambda t: None,
                                      ended=lambda *_: None), short=arm.t_ipo < contact.in_one)
    task.lead(arm)
    link.said.clear()
    arm.begin()
    end = 40 * job.robot.t_ipo
    play_cycles(arm, job.robot, task, job.log, CycleSettings(job.braking, 0.05, end, end, ""), silent)


def glue(cycle: float | None = 0.004) -> Job:
    job = _job(load_cell("glue"), Devices("rsi:", cycle=cycle), None, None)
    return job


@pytest.mark.parametrize("fails", [False, True])
def test_fields_of_a_surface_are_fused_between_packets_too(tmp_path: Path, fails: bool) -> None:
    """What goes wrong there stops the arm on its path, as it does elsewhere."""
    job = glue()
    link = Waited(robot=job.robot)
    _glued(tmp_path, link, job, Seen(job.robot.t_ipo, 0), fails=fails)
    before = [link.said[i - 1] for i, event in enumerate(link.said) if event == "field"]
    assert set(before) == {"answer"}
    assert len(before) >= 6 or fails
    # Nor is anything planned there, and what was fused has no plan beside it.
    planned_behind = [link.said[i - 1] for i, event in enumerate(link.said) if event == "plan"]
    assert set(planned_behind) <= {"answer", "felt"}
    assert fails or {link.said[i + 1] for i, event in enumerate(link.said) if event == "field"} == {"goes on"}
    assert str(job.log.failure).startswith("nothing to be seen" if fails else "not done")
    assert link.said.count("packet") > 12


@pytest.mark.parametrize("takes", [0.001, 0.003, 0.02])
def test_what_takes_long_on_this_computer_waits_for_no_answer(tmp_path: Path, takes: float) -> None:
    """At 12 ms 5 to 7 ms of forces and planning before an answer came too late in every third cycle."""
    job = glue(None)
    job.contact.takes(takes)
    link = Waited(robot=job.robot)
    _glued(tmp_path, link, job, Seen(job.robot.t_ipo, 0))
    before = {event for cycle in " ".join(link.said).split("packet")[2:] for event in cycle.split("answer")[0].split()}
    behind = [cycle.split("answer")[-1].split() for cycle in " ".join(link.said).split("packet")[2:-1]]
    assert ("felt" in before) == ("plan" in before) == (takes == 0.001)
    # Where there is time, all of a cycle is done behind one command.
    assert any({"force", "plan"} <= set(cycle) for cycle in behind) == (takes == 0.003)
    assert max(sum(event in ("felt", "force", "field") for event in cycle) for cycle in behind) == (
        1 if takes != 0.003 else 3)


def test_a_rehearsal_learns_how_long_this_computer_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    horizon = SurfaceFollower.horizon

    def slow(follower: SurfaceFollower, t: float, anew: bool = True) -> Array:
        time.sleep(0.006)
        return horizon(follower, t, anew)

    monkeypatch.setattr(SurfaceFollower, "horizon", slow)
    job = glue(None)
    job.rehearse()
    assert job.contact.at_once > job.robot.t_ipo
    assert 0.006 < job.contact.in_one * IN_CYCLE < 0.1


def test_one_thing_is_done_between_two_packets_and_what_is_felt_is_fused_behind_the_next(tmp_path: Path) -> None:
    """With all at once every third answer was later than the next packet on a computer that does the rest as well."""
    job = glue()
    link = Waited(robot=job.robot)
    _glued(tmp_path, link, job, Seen(job.robot.t_ipo, 0))
    between = [[event for event in cycle.split() if event in ("felt", "force", "field")]
               for cycle in " ".join(link.said).split("packet")]
    assert max(map(len, between)) == 1
    felt = [i for i, events in enumerate(between) if events == ["felt"]]
    assert len(felt) > 8
    assert all(between[i + 1] == ["force"] for i in felt if i + 1 < len(between))


def test_no_fusion_is_left_out_where_the_sensor_is_looked_at_later() -> None:
    """At 4 ms there is time for that behind two of five fusions, and none where a camera is quick: fields wait then.

    Of what is felt while the force settles it is known as well, by the time the tip travels.
    """
    job, fits, swings, looks = glue(), list[float](), list[Array](), list[int]()
    contact, follower = job.contact, job.contact.follower
    signs = SimpleNamespace(fits=lambda innovation, values: fits.append(innovation), swings=swings.append,
                            answers=lambda stiffness, frequency: looks.append(len(swings)))
    contact.witnessed(ContactWitness(job.scene, follower, SimpleNamespace(signs=signs),  # type: ignore[arg-type]
                                     contact.elasticity, job.model, job._begin), short=True)
    for k in range(-1, 5):
        follower.phase = Phase.TRAVEL if k >= 0 else Phase.SETTLE  # type: ignore[misc]
        follower.felt = np.full((3, 4), float(k))  # type: ignore[union-attr]
        contact._fused(np.array([0.01 * k]), Fused(np.ones(3, dtype=bool), np.zeros(3), 3.0 * k, 3, ""))
    assert job.configured.camera is not None
    job.configured.camera.fuse = lambda t: Work.FUSED  # type: ignore[method-assign]
    follower.horizon = lambda t, anew: np.zeros((3, 6))  # type: ignore[method-assign]
    ahead = Ahead(job.configured.task, SimpleNamespace(t_ipo=0.004, behind=False))  # type: ignore[arg-type]
    ahead.prepare(0.0)
    ahead.prepare(0.0)
    assert fits == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [felt[:, 0].tolist() for felt in swings] == [[-1.0] * 3, np.repeat(np.arange(5.0), 3).tolist()]
    assert looks == [2]


class Bursts(Seen):
    """As ``Seen``, each field three times."""

    times = 0

    def arrived(self, t: float) -> list[Field]:
        fields = super().arrived(t)
        self.times += bool(fields)
        return fields * 3


@pytest.mark.parametrize(("spare", "waits"), [(1e-3, False), (-1e-2, True)])
@pytest.mark.parametrize("cycle", [None, 0.004])
def test_no_answer_waits_for_a_field_and_a_field_waits_where_answers_are_late(
        tmp_path: Path, cycle: float | None, spare: float, waits: bool) -> None:
    """On a slow computer three fields at once took 40 ms before an answer, until the controller ended the session."""
    job = glue(cycle)
    link = Waited(robot=job.robot)
    link.spare = spare
    camera = Bursts(job.robot.t_ipo, 0)
    _glued(tmp_path, link, job, camera)
    before = [link.said[i - 1] for i, event in enumerate(link.said) if event == "field"]
    assert (before == []) == waits
    assert before == camera.times * ["answer"]
    assert link.said.count("answer") >= 40


def test_with_the_same_fields_the_plan_made_ahead_is_the_plan_made_at_once(tmp_path: Path) -> None:
    ahead, _ = _played(tmp_path / "ahead", ahead=True)
    at_once, _ = _played(tmp_path / "at_once", ahead=False)
    np.testing.assert_array_equal(ahead.taken[:_CYCLES], at_once.taken[:_CYCLES])
    unseen, _ = _played(tmp_path / "unseen", ahead=True, later=_CYCLES)
    assert np.max(np.abs(np.subtract(ahead.taken[:_CYCLES], unseen.taken[:_CYCLES]))) > 1e-5


def test_a_plan_that_cannot_be_made_ahead_stops_the_arm_in_its_own_cycle(tmp_path: Path) -> None:
    failing = _CYCLES - 20
    _, log = _played(tmp_path, ahead=True, failing=failing)
    assert log.failure == "nothing to be planned"
    assert len(log.t) > failing
    np.testing.assert_array_equal(log.q_d[-1], log.q_d[-2])


def test_progress_is_shown_when_nobody_waits() -> None:
    shown: list[float] = []
    later = Later(lambda done, text: shown.append(done))
    later(0.1, "")
    later(0.2, "")
    assert not shown
    later.catch_up()
    later.catch_up()
    assert shown == [0.2]


def test_a_feedforward_that_adapts_knows_what_the_arm_has_shown_before_the_line(tmp_path: Path) -> None:
    """Else it begins each run on devices anew, and leaves half as much again as in simulation."""
    job, other = (_job(load_cell("line"), Devices("rsi:"), None, None) for _ in range(2))
    assert job.method.key == "adapted"
    T, q = job.robot.t_ipo, job.q_start
    rng = np.random.default_rng(0)
    shown = [RobotState(k * T, q + 0.3 * np.sin(0.05 * k), 40.0 + rng.standard_normal(6)) for k in range(200)]
    arm = LiveArm(Tame(job.robot), Journal(tmp_path, job.robot, {}))
    arm.link.commanded = arm.q_d = q
    job.moved = shown[:120]
    arm.reported.extend(shown[120:])
    camera = SimpleNamespace(use=lambda *_: None, fused=lambda _: None)
    job.ready(arm, camera, None)  # type: ignore[arg-type]
    other.configured.task.learn(shown)
    learned, expected, cold = (one.configured.task._state.factors.values for one in (job, other, Job(
        job.scene, job.robot, job.model, job.method, 0, 0.3, job.calibration)))
    np.testing.assert_array_equal(learned, expected)
    assert np.abs(learned - cold).max() > 0.01


# Calibration over wires: the camera is found from the piece of the line, whatever is seen on the way there.

LATE, EVERY = 0.04, 2
ERROR = CalibrationError(roll=0.0035, pitch=0.0035, yaw=0.0035, height=0.001, lateral=0.0005, focal=0.003,
                         principal_point=1.0, distortion=0.01)


class SeeingCamera:
    """Sees the line exactly where it is; where ``astray`` says so, something 5 mm beside it, now left, now right."""

    def __init__(self, true: CameraModel, arm: LiveArm, astray: Callable[[float], bool]) -> None:
        self.true, self.arm, self.astray, self.detection = true, arm, astray, DetectionSettings()
        self.predict: Callable[[float], PredictedLine] | None = None
        self.hand_eye: HandEye | None = None
        self.looked = 0

    def arrived(self, t: float) -> list[EvaluatedField]:
        self.looked += 1
        if self.predict is None or t < LATE or self.looked % EVERY:
            return []
        points = self.predict(t - LATE).points.copy()
        if self.astray(t - LATE):
            points[:, 1] += 0.005 * np.sign(np.sin(20.0 * t))
        pixels = self.true.project_tool(points)
        count = len(points)
        field = LineField(t - LATE, points, pixels, np.zeros(count), np.full(count, 2e-5), np.ones(count),
                          np.ones(count, dtype=bool), True, "")
        return [EvaluatedField(t - LATE, t, (), (), field)]

    def calibrate(self, camera, observations, near, normal, prior) -> None:
        self.hand_eye = calibrate(camera, observations, near, normal, prior)


@pytest.mark.parametrize("misled", [pytest.param(False, marks=pytest.mark.slow), True])
def test_what_is_seen_on_the_way_to_the_piece_does_not_spoil_the_calibration(misled: bool, tmp_path: Path) -> None:
    scene, robot = load_cell("line"), Robot.load("kr6")
    by_hand = believed_camera(scene.camera)
    true = by_hand.perturbed(**ERROR.signed(np.random.default_rng(1)))
    reference, follower = line_follower(scene, robot, reference_points(scene), by_hand)
    arm = LiveArm(Tame(robot), Journal(tmp_path, robot, {"scene": "line"}))
    middle = 0.5 * sum(span_of(scene, reference))
    centre = reference.position(np.array([middle]))[0]
    pose = robot.fk()

    def away(_: float) -> bool:
        return misled and bool(np.linalg.norm(pose(arm.link.commanded).translation - centre) > 0.25)

    camera = SeeingCamera(true, arm, away)
    motion = CalibrationMotion.planned(Piece(reference, middle, follower.q_start), by_hand,
                                    Model.load(shipped_model(robot.name)), robot, camera.detection)
    calibrated = calibrated_by_moving(motion, arm, camera)  # type: ignore[arg-type]
    assert np.abs(measuring_error(true, by_hand)).mean() > 1e-4
    assert np.abs(measuring_error(true, calibrated)).max() < 1e-5
    assert calibrated.residual_after < 1e-5
