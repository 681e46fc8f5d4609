"""Plays the notebooks of the documentation and keeps them with their outputs, for the pages of the site.

    python docs/execute_notebooks.py            # those that changed since they were played
    python docs/execute_notebooks.py friction   # this one, whether it changed or not

``out/notebooks`` holds what was played; ``docs/site_pages.py`` makes pages of it. Outputs are not committed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from hashlib import sha256
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PLAYED = ROOT / "out" / "notebooks"
LONGEST_CELL = 900
"""Time after which a cell counts as hanging [s]."""


def played(path: Path, added: str = "", longest: float = LONGEST_CELL) -> nbformat.NotebookNode:
    """A notebook with its outputs, from the first cell to a last one of ``added`` code, ``longest`` [s] for each.

    Now and then a kernel loses a request and waits for it, as its client waits for the answer: it is begun once more.
    """
    try:
        return _played(path, added, longest)
    except CellTimeoutError:
        return _played(path, added, longest)


def _played(path: Path, added: str, longest: float) -> nbformat.NotebookNode:
    book = nbformat.read(path, as_version=4)
    if added:
        book.cells.append(nbformat.v4.new_code_cell(added))
    # Sockets in a folder of its own: the ports that a kernel is given may be taken by another one until it opens them,
    # and who then waits for an answer waits until the end of his patience.
    with tempfile.TemporaryDirectory(prefix="ir") as folder:
        client = NotebookClient(book, timeout=int(longest), startup_timeout=120,
                                resources={"metadata": {"path": str(ROOT)}})
        kernel = client.create_kernel_manager()
        kernel.transport, kernel.ip, kernel.connection_file = "ipc", f"{folder}/ipc", f"{folder}/kernel.json"
        client.execute()
    return book


def outputs_of(path: Path) -> nbformat.NotebookNode | None:
    """The notebook as it was played last; None where it was not, or has another text since."""
    record = PLAYED / path.name
    if not record.is_file():
        return None
    book = nbformat.read(record, as_version=4)
    return book if book.metadata.get("text") == text_of(path) else None


def text_of(path: Path) -> str:
    """What tells one text of a notebook from another."""
    return sha256(path.read_bytes()).hexdigest()


def main(names: list[str]) -> int:
    """Plays the notebooks named, or those without outputs of their present text; 1 where one failed."""
    PLAYED.mkdir(parents=True, exist_ok=True)
    failed = 0
    for path in NOTEBOOKS:
        if path.stem not in names and (names or outputs_of(path) is not None):
            continue
        begun, text = time.monotonic(), text_of(path)
        try:
            book = played(path)
        except Exception as error:
            # The others are played all the same; the page of this one has no outputs and says so.
            print(f"{path.stem}: {str(error)[-600:]}", file=sys.stderr)
            failed = 1
            continue
        book.metadata["text"] = text
        nbformat.write(book, PLAYED / path.name)
        print(f"{path.stem}: {time.monotonic() - begun:.0f} s")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
