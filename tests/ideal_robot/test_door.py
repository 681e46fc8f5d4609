"""``import ideal_robot as ir``: what stands at the door, what it costs, and what wrong input says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ideal_robot as ir
from tests.arms import ROBOT, T, motion
from tests.sources import MODELS

KR15 = ir.Model.load(MODELS / "kr15.json")


@pytest.mark.parametrize("name", ir.__all__)
def test_every_name_at_the_door_leads_somewhere(name: str) -> None:
    assert getattr(ir, name) is not None
    assert name in dir(ir)


def test_importing_the_door_imports_nothing_behind_it() -> None:
    program = ("import sys, ideal_robot as ir; ir.InputError;"
               "heavy = {'pinocchio', 'pandas', 'numba', 'scipy', 'numpy'} & set(sys.modules);"
               "raise SystemExit(str(heavy) if heavy else 0)")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""


def test_feedforward_is_made_whatever_was_imported_before() -> None:
    program = ("import ideal_robot.feedforward.base, ideal_robot as ir;"
               "law = ir.feedforward('none', None, ir.Robot.load('kr6')); print(law.n_d);"
               "import ideal_robot.feedforward.registry; print(ir.feedforward.registry.methods()[0])")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["1", "none"], done.stderr


def test_arrays_in_commands_out() -> None:
    q_d = motion(lead=2)
    path = ir.precorrect(T * np.arange(len(q_d)), q_d, KR15, ROBOT)
    after, before = path.expected_rms
    assert np.all(after < 0.1 * before)
    np.testing.assert_array_equal(path.recording.columns["q_c_3"], path.q_c[:, 2])
    assert path.to_dict()["cycles"] == len(path.t)


def frame(**changes: np.ndarray) -> pd.DataFrame:
    """Five seconds of every joint moving, with torques."""
    t = 0.012 * np.arange(400)
    columns = {"t": t}
    for i in range(6):
        columns[f"q_{i + 1}"] = ROBOT.home[i] + 0.1 * np.sin((2.0 + 0.3 * i) * t)
        columns[f"tau_{i + 1}"] = 50.0 * np.cos((2.0 + 0.3 * i) * t)
    return pd.DataFrame({**columns, **changes})


def path_error(**changes: object) -> ir.InputError:
    q_d = motion(lead=2)
    arguments = {"t": T * np.arange(len(q_d)), "q_d": q_d, "model": KR15, "robot": ROBOT, **changes}
    with pytest.raises(ir.InputError) as caught:
        ir.precorrect(**arguments)  # type: ignore[arg-type]
    return caught.value


def recording_error(**changes: np.ndarray) -> ir.InputError:
    with pytest.raises(ir.InputError) as caught:
        ir.identify(ir.Recording.from_frame(frame(**changes)), ROBOT)
    return caught.value


def test_a_frame_without_time() -> None:
    with pytest.raises(ir.InputError, match="needs the column t") as caught:
        ir.Recording.from_frame(frame().drop(columns="t"))
    assert caught.value.field == "t"


def test_a_frame_where_columns_are_expected() -> None:
    with pytest.raises(ir.InputError, match=r"Recording\.from_frame"):
        ir.Recording(frame())  # type: ignore[arg-type]
    with pytest.raises(ir.InputError, match=r"Recording\.from_frame") as caught:
        ir.identify(frame(), ROBOT)  # type: ignore[arg-type]
    assert caught.value.field == "recordings"


def test_a_column_of_words() -> None:
    with pytest.raises(ir.InputError, match="not numeric") as caught:
        ir.Recording.from_frame(frame().assign(q_1="far"))
    assert caught.value.field == "q_1"


def test_one_dimensional_positions_are_those_of_joint_one() -> None:
    recording = ir.Recording.from_arrays(np.arange(5.0), q=np.arange(5.0), tau=np.ones(5))
    assert recording.n == 1
    assert recording.joints("tau").shape == (5, 1)


def test_unequal_lengths() -> None:
    with pytest.raises(ir.InputError, match="equally long") as caught:
        ir.Recording.from_arrays(np.arange(5.0), q=np.zeros((4, 6)))
    assert caught.value.field == "q_1"


@pytest.mark.parametrize(("factor", "says"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_other_times_than_seconds(factor: float, says: str) -> None:
    error = recording_error(t=factor * frame()["t"].to_numpy())
    assert error.field == "t"
    assert says in str(error)
    assert says in str(path_error(t=factor * T * np.arange(len(motion(lead=2)))))


def test_millimetres_for_metres(tmp_path: Path) -> None:
    urdf = tmp_path / "slide.urdf"
    urdf.write_text("""<robot name="slide"><link name="base"/><link name="carriage"><inertial><mass value="10"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j1" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
        <limit lower="-0.5" upper="0.5" effort="1000" velocity="1"/></joint></robot>""")
    t = 0.002 * np.arange(1000)
    recording = ir.Recording.from_arrays(t, q=200.0 * np.sin(3.0 * t), tau=np.cos(3.0 * t))
    with pytest.raises(ir.InputError, match="millimetres") as caught:
        ir.identify(recording, ir.Robot.load(urdf))
    assert caught.value.field == "q_1"
    error = recording_error(x=1e3 * np.ones(400))
    assert "millimetres" in str(error)
    assert error.field == "x"


def test_values_that_are_not_numbers() -> None:
    q_d = motion(lead=2)
    q_d[50, 2] = np.nan
    assert path_error(q_d=q_d).field == "q_d_3"
    q = frame()["q_2"].to_numpy().copy()
    q[:40] = np.nan
    assert recording_error(q_2=q).field == "q_2"


@pytest.mark.parametrize(("name", "value", "field", "says"), [
    ("model", "kr15.json", "model", ""), ("robot", "kr15", "robot", ""), ("method", "magic", "method", ""),
    ("method", "learned-1", "method", ""), ("rest", -1.0, "rest", ""), ("t", np.arange(7.0), "t", ""),
    ("model", ir.Model.load(MODELS / "kr6.json"), "model", "identified for this arm"),
    ("q_d", np.zeros(200), "q_d", "one column a joint"), ("q_d", np.degrees(motion(lead=2)), "q_d_1", "degrees")])
def test_things_of_another_kind(name: str, value: object, field: str, says: str) -> None:
    error = path_error(**{name: value})
    assert error.field == field
    assert says in str(error)


def test_recordings_are_copies() -> None:
    arrays = {"t": np.arange(3.0), "q_1": np.zeros(3)}
    recording = ir.Recording(arrays)
    arrays["q_1"][0] = 1.0
    assert recording.columns["q_1"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        recording.columns["q_1"][0] = 2.0


def test_endings_that_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ir.InputError, match=r"\.parquet or \.csv"):
        ir.Recording({"t": np.arange(3.0)}).write(tmp_path / "x.mcap")
    assert not list(tmp_path.iterdir())


def test_identify_says_what_the_recording_cannot_tell() -> None:
    result = ir.identify(ir.Recording.from_frame(frame()), ROBOT, friction="viscous_coulomb")
    assert any(text.startswith("controller") and "q_c_1" in text for text in result.missing)
    assert any(text.startswith("stiffness") and "qa_1" in text for text in result.missing)
    assert "controller" in repr(result)


def test_results_say_in_three_lines_what_they_are() -> None:
    recording = ir.Recording.from_frame(frame())
    for thing, words in ((recording, "6 joints, 400 samples"), (KR15, "kr15")):
        assert len(repr(thing).splitlines()) <= 3
        assert len(repr(thing)) < 400
        assert words in repr(thing)


def test_the_door_shows_names_of_ours_only_and_points_to_those_of_scenes() -> None:
    import scenes

    for module in (ir, scenes):
        assert {name for name in dir(module) if not name.startswith("__")} <= set(module.__all__)
    for name in scenes.__all__:
        with pytest.raises(AttributeError, match=f"from scenes import {name}"):
            getattr(ir, name)
    with pytest.raises(AttributeError, match="did you mean 'Recording'"):
        ir.Recoding  # noqa: B018
