"""An arm's own model: identified from its own motions once, kept by content, and what ``--individual`` plays with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes import load_scene, prepared_model
from scenes.models import model_for
from scenes.options import chosen
from scenes.sweep import jobs
from sim.arm.specimen import draw_specimen
from sim.arm.world import World

ROBOT = Robot.load("kr6")


def shipped() -> Model:
    return model_for(load_scene("line"), ROBOT)


def test_options_choose_the_arm_and_its_own_model() -> None:
    scene = chosen(load_scene("line"), individual=3, n_d=7)
    assert scene.world["individual"] == 3
    assert (scene.model, scene.n_d) == ("own", 7)  # type: ignore[attr-defined]
    assert scene.played()["individual"] == 3
    named = chosen(load_scene("line").changed(model="mine.json"), individual=3)
    assert named.model == "mine.json"
    assert [job.individual for job in jobs(["line"], individuals=[1, 2])] == [1, 2]


def test_the_model_is_identified_once_and_kept_by_what_it_depends_on(tmp_path: Path,
                                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path))
    worlds: list[World] = []

    def identified(name: str, *, world: World, progress: object) -> tuple[Model, list[object]]:
        worlds.append(world)
        return shipped(), []

    monkeypatch.setattr(prepared_model, "identified_model", identified)
    world = World.default("kr6")
    first = prepared_model.prepared_model(ROBOT, world.replace(individual=2))
    again = prepared_model.prepared_model(ROBOT, world.replace(individual=2))
    other = prepared_model.prepared_model(ROBOT, world.replace(individual=3))
    assert (first.fresh, again.fresh, other.fresh) == (True, False, True)
    assert first.path == again.path != other.path
    assert [one.individual for one in worlds] == [2, 3]
    scene = load_scene("line").changed(world={"base": "bench", "individual": 3}, model="own")
    assert model_for(scene, ROBOT) is not None
    assert len(worlds) == 2


@pytest.mark.slow
def test_an_own_model_knows_its_arm_better_than_another_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path))
    world = World.default("kr6").replace(individual=2)
    own = Model.load(prepared_model.prepared_model(ROBOT, world).path)
    still = np.zeros((20, 6))
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 6)) + ROBOT.home
    truth = draw_specimen(ROBOT, world)
    data = truth.model.createData()
    gravity = np.array([pin.computeGeneralizedGravity(truth.model, data, row) for row in q]) / truth.drive_gain
    errors = [float(np.sqrt(np.mean((model.rigid_body(q, still, still) - gravity)[:, 1:3] ** 2)))
              for model in (own, shipped())]
    assert errors[0] < 0.5 * errors[1]
