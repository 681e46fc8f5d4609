"""After the compile step of the installation, a run has nothing left to compile."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COUNT = """
from numba.core import event
from scenes import load_scene, run_scene
with event.install_recorder("numba:compile") as recorder:
    run_scene(load_scene("line"), line={"length": 0.3})
print("compiled", sorted({e.data["dispatcher"].py_func.__qualname__ for _, e in recorder.buffer}))
"""


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "scenes.compiled"], cwd=tmp_path, env=environment, check=True)
    said = subprocess.run([sys.executable, "-c", COUNT], cwd=tmp_path, env=environment, check=True,
                          capture_output=True, text=True).stdout
    assert "compiled []" in said
