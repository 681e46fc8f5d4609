"""A line followed with an arm that others simulate: skipped with the reason where its simulator is missing."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from ideal_robot.errors import InputError
from studies.fr3_line import fr3_line
from studies.slow_clock import environment

NEEDED = ("franky_sim", "pylibfranka", "rclpy")


@pytest.mark.skipif(all(find_spec(name) for name in NEEDED), reason="all that it needs is here")
def test_what_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not installed; pip install 'ideal-robot\[franka,ros2,simulators\]'"):
        fr3_line(folder=tmp_path / "played")
    assert not (tmp_path / "played").exists()


@pytest.mark.slow
@pytest.mark.real_time
def test_a_line_is_followed_with_an_fr3(tmp_path: Path) -> None:
    for name in NEEDED:
        pytest.importorskip(name)
    fr3_line(seeds="1-1", speeds="0.25", folder=tmp_path)
    figures = json.loads((tmp_path / "1_0.25" / "figures.json").read_text(encoding="utf-8"))
    assert figures["failure"] is None
    assert figures["control_error_mm"]["mean"] < 0.15


def test_a_slow_clock_is_slow_in_processes_and_in_those_that_they_start(tmp_path: Path) -> None:
    """Each measures how long a sleep takes by both clocks: the one that it believes and the computer's own."""
    measure = ("import time; a, b = time.perf_counter(), time.clock_gettime(time.CLOCK_MONOTONIC); time.sleep(0.1); "
               "print(time.perf_counter() - a, time.clock_gettime(time.CLOCK_MONOTONIC) - b)")
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {measure!r}])"
    for code in (measure, child):
        done = subprocess.run([sys.executable, "-c", code], env=environment(tmp_path, 3.0), capture_output=True,
                              text=True, check=True)
        believed, true = map(float, done.stdout.split())
        assert 0.1 <= believed < 0.2
        assert true == pytest.approx(3.0 * believed, rel=0.02)
