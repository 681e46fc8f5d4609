"""Arrays that may be larger than memory should hold: they lie in a file without a name, which ends with them."""

from __future__ import annotations

import math
import mmap
import tempfile

import numpy as np

from ideal_robot.arrays import Array

IN_MEMORY = 2_000_000
"""Values of an array that is held in memory; a larger one lies in a file."""


def new_array(*shape: int) -> Array:
    """An array of that shape to be filled, all zero if it lies in a file."""
    count = math.prod(shape)
    if count <= IN_MEMORY:
        return np.empty(shape)
    with tempfile.TemporaryFile() as file:
        file.truncate(8 * count)
        return np.frombuffer(mmap.mmap(file.fileno(), 0)).reshape(shape)


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
