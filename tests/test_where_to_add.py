"""What ``docs/architecture.md`` says of adding parts: one file each, and at most a line in a registry or a second file.

A package outside, which nobody imports, holds one part of each kind; a program finds and uses all of them.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from studies.sensors.scene import gantry
from tests.sources import ROOT

LAW = '''
import numpy as np

from ideal_robot.effects.friction import LawTerm
from ideal_robot.friction import FrictionModel


class Drag(FrictionModel):
    """Grows with the square of speed."""

    key = "drag"
    coefficient_names = ("Fv", "Fc", "Fd")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})^2")
    each_brakes = True

    @classmethod
    def columns(cls, qd, direction, shape):
        return [qd, direction, qd * np.abs(qd)]


class LacksDrag(LawTerm):
    """The model lacks what grows with the square of speed."""

    name = "drag"
    law, term = Drag, 2
    coefficient_units = ("N m s²/rad²",)
'''
CAMERA = '''
from ideal_robot.effects.camera import CameraEffect, PointError


def stretched(out):
    return out * [0.0, 1.0, 0.0]


class Stretch(CameraEffect):
    """Pixels that are not square."""

    name = "camera_stretch"
    errors = (PointError("line_stretch", stretched),)
'''
METHOD = '''
from ideal_robot.feedforward.base import Feedforward


class Ahead(Feedforward):
    """Commands where the arm shall be a cycle later."""

    n_d = 2

    def __init__(self, setting):
        self.t_ipo = setting.robot.t_ipo

    def init(self, q0):
        return None

    def step(self, state, q_d, tau_ext_d=None):
        return q_d[1], state
'''
KIND = '''
from typing import Literal

from tests.sources import ROOT
from scenes.kind import SceneKind
from scenes.line.kind import LINE
from scenes.scene_files.line_scene import LineScene


class Seam(LineScene):
    """A line that is a seam."""

    kind: Literal["seam"] = "seam"


SEAM = SceneKind(Seam, LINE.methods, LINE.run, LINE.compare)
'''
SHIPPED = (ROOT / "ideal_robot" / "robots" / "kr6" / "kr6.toml").read_text(encoding="utf-8")
PARTS = {
    "a friction law": {"law.py": LAW},
    "a camera effect": {"camera.py": CAMERA},
    "a method": {"method.py": METHOD},
    "a scene kind": {"kind.py": KIND},
    "a robot": {"robot.urdf": gantry(), "robot.toml": 'name = "gantry"\n[controller]\nt_ipo = 0.008\n'},
    "a control period": {"fast.toml": re.sub(r"t_ipo = \S+", "t_ipo = 0.004", SHIPPED)},
}
"""Row of the table → its files."""
REGISTRY = """
[ideal_robot.friction]
drag = house.law:Drag
[ideal_robot.effects]
drag/tau = house.law:LacksDrag
camera_stretch/line = house.camera:Stretch
[ideal_robot.feedforward]
ahead = house.method:Ahead
[ideal_robot.scene_kinds]
seam = house.kind:SEAM
"""
PROGRAM = """
import json, sys
from pathlib import Path

import numpy as np

import ideal_robot as ir
from ideal_robot.effects import FittedEffect, names
from ideal_robot.effects.camera import CameraErrors
from ideal_robot.effects.signals import Signals
from ideal_robot.feedforward.registry import methods
from ideal_robot.friction import PerJointFriction, law_of
from ideal_robot.identification.friction_runs import fit_law
from scenes import load_scene

house = Path(sys.argv[1])
speeds = np.linspace(-2.0, 2.0, 41)
fit = fit_law(law_of("drag"), speeds, 3.0 * speeds + 2.0 * np.sign(speeds) + 0.5 * speeds * np.abs(speeds))
read = PerJointFriction.from_dict(PerJointFriction([fit.law]).to_dict())
still = np.zeros((41, 1))
signals = Signals(np.arange(41.0), still, speeds[:, None], still, still, still, still)
lacks = FittedEffect("drag", 1, "tau_1", (0.5,)).contribution(signals)
bent = CameraErrors.of((FittedEffect("camera_stretch", 0, "line", (0.1,)),)).points(np.ones((1, 3)), np.zeros(3))
arm = ir.Robot.load(house / "robot.urdf")
fast = ir.Robot.load("kr6", house / "fast.toml")
q_d = np.arange(12.0).reshape(2, 6)
scene = house / "seam.toml"
scene.write_text(Path(load_scene("straight").source).read_text().replace('kind = "line"', 'kind = "seam"'))
print(json.dumps({
    "a friction law": [read.laws[0].coefficients[:, 0].tolist(), float(np.max(np.abs(lacks))), "drag" in names()],
    "a camera effect": bent.tolist(),
    "a method": ["ahead" in methods(), ir.feedforward("ahead", None, fast).step(None, q_d)[0].tolist()],
    "a scene kind": type(load_scene(scene)).__name__,
    "a robot": [arm.n, arm.t_ipo],
    "a control period": fast.t_ipo,
}))
"""


def rows() -> dict[str, str]:
    """The table "Where do I add …": what, and what it says to write."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("## Where do I add …")[2].partition("\n## ")[0]
    return {cells[1].strip(): cells[2] for line in table.splitlines() if (cells := line.split("|"))[2:]}


WRONG = """
import pytest

from ideal_robot.effects import library
from ideal_robot.errors import InputError
from ideal_robot.feedforward.registry import methods
from ideal_robot.friction import law_of

for asked, says in ((lambda: law_of("square"), "key of Drag is 'drag'"),
                    (library, "LacksDrag is 'drag/tau'; register it by that name"),
                    (methods, "another method has that name already.*ideal = house.law:Drag"),
                    (methods, "another method has that name already"),
                    (lambda: law_of("none"), "cannot be imported .*no attribute 'Gone'.*none = house"),
                    (lambda: law_of("lost"), "cannot be imported .*No module named 'house.lost'")):
    with pytest.raises(InputError, match=says):
        asked()
"""
"""What a package may have wrong in its entry points, and what is said of it."""


def ended(folder: Path, program: str, entry_points: str) -> subprocess.CompletedProcess[str]:
    """A program beside an installed package ``house``."""
    info = folder / "house-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: house\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)
    return subprocess.run([sys.executable, "-c", program, str(folder / "house")], capture_output=True, text=True,
                          check=False, env={**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])})


def test_what_is_wrong_with_an_entry_point_is_said(tmp_path: Path) -> None:
    """A law whose file would be read as another law, and a method that is not the one that is played, among them."""
    package = tmp_path / "house"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "law.py").write_text(LAW, encoding="utf-8")
    done = ended(tmp_path, WRONG, "[ideal_robot.friction]\nsquare = house.law:Drag\nnone = house.law:Gone\n"
                 "lost = house.lost:It\n[ideal_robot.effects]\nsquare/tau = house.law:LacksDrag\n"
                 "[ideal_robot.feedforward]\nideal = house.law:Drag\n")
    assert done.returncode == 0, done.stderr


def test_one_of_each_is_one_file_and_at_most_a_line_in_a_registry(tmp_path: Path) -> None:
    package = tmp_path / "house"
    package.mkdir()
    (package / "__init__.py").write_text("")
    for what, parts in PARTS.items():
        assert what in rows()
        registered = any(f"house.{Path(name).stem}:" in REGISTRY for name in parts)
        assert len(parts) + registered <= 2
        for name, text in parts.items():
            (package / name).write_text(text, encoding="utf-8")
    done = ended(tmp_path, PROGRAM, REGISTRY)
    assert done.returncode == 0, done.stderr
    answers = json.loads(done.stdout)
    coefficients, lacks, named = answers["a friction law"]
    assert [round(value, 9) for value in coefficients] == [3.0, 2.0, 0.5]
    assert (lacks, named) == (2.0, True)
    assert answers["a camera effect"] == [[1.0, 0.9, 1.0]]
    assert answers["a method"] == [True, [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]]
    assert answers["a scene kind"] == "Seam"
    assert answers["a robot"] == [6, 0.008]
    assert answers["a control period"] == 0.004
