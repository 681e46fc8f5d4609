"""Memory that only loading took, given back before the arm is led.

Loading compiled functions runs through much of the compiler's code, which no cycle needs again. The rehearsal that
follows touches what is needed, so that nothing is fetched while a controller waits.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

from scenes.follow.usage import peak_memory

_DONTNEED = 4
"""``MADV_DONTNEED`` of Linux: pages of a file are read from it again when they are touched again."""


def give_back() -> float:
    """Drops pages of libraries' code and free memory of the heap; does nothing where the system is no Linux.

    Returns the largest memory of this process until now [MB]; from now on it is counted anew.
    """
    most = peak_memory(os.getpid())
    if not sys.platform.startswith("linux"):
        return most
    gc.collect()
    library = ctypes.CDLL(None)
    with suppress(OSError, ValueError, AttributeError):
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
            fields = line.split(maxsplit=5)
            # Code alone: nothing was ever written there, so that the file holds all of it.
            if len(fields) == 6 and fields[1] == "r-xp" and fields[5].startswith("/"):
                begin, end = (int(place, 16) for place in fields[0].split("-"))
                library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _DONTNEED)
        library.malloc_trim(0)
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return most
