"""Arrays that may be larger than memory should hold: they lie in a file without a name, which ends with them."""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.whole_file import OutputError

IN_MEMORY = 500_000
"""Values of an array that is held in memory; a larger one lies in a file."""


def new_array(*shape: int) -> Array:
    """An array of that shape to be filled, all zero if it lies in a file."""
    count = math.prod(shape)
    return np.empty(shape) if count <= IN_MEMORY else in_new_file(count).reshape(shape)


def in_new_file(count: int) -> Array:
    """So many zeros in a file without a name.

    Raises:
        OutputError: the folder for temporary files has no room for it.
    """
    try:
        with tempfile.TemporaryFile() as file:
            # Room that is only promised would end the program where it is written to and not there.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, 8 * count)
            else:
                file.truncate(8 * count)
            return np.frombuffer(mmap.mmap(file.fileno(), 0))
    except OSError as error:
        raise no_room(error) from error


def no_room(error: OSError) -> OutputError:
    """What is said where the folder for temporary files has no room."""
    return OutputError(f"{tempfile.gettempdir()}: temporary files cannot be written ({error.strerror or error}); make "
                       "room, or set TMPDIR to another folder")


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yields a folder that is removed when the block ends; OutputError where it cannot be written."""
    try:
        with tempfile.TemporaryDirectory(prefix="ideal-robot-") as folder:
            yield Path(folder)
    except OSError as error:
        raise no_room(error) from error


def file_of(values: Array) -> mmap.mmap | None:
    """The file that an array lies in; None where it is in memory."""
    owner: object = values
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    if isinstance(owner, memoryview):
        owner = owner.obj
    return owner if isinstance(owner, mmap.mmap) else None


def let_go(*arrays: Array) -> None:
    """What was read or written of arrays in files need not stay in memory; nothing happens to other ones."""
    for values in arrays:
        file = file_of(values)
        if file is not None and hasattr(file, "madvise"):
            file.madvise(mmap.MADV_DONTNEED)
