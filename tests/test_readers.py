"""What reads files of others: a broken one is read, or refused in one line that names it; nothing else comes of it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.online.camera_process import calibrated_camera
from scenes.report.replay import read_replay
from scenes.scene_file import library, load_scene
from scenes.scene_files.shape import first_path
from sensing.camera.camera_model import CameraModel
from tests import sound

NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]{2,}")
EXTREMES = (b"nan", b"-inf", b"1e308", b"1e-320", b"0", b"-1", b"99999", b"1e9", b"true", b"null", b'"x"', b"[]", b"{}",
            b"[[]]", b"9" * 400, b"1e999", b"0x10", b"", b'"/dev/zero"', b"1979-05-27", b'"' + b"x" * 3000 + b'"')
"""What numbers and words are replaced by: asks for type, size and range."""
JUNK = (b"\0", b"\xff\xfe", b"\r", b"[/red]", b"<!--", b"\x1b[31m", b"[" * 5000, b'"', b"&a;", b"\n\n", b"," * 50,
        b"a." * 3000, b"(" * 3000)


def _usable(path: Path, arm: Robot) -> None:
    answer = checked([Recording.read(path)], arm)[0][0]
    assert np.isfinite(answer.joints("q")).all()
    assert np.isfinite(answer.joints("tau")).all()
    assert np.all(np.diff(answer.t) > 0)


READERS: dict[str, Callable[[Path, Robot], Any]] = {
    "r.csv": _usable, "r.parquet": _usable, "r.mcap": _usable, "m.json": lambda path, _: Model.load(path),
    "arm.urdf": lambda path, _: Robot.load(path), "arm.toml": lambda path, _: Robot.load(path.with_suffix(".urdf")),
    "s.toml": lambda path, _: load_scene(path), "a.svg": lambda path, _: first_path(path.name, path.parent),
    "c.json": lambda path, _: calibrated_camera(CameraModel.default(320, 240), path),
    "r.replay.npz": lambda path, arm: read_replay(path, arm, Recording(dict(sound.motion(path.parent))))}
"""A file of each kind, and what reads it."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[bytes, ...]]:
    """Sound files of each kind."""
    folder = tmp_path_factory.mktemp("sound")
    parquet = Recording(dict(sound.motion(folder))).write(folder / "r.parquet").read_bytes()
    return {"r.csv": (sound.csv_bytes(sound.motion(folder)),), "r.parquet": (parquet,),
            "r.mcap": (sound.bag(folder, mcap=True),), "m.json": (sound.model(folder),), "arm.urdf": (sound.URDF,),
            "arm.toml": (sound.DATA,), "a.svg": (sound.SVG,), "c.json": (sound.calibration(),),
            "s.toml": tuple(path.read_bytes() for path in sorted(library().glob("*.toml"))),
            "r.replay.npz": (sound.replay(folder),)}


@st.composite
def broken(draw: st.DrawFn, text: bytes) -> bytes:
    """The text with one to three things broken."""
    def place(most: int) -> int:
        return draw(st.integers(0, max(most, 0)))

    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(["number", "number", "word", "line", "byte", "junk", "cut"]))
        found = list((NUMBER if how == "number" else WORD).finditer(text))
        if how in ("number", "word") and found:
            at = found[place(len(found) - 1)]
            by = (draw(st.sampled_from(EXTREMES)) if how == "number" or draw(st.booleans())
                  else found[place(len(found) - 1)].group())
            text = text[: at.start()] + by + text[at.end() :]
        elif how == "line":
            lines = text.split(b"\n")
            line = lines.pop(place(len(lines) - 1))
            if draw(st.booleans()):
                lines[place(len(lines)) : 0] = [line, line]
            text = b"\n".join(lines)
        elif how == "byte" and text:
            at = place(len(text) - 1)
            text = text[:at] + draw(st.binary(min_size=1, max_size=1)) + text[at + 1 :]
        elif how == "junk":
            at = place(len(text))
            text = text[:at] + draw(st.sampled_from(JUNK)) + text[at:]
        else:
            first, last = sorted((place(len(text)), place(len(text))))
            text = text[:first] + text[last:]
    return text


def refused(name: str, data: st.DataObject, whole: dict[str, tuple[bytes, ...]]) -> None:
    """Breaks a sound file of that name and has it read."""
    text = data.draw(broken(data.draw(st.sampled_from(whole[name]))))
    with TemporaryDirectory() as folder:
        arm = sound.arm.__wrapped__(Path(folder))
        path = Path(folder, name)
        path.write_bytes(text)
        try:
            READERS[name](path, arm)
        except InputError as error:
            if "\n" in str(error):
                pytest.fail(f"more than one line: {error}")


QUIET = {"suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
@settings(max_examples=25, **QUIET)
@given(data=st.data())
def test_a_broken_file_is_read_or_refused(name: str, whole: dict[str, tuple[bytes, ...]],
                                          capfd: pytest.CaptureFixture[str], data: st.DataObject) -> None:
    refused(name, data, whole)
    assert capfd.readouterr().out == ""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
@settings(max_examples=400, **QUIET)
@given(data=st.data())
def test_hundreds_of_broken_files_are_read_or_refused(name: str, whole: dict[str, tuple[bytes, ...]],
                                                       data: st.DataObject) -> None:
    refused(name, data, whole)


@pytest.mark.parametrize("words", [
    "inspect r.csv --urdf arm.urdf", "identify r.csv --urdf arm.urdf --friction viscous_coulomb --out o --json j.json",
    "diagnose r.csv --urdf arm.urdf --out o --json j.json"])
@pytest.mark.slow
def test_a_verb_with_a_broken_file_ends_with_one_line_and_leaves_nothing_half_written(
        words: str, whole: dict[str, tuple[bytes, ...]], program: Callable[..., Any], tmp_path: Path) -> None:
    @settings(max_examples=20, suppress_health_check=list(HealthCheck))
    @given(text=broken(whole["r.csv"][0]))
    def played(text: bytes) -> None:
        sound.arm.__wrapped__(tmp_path)
        (tmp_path / "r.csv").write_bytes(text)
        done = program(*words.split())
        assert done.code in (0, 1, 2)
        assert "Traceback" not in done.err
        assert done.code == 0 or len([line for line in done.lines if line.startswith("ideal-robot:")]) == 1
        assert not [path for path in tmp_path.rglob("*") if path.name.endswith(".part")]

    played()
