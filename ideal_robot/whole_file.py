"""Writes files whole or not at all: in a hidden folder beside their place, then moved there.

Whatever ends the program in between — an error, a full disk, ``kill -9`` — the old file stays.
"""

from __future__ import annotations

import errno
import glob
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from ideal_robot.errors import IdealRobotError

_ABANDONED = 86_400.0
"""What a killed run left of a file is removed by the next one when it is older than this [s]."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of the system where there is no room."""
_REMEDIES = {errno.ENOSPC: "make room", errno.EDQUOT: "make room", errno.EFBIG: "raise the limit on the size of files",
             errno.EROFS: "give another place, or make it writable", errno.EACCES: "give another place, or make it "
             "writable", errno.EPERM: "give another place, or make it writable",
             errno.ENOENT: "its folder is gone; make it again", errno.ENOTDIR: "give another place"}
"""Errors of the system, and what helps."""


class OutputError(IdealRobotError):
    """A result could not be written; an old file there is untouched."""

    @classmethod
    def of(cls, place: object, error: Exception, remedy: str | None = None) -> OutputError:
        """The error for a place that cannot be written.

        Args:
            place: the file or folder, as the user named it.
            error: of the system, or of a library that met one.
            remedy: the remedy that the message names; that of the kind of error if None.
        """
        number = getattr(error, "errno", None) or 0
        reason = os.strerror(number) if number else str(error)
        return cls(f"{place}: cannot be written ({reason}); "
                   f"{remedy or _REMEDIES.get(number, 'look at the disk, or give another place')}")

    def named(self, partial: Path, place: Path) -> OutputError:
        """The same error with ``place`` instead of the temporary file or folder."""
        return OutputError(str(self).replace(str(partial), str(place)))


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yields a temporary name to write to; moved to ``path`` when the block ends without an error, else removed.

    Missing parents are made, and the rights of a file that was there stay. Raises OutputError where it cannot be
    written, e.g. the disk is full.
    """
    with whole_files(path) as (partial,):
        yield partial


@contextmanager
def whole_files(*paths: str | Path | None) -> Iterator[list[Any]]:
    """As ``whole_file`` for several files: none is moved before all are written.

    None among ``paths`` gives None at its place.
    """
    places = [None if path is None else Path(path) for path in paths]
    moves: list[tuple[Path, Path]] = []
    try:
        with ExitStack() as stack:
            for place in places:
                if place is not None:
                    if is_device(place):
                        raise OutputError(f"{place}: is a device or a pipe; expected the name of a file")
                    moves.append((stack.enter_context(beside(place)), place))
            partials = iter(moves)
            yield [None if place is None else next(partials)[0] for place in places]
            for partial, place in moves:
                with suppress(FileNotFoundError):
                    shutil.copymode(place, partial)
                synchronise(partial)
            for partial, place in moves:
                partial.replace(place)
            for folder in {place.parent for _, place in moves}:
                synchronise(folder)
    except OSError as error:
        names = ", ".join(str(place) for _, place in moves) or str(places[0])
        raise OutputError.of(names, error) from error
    except OutputError as error:
        # An error about a partial file is reported for the final one.
        for partial, place in moves:
            error = error.named(partial, place)
        raise error from error.__cause__


def write_text(path: str | Path, text: str) -> Path:
    """Writes a text file whole or not at all; raises OutputError where that fails."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


def inert(text: str) -> str:
    """A text that a spreadsheet shows unchanged: with an apostrophe where it would be read as a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def is_device(place: Path) -> bool:
    """Whether a path is neither file nor folder, such as a device, which a moved file would replace."""
    return place.exists() and not (place.is_file() or place.is_dir())


@contextmanager
def beside(place: Path) -> Iterator[Path]:
    """Yields a temporary name for a file to be moved to ``place``, in a hidden folder beside it, removed afterwards.

    Missing parents are made, and removed again if they stay empty. Remains of killed runs with the same name are
    removed after a day.
    """
    made = make_folder(place.parent)
    beginning = f".{place.name[:40]}."  # at most four bytes each, of the 255 that a name may have
    try:
        for old in place.parent.glob(f"{glob.escape(beginning)}*.part"):
            with suppress(OSError):
                if time.time() - old.stat().st_mtime > _ABANDONED:
                    shutil.rmtree(old)
        with tempfile.TemporaryDirectory(".part", beginning, place.parent, ignore_cleanup_errors=True) as folder:
            # pandas would expand a leading ~ to a home folder.
            yield Path(folder).absolute() / place.name
    finally:
        remove_empty(made)


def make_folder(folder: Path) -> list[Path]:
    """Makes a folder and its missing parents; returns those that were made, the innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def remove_empty(folders: list[Path]) -> None:
    """Removes those of the folders that are empty, in the given order."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def synchronise(path: Path) -> None:
    """Waits until a file, or a folder's list of files, is on the disk."""
    if path.is_dir() and os.name == "nt":
        return  # folders cannot be opened on such systems
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
