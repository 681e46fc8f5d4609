"""Broken files and words, a few hundred of them: no traceback, no hang, no half-written result.

The readers and checks get most of them, whole verbs a few, and every kind of call one among the slow tests.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.online.camera_process import calibrated_camera
from scenes.scene_file import library, load_scene
from scenes.scene_files.shape import first_path
from sensing.camera.camera_model import CameraModel
from tests.fuzz import cases, mutate, originals
from tests.fuzz.cases import MAKERS, drawn
from tests.fuzz.play import play, warm_up

T = TypeVar("T")


def unless_refused(call: Callable[[], T]) -> T | None:
    """What the call returns, or None where the input is refused in one line."""
    try:
        return call()
    except InputError as error:
        if "\n" in str(error):
            pytest.fail(f"more than one line: {error}")
        return None


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sound")


@pytest.fixture(scope="module")
def all_loaded(sound: Path) -> None:
    """Cases fork from this process: what is loaded here need not be loaded by each."""
    warm_up(cases.sound(sound))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(90))
def test_a_broken_recording_is_read_and_checked_or_refused(seed: int, sound: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    raw, lost = mutate.mutated_table(originals.motion(sound), ("t", "q_1", "q_2", "tau_1"), rng, csv=seed % 2 == 0)
    path = tmp_path / ("r.csv" if seed % 2 == 0 else "r.parquet")
    path.write_bytes(raw)
    answer = unless_refused(lambda: checked([Recording.read(path)], originals.arm(sound)))
    if answer is None:
        return
    assert not lost
    ((usable,), _) = answer
    assert np.all(np.isfinite(usable.joints("q")))
    assert np.all(np.isfinite(usable.joints("tau")))
    assert np.all(np.diff(usable.t) > 0)


@pytest.mark.parametrize("seed", range(60))
def test_a_broken_model_is_read_or_refused(seed: int, sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    path.write_bytes(mutate.mutated_text(originals.model(sound), np.random.default_rng(seed)))
    unless_refused(lambda: Model.load(path))


@pytest.mark.parametrize("seed", range(60))
def test_a_broken_robot_is_read_or_refused(seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(seed)
    (tmp_path / "arm.urdf").write_bytes(mutate.mutated_text(originals.URDF, rng) if seed % 2 else originals.URDF)
    (tmp_path / "arm.toml").write_bytes(originals.DATA if seed % 2 else mutate.mutated_text(originals.DATA, rng))
    unless_refused(lambda: Robot.load(tmp_path / "arm.urdf"))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(60))
def test_a_broken_scene_is_read_or_refused(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    files = sorted(library().glob("*.toml"))
    path = tmp_path / "s.toml"
    path.write_bytes(mutate.mutated_text(files[rng.integers(len(files))].read_bytes(), rng))
    unless_refused(lambda: load_scene(path))


@pytest.mark.parametrize("seed", range(60))
def test_a_scene_with_an_extreme_key_is_read_or_refused(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    kind = ("line", "path")[seed % 2]
    path = tmp_path / "s.toml"
    path.write_bytes(mutate.with_key(originals.SCENES[kind], kind, rng))
    unless_refused(lambda: load_scene(path))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(20))
def test_a_broken_svg_file_is_read_or_refused(seed: int, tmp_path: Path) -> None:
    (tmp_path / "a.svg").write_bytes(mutate.mutated_text(originals.SVG, np.random.default_rng(seed)))
    unless_refused(lambda: first_path("a.svg", tmp_path))


@pytest.mark.parametrize("seed", range(20))
def test_a_broken_calibration_of_a_camera_is_read_or_refused(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(mutate.mutated_text(originals.calibration(), np.random.default_rng(seed)))
    unless_refused(lambda: calibrated_camera(CameraModel.default(320, 240), path))


@pytest.mark.parametrize("seed", range(10))
def test_a_verb_keeps_its_promises(seed: int, sound: Path) -> None:
    warm_up()
    case = drawn(seed, sound, ("stiffness", "precorrect_model", "rsi_arm", "robot"))
    assert play(case).broken is None, f"{case.words}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", MAKERS)
def test_every_kind_of_call_keeps_its_promises(kind: str, sound: Path, all_loaded: None) -> None:
    for seed in range(2):
        case = drawn(seed, sound, (kind,))
        assert play(case).broken is None, f"{case.words}"


@pytest.mark.filterwarnings("ignore")
def test_a_table_whose_stamps_are_no_numbers_can_be_mutated_further() -> None:
    """It ended a long run of the fuzzing after some thousand cases."""
    for seed in range(50):
        for last in (np.inf, np.nan, 1e308):
            changed = mutate._times({"t": np.array([0.0, 1.0, 2.0, 3.0, last])}, np.random.default_rng(seed))
            assert len(changed["t"]) >= 4
