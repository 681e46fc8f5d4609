"""``ideal-robot precorrect``: a path in, a corrected path out, limits checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ideal_robot.errors import InputError, LimitError
from ideal_robot.execution.path_limits import check_limits
from ideal_robot.signals.recording import Recording
from scenes.models import shipped_model
from scenes.path.precorrect import played, precorrected_path, table
from tests.ideal_robot.feedforward.plant import ROBOT, T, motion

MODEL = shipped_model("kr15")


def write(folder: Path, q: np.ndarray, t: np.ndarray | None = None, prefix: str = "q_d") -> Path:
    t = T * np.arange(len(q)) if t is None else t
    path = folder / "path.csv"
    pd.DataFrame({"t": t, **{f"{prefix}_{i + 1}": q[:, i] for i in range(q.shape[1])}}).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("method", ["ideal", "precorrected", "model_learned"])
def test_the_model_expects_the_corrected_path_to_be_followed(tmp_path, method):
    result = precorrected_path(write(tmp_path, motion(lead=2)), MODEL, method=method)
    after, before = result.expected
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))
    back = Recording.read(result.recording.write(tmp_path / "out.csv"))
    commanded = np.column_stack([back.columns[f"q_c_{i + 1}"] for i in range(ROBOT.n)])
    np.testing.assert_allclose(commanded, result.q_c, atol=1e-12)
    np.testing.assert_allclose(np.diff(back.t), T, atol=1e-9)


def test_other_sampling_is_brought_to_the_cycle(tmp_path):
    q = motion(lead=2)
    t = T * np.arange(len(q))
    fine = np.arange(0, t[-1], 0.002)
    dense = np.column_stack([np.interp(fine, t, column) for column in q.T])
    result = precorrected_path(write(tmp_path, dense, fine, prefix="q"), MODEL)
    assert result.t[1] == pytest.approx(T)
    rest = round(0.6 / T)
    np.testing.assert_allclose(result.q_d[rest : rest + len(q) - 2], q[:-2], atol=1e-3)


def test_paths_outside_the_limits_are_refused_with_joint_and_time(tmp_path):
    fast = motion(lead=2)[::8]
    with pytest.raises(InputError, match=r"joint \d: (velocity|acceleration)"):
        precorrected_path(write(tmp_path, fast), MODEL)
    far = np.tile(ROBOT.q_max + 0.1, (20, 1))
    with pytest.raises(InputError, match="position"):
        precorrected_path(write(tmp_path, far), MODEL)
    with pytest.raises(LimitError, match="velocity"):
        check_limits(fast, ROBOT, T)


def test_bad_input_names_file_and_field(tmp_path):
    with pytest.raises(InputError, match="q_d_1 to q_d_6"):
        precorrected_path(write(tmp_path, motion()[:, :3]), MODEL)
    broken = motion().copy()
    broken[10, 2] = np.nan
    with pytest.raises(InputError, match="not finite"):
        precorrected_path(write(tmp_path, broken), MODEL)
    with pytest.raises(InputError, match="rising times"):
        precorrected_path(write(tmp_path, motion(), np.zeros(len(motion()))), MODEL)
    with pytest.raises(InputError, match="expected one of"):
        precorrected_path(write(tmp_path, motion()), MODEL, method="magic")
    with pytest.raises(InputError, match="no such"):
        precorrected_path(tmp_path / "missing.csv", MODEL)


def test_a_planned_motion_is_a_path_too(tmp_path):
    """What plan-identification writes has commands only; it was refused."""
    q = motion(lead=2)
    result = precorrected_path(write(tmp_path, q, prefix="q_c"), MODEL)
    rest = round(0.6 / T)
    np.testing.assert_allclose(result.q_d[rest : rest + len(q)], q, atol=1e-9)


def test_played_on_the_simulated_arm_the_corrected_path_is_the_better_one(tmp_path):
    result = precorrected_path(write(tmp_path, motion(lead=2)), MODEL)
    after, before = played(result, ROBOT, 1)
    assert np.all(np.sqrt(np.mean(after**2, axis=0)) < 0.1 * np.sqrt(np.mean(before**2, axis=0)))
    columns, rows = table(result, (after, before))
    assert len(columns) == len(rows[0]) == 6
