"""Notebooks: outputs are not committed, each has an exercise, and each runs from the first cell to the last."""

from __future__ import annotations

import tempfile
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
LONGEST_CELL = 600
"""Time after which a cell counts as hanging [s]."""
DATA = ROOT.parent / "shared" / "data"


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_committed_without_outputs_and_has_an_exercise_and_a_slider(path: Path) -> None:
    book = read(path)
    nbformat.validate(book)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book.cells)
    assert any("## Exercise" in cell.source for cell in book.cells)
    assert any("ipywidgets.interactive(" in cell.source for cell in book.cells if cell.cell_type == "code")


def run(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = path.read_text(encoding="utf-8")
    if "IDEAL_ROBOT_DATA" in text:
        if not DATA.is_dir():
            pytest.skip("needs the public data sets beside the repository")
        monkeypatch.setenv("IDEAL_ROBOT_DATA", str(DATA))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("MPLBACKEND", "agg")
    # Sockets in a folder of its own: the ports that a kernel is given may be taken by another one until it opens them,
    # and who then waits for an answer waits until the end of his patience.
    with tempfile.TemporaryDirectory(prefix="ir") as folder:
        client = NotebookClient(read(path), timeout=LONGEST_CELL, startup_timeout=120,
                                resources={"metadata": {"path": str(ROOT)}})
        kernel = client.create_kernel_manager()
        kernel.transport, kernel.ip, kernel.connection_file = "ipc", f"{folder}/ipc", f"{folder}/kernel.json"
        client.execute()


@pytest.mark.parametrize("path", [one for one in NOTEBOOKS if read(one).metadata.get("quick")],
                         ids=lambda path: path.stem)
def test_a_quick_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("path", [one for one in NOTEBOOKS if not read(one).metadata.get("quick")],
                         ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(path, monkeypatch)
