"""Runs of all kinds: their path errors, what refuses to move, limits that are kept, own models, control periods.

Who follows is given what is known alone: a play goes on when everything else of its cell raises.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import scenes.force.play as force_play
import scenes.line.play as line_play
from ideal_robot.errors import InputError
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes import load_scene, models, run_scene
from scenes.closing.result import Measured, visible
from scenes.force.cell import Prepared
from scenes.line.cell import prepared
from scenes.metrics import path_errors, reduction_percent
from scenes.models import model_for, shipped_model
from scenes.online.force_known import KnownSurface
from scenes.online.line_known import KnownLine
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import chosen
from scenes.sweep import jobs
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from studies.arms import _arms_part
from studies.limits import INPUTS, LOOPS, ROWS
from tests.sources import ROOT

RADIUS, SPEED = 0.16, 0.63


def circle(t, radius=RADIUS):
    phase = SPEED / RADIUS * t
    return np.column_stack([radius * np.cos(phase), radius * np.sin(phase), np.zeros_like(t)])


T = np.arange(0.0, 1.5, 0.012)
FINE = np.arange(-0.2, 1.8, 0.002)


@pytest.mark.parametrize("delay", [0.015, 0.0007, -0.0007, -0.015])
def test_a_pure_delay_is_a_time_matched_error_only(delay):
    """Also of an arm that is early, as one is that is led by more than its delay."""
    errors = path_errors(T, circle(T), FINE, circle(FINE - delay))
    chord = 2 * RADIUS * np.sin(0.5 * SPEED / RADIUS * abs(delay))
    assert errors.time_matched.E_car == pytest.approx(chord, rel=1e-4)
    assert errors.delay == pytest.approx(delay, abs=1e-6)
    assert errors.aligned.E_max < 1e-6
    # What is left is the sagitta of the desired polyline's 12 ms chords.
    assert errors.geometric.E_max < (SPEED * 0.012) ** 2 / (8 * RADIUS) * 1.01


def test_a_radial_offset_shows_in_all_three():
    errors = path_errors(T, circle(T), FINE, circle(FINE, RADIUS + 1e-3))
    for error in (errors.time_matched, errors.aligned):
        assert error.E_car == pytest.approx(1e-3, rel=1e-3)
        assert error.E_max == pytest.approx(1e-3, rel=1e-2)
    assert errors.geometric.E_car == pytest.approx(1e-3, rel=0.05)


def test_geometric_never_exceeds_aligned_never_exceeds_time_matched():
    rng = np.random.default_rng(3)
    for _ in range(20):
        wobble = rng.normal(scale=1e-3, size=3) * np.sin(rng.uniform(2, 20) * FINE)[:, None]
        errors = path_errors(T, circle(T), FINE, circle(FINE - rng.uniform(-0.02, 0.05)) + wobble)
        assert errors.geometric.E_car <= errors.aligned.E_car * (1 + 1e-9) + 1e-9
        assert errors.aligned.E_car <= errors.time_matched.E_car * (1 + 1e-9) + 1e-12


def test_a_path_that_crosses_itself_is_not_flattered():
    phase = 2 * np.pi * T / T[-1]
    x_d = np.column_stack([np.sin(phase), np.sin(2 * phase), np.zeros_like(T)])
    # Near the crossing the arm takes a short cut along the other branch's direction.
    fine_phase = 2 * np.pi * FINE / T[-1]
    x = np.column_stack([np.sin(fine_phase), -np.sin(2 * fine_phase), np.zeros_like(FINE)])
    assert path_errors(T, x_d, FINE, x).geometric.E_car > 0.1


def test_too_little_is_refused():
    with pytest.raises(InputError, match="four instants"):
        path_errors(T[:3], circle(T[:3]), FINE, circle(FINE))


def test_reduction():
    assert reduction_percent(2.0, 0.5) == pytest.approx(75.0)
    assert reduction_percent(1.0, 2.0) == pytest.approx(-100.0)


def test_a_long_motion_is_compared_piece_by_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    # A spline's end does not reach through the overlap of two pieces: all measures are those of the whole one.
    wobble = 1e-4 * np.random.default_rng(3).standard_normal((len(FINE), 3))
    whole = path_errors(T, circle(T), FINE, circle(FINE - 0.0137) + wobble)
    monkeypatch.setattr("scenes.metrics.PIECE", 150)
    pieces = path_errors(T, circle(T), FINE, circle(FINE - 0.0137) + wobble)
    assert len(FINE) > 300
    assert pieces.delay == pytest.approx(whole.delay, abs=1e-7)
    for kind in ("time_matched", "aligned", "geometric"):
        at_once, piecewise = getattr(whole, kind), getattr(pieces, kind)
        assert piecewise.E_car == pytest.approx(at_once.E_car, rel=1e-6)
    np.testing.assert_allclose(pieces.time_matched.deviation, whole.time_matched.deviation, atol=1e-12)


# What an arm does not measure is not in its recording.

COLUMNS = {name: np.zeros(3) for name in ("q_1", "tau_1", "qa_1", "q_d_1", "x", "qx", "fx", "temp_1", "cam_t")}
HIDDEN: dict[Measured, set[str]] = {"motor": {"qa_1", "x", "qx"}, "arm": {"x", "qx"}, "tcp": set()}


@pytest.mark.parametrize("measured", ["motor", "arm", "tcp"])
def test_only_what_is_measured_is_seen(measured: Measured) -> None:
    seen = visible(Recording({"t": np.arange(3.0), **COLUMNS}), measured)
    assert set(seen.columns) == {"t", *COLUMNS} - HIDDEN[measured]


# A scene that would move for longer than it allows is refused before anything moves, whatever its kind.

@pytest.mark.parametrize(("name", "slow"), [("line", 7e-4), ("force_wave", 7e-4), ("iso9283_1", 1e-3)])
def test_a_motion_that_takes_too_long_is_refused_with_the_remedy(name: str, slow: float) -> None:
    with pytest.raises(InputError, match="max_duration"):
        run_scene(load_scene(name), speed=slow)


def test_the_scene_says_how_long_it_may_be() -> None:
    with pytest.raises(InputError, match=r"0\.5 s"):
        run_scene(load_scene("line"), max_duration=0.5)


# Whatever is asked for in whichever loop, commands keep the limits, also when there is no further one.

@pytest.mark.parametrize("loop", list(LOOPS))
@pytest.mark.parametrize("key", [pytest.param("none", marks=pytest.mark.slow), "ideal"])
def test_commands_keep_every_limit(loop: str, key: str) -> None:
    robot = Robot.load("kr6")
    law = feedforward(key, Model.load(shipped_model("kr6")), robot, n_d=ROWS)
    worst = np.max([LOOPS[loop](law, robot, kind, 150).worst for kind in INPUTS], axis=0)
    assert np.all(worst <= 1.0 + 1e-6), worst
    assert worst[1] > 0.5


# An arm's own model: identified from its own motions once, kept by content, and what ``--individual`` plays with.

ROBOT = Robot.load("kr6")


def shipped() -> Model:
    return model_for(load_scene("line"), ROBOT)


def test_options_choose_the_arm_and_its_own_model() -> None:
    scene = chosen(load_scene("line"), individual=3, n_d=7)
    assert scene.world["individual"] == 3
    assert (scene.model, scene.n_d) == ("own", 7)  # type: ignore[attr-defined]
    assert scene.played()["individual"] == 3
    assert chosen(load_scene("line").changed(model="mine.json"), individual=3).model == "mine.json"
    assert [job.individual for job in jobs(["line"], individuals=[1, 2])] == [1, 2]


def test_the_model_is_identified_once_and_kept_by_what_it_depends_on(tmp_path: Path,
                                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path))
    worlds: list[World] = []

    def identified(name: str, *, world: World, boxes: object, progress: object) -> tuple[Model, list[object]]:
        worlds.append(world)
        return shipped(), []

    monkeypatch.setattr("scenes.identification.own_model.identified_model", identified)
    world = World.default("kr6")
    first = models.prepared_model(ROBOT, world.replace(individual=2))
    again = models.prepared_model(ROBOT, world.replace(individual=2))
    other = models.prepared_model(ROBOT, world.replace(individual=3))
    assert (first.fresh, again.fresh, other.fresh) == (True, False, True)
    assert first.path == again.path != other.path
    assert [world.individual for world in worlds] == [2, 3]
    scene = load_scene("line").changed(world={"base": "bench", "individual": 3}, model="own")
    assert model_for(scene, ROBOT) is not None
    assert len(worlds) == 2
    for damaged in ("", first.path.read_text()[:1000], "{}"):
        first.path.write_text(damaged)
        assert models.prepared_model(ROBOT, world.replace(individual=2)).fresh
        assert not models.prepared_model(ROBOT, world.replace(individual=2)).fresh
    assert len(worlds) == 5


@pytest.mark.slow
def test_an_own_model_knows_its_arm_better_than_another_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path))
    world = World.default("kr6").replace(individual=2)
    own = Model.load(models.prepared_model(ROBOT, world).path)
    still = np.zeros((20, 6))
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 6)) + ROBOT.home
    truth = draw_specimen(ROBOT, world)
    data = truth.model.createData()
    gravity = np.array([pin.computeGeneralizedGravity(truth.model, data, row) for row in q]) / truth.drive_gain
    errors = [float(np.sqrt(np.mean((model.rigid_body(q, still, still) - gravity)[:, 1:3] ** 2)))
              for model in (own, shipped())]
    assert errors[0] < 0.5 * errors[1]


# After the compile step of the installation, a run has nothing left to compile.

COUNT = """
import pickle
from numba.core import event
from ideal_robot import Robot
from ideal_robot.identification.excitation import design_excitation
from scenes import load_scene, run_scene
from sensing.camera.camera_model import CameraModel
import numpy as np
with event.install_recorder("numba:compile") as recorder:
    for name in ("line", "glue", "contour"):
        run_scene(load_scene(name), **({} if name == "contour" else {"line": {"length": 0.3}}))
    for method in ("adapted", "trained"):
        run_scene(load_scene("iso9283_1"), method=method)
    design_excitation(Robot.load("kr6"), np.random.default_rng(0))
    pickle.loads(pickle.dumps(CameraModel.default())).rays(np.zeros((1, 2)))
print("compiled", sorted({e.data["dispatcher"].py_func.__qualname__ for _, e in recorder.buffer}))
"""


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "scenes.compiled"], cwd=tmp_path, env=environment, check=True)
    output = subprocess.run([sys.executable, "-c", COUNT], cwd=tmp_path, env=environment, check=True,
                            capture_output=True, text=True).stdout
    assert "compiled []" in output


@pytest.mark.parametrize(("name", "changes"), [
    pytest.param("straight", {"world": {"base": "bench"}, "calibration": {"by_moving": False},
                              "line": {"points": [(0.4, 0.0), (0.8, 0.0)]}}, marks=pytest.mark.slow),
    pytest.param("iso9283_1", {}, marks=pytest.mark.slow),
])
def test_a_shorter_cycle_is_no_worse(name: str, changes: dict) -> None:
    """4 ms beside 12 ms; a quarter more is what another draw of the encoders' steps and the noise makes of a run."""
    errors = []
    for t_ipo in (0.012, 0.004):
        scene = load_scene(name)
        world = {**changes.get("world", {}), "t_ipo": t_ipo}
        result = run_scene(scene.changed(**{**changes, "world": world}), method="ideal")
        assert result.failure is None
        measured = result.errors if hasattr(result, "errors") else result.path_errors
        errors.append(measured.aligned.E_car)
    assert errors[1] <= 1.25 * errors[0], errors


OF_THE_WORLD = frozenset({"world", "arm_world", "displacement", "wear", "light", "tip", "sensor", "surface"})
"""Tables of a scene that a real cell's file need not have."""


class Guard:
    """An object whose attributes beyond those that are named (all if None), or among those refused, raise."""

    def __init__(self, inner: Any, named: set[str] | None, refused: frozenset[str] = frozenset()) -> None:
        self._inner, self._named, self._refused = inner, named, refused

    def __getattr__(self, name: str) -> Any:
        if name in self._refused or (self._named is not None and name not in self._named):
            raise AssertionError(f"the task asked for {name}, which is of the world")
        return getattr(self._inner, name)


def attributes(known: type) -> set[str]:
    return {field.name for field in dataclasses.fields(known)} | {
        name for name in vars(known) if not name.startswith("_")}


@pytest.mark.parametrize(("name", "changes", "module", "task", "known"), [
    ("straight", {"world": "bench", "line": {"points": [(0.4, 0.0), (0.7, 0.0)]}}, line_play, "line_task", KnownLine),
    ("force_wave", {"line": {"length": 0.1}}, force_play, "force_task", KnownSurface),
])
def test_the_task_asks_for_nothing_of_the_world(name: str, changes: dict[str, Any], module: Any, task: str,
                                                known: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands are the same bit by bit, so the guard was in force and changed nothing."""
    scene = load_scene(name).changed(**changes)
    assert isinstance(scene, ForceScene | LineScene)
    guarded: list[Any] = []
    configured = getattr(module, task)

    def made(cell: Any, *arguments: Any, **options: Any) -> Any:
        assert type(cell) is known
        inner = dataclasses.replace(cell, scene=Guard(cell.scene, None, OF_THE_WORLD))
        guarded.append(inner)
        return configured(Guard(inner, attributes(known)), *arguments, **options)

    # What moving shows beforehand is shown once.
    with nullcontext(Prepared(scene)) if isinstance(scene, ForceScene) else prepared(scene) as shared:
        free = module.play(scene, "ideal", shared=shared)
        monkeypatch.setattr(module, task, made)
        played = module.play(scene, "ideal", shared=shared)
    assert len(guarded) == 1
    for column in ("q_c_1", "q_1"):
        np.testing.assert_array_equal(played.recording.columns[column], free.recording.columns[column])
    values = [getattr(guarded[0], field.name) for field in dataclasses.fields(known) if field.name != "scene"]
    assert not [value for value in values if type(value).__module__.partition(".")[0] == "sim"]


@pytest.mark.parametrize("off", [0.0, 1e-3])
def test_an_arm_that_moves_as_it_should_has_no_part_in_the_error(off: float) -> None:
    robot, t = Robot.load("kr6"), 0.002 * np.arange(301)
    q = robot.home + np.stack([0.3 * np.sin(8.0 * t), 0.2 * np.sin(5.0 * t), *np.zeros((4, len(t)))], axis=1)
    columns = {"t": t}
    for i, angle in enumerate(q.T):
        # As a recording has them: desired angles on straight lines between the cycles.
        columns |= {f"q_d_{i + 1}": np.interp(t, t[::6], angle[::6]), f"qa_{i + 1}": angle + off * (i == 1)}
    result: Any = SimpleNamespace(recording=SimpleNamespace(columns=columns), scene=SimpleNamespace(arm=robot),
                                  control_error=SimpleNamespace(t=t[75:150]))
    part = np.abs(_arms_part(result)).mean()
    assert part > 2e-5 if off else part < 1e-6
