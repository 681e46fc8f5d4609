"""``plan-diagnosis`` from files: the motion it writes can be read, and wrong input leaves nothing behind."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from scenes import cli
from trials.rivals import draw_rivals

cli._register()
OPEN = {"effects": [{"effect": "degressive", "joint": 2, "channel": "tau_2",
                     "indistinguishable_from": ["torque_ripple"]}], "undecided": []}


@pytest.fixture
def files(tmp_path):
    trial = draw_rivals(38)
    (tmp_path / "arm.urdf").write_text(trial.arm.urdf, encoding="utf-8")
    trial.first.write(tmp_path / "run.parquet")
    (tmp_path / "open.json").write_text(json.dumps(OPEN), encoding="utf-8")
    return tmp_path


def arguments(files, *more):
    return ["plan-diagnosis", str(files / "run.parquet"), "--urdf", str(files / "arm.urdf"), "--length", "12", *more]


def test_motion_is_written_and_read(files):
    answer = CliRunner().invoke(cli.app, arguments(files, "--result", str(files / "open.json"), "--z-min", "-9",
                                                   "--out", str(files / "motion.csv"), "--json",
                                                   str(files / "plan.json")))
    assert answer.exit_code == 0, answer.output
    plan = json.loads((files / "plan.json").read_text())
    motion = Recording.read(files / "motion.csv")
    assert plan["duration_s"] <= 12.0
    assert len(motion.t) == plan["samples"]
    assert plan["pairs"][0]["sigma"]["planned"] > plan["pairs"][0]["sigma"]["before"]
    assert np.all(np.isfinite(np.column_stack([motion.columns["q_d_1"], motion.columns["q_c_2"]])))


@pytest.mark.parametrize(("change", "field"), [
    ({"effects": [{"effect": "gremlin", "joint": 1}]}, "effects.0.effect"), ({"verdict": "none"}, "effects")])
def test_wrong_result_leaves_nothing(files, change, field):
    (files / "open.json").write_text(json.dumps(change), encoding="utf-8")
    answer = CliRunner().invoke(cli.app, arguments(files, "--result", str(files / "open.json"), "--out",
                                                   str(files / "motion.csv")))
    assert isinstance(answer.exception, InputError)
    assert answer.exception.field == field
    assert not (files / "motion.csv").exists()


def test_length_that_makes_no_sense_is_refused(files):
    answer = CliRunner().invoke(cli.app, [*arguments(files, "--result", str(files / "open.json")), "--length", "1"])
    assert isinstance(answer.exception, InputError)
    assert answer.exception.field == "length"
