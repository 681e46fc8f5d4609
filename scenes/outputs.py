"""Writes results: places are checked before any work begins, and folders are replaced as a whole."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from ideal_robot.errors import InputError
from ideal_robot.whole_file import OutputError, beside, is_device, synchronise

_EXCHANGE = 2
"""``RENAME_EXCHANGE`` of renameat2(2)."""
_TRIED = 4096
"""How much is written to find out whether there is room [bytes]; no report is smaller."""
_Held = list[tuple[Path, Path, ExitStack]]
"""New folders that are written, their places, and what removes them."""
_HELD: ContextVar[_Held | None] = ContextVar("folders that wait for other files", default=None)
_TRIES = 100
"""How often a folder that other runs exchange meanwhile is looked at anew."""


def check_outputs(folders: dict[str, Path | None] | None = None, **files: Path | None) -> None:
    """Makes sure that results can be written, without leaving anything behind.

    Raises InputError for a folder where a file should be or the reverse, no right to write, two results of one name.

    Args:
        folders: option → folder that results go to; None where the option is not given.
        files: name of the option (``_`` for ``-``) → file.
    """
    option_of: dict[Path, str] = {}
    outputs = [*((option, path, True) for option, path in (folders or {}).items()),
               *(("--" + name.replace("_", "-"), path, False) for name, path in files.items())]
    for option, path, folder in outputs:
        if path is None:
            continue
        try:
            _check(path, option, folder)
            place = path.resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise InputError(f"cannot be written ({getattr(error, 'strerror', None) or error}); give another place",
                             field=option, value=str(path)) from error
        if place in option_of:
            raise InputError(f"the same place as {option_of[place]}; give another one", field=option, value=str(path))
        option_of[place] = option


def _check(path: Path, option: str, folder: bool) -> None:
    if path.exists() and path.is_dir() != folder:
        raise InputError(f"is a {'file' if folder else 'folder'}; expected the name of a "
                         f"{'folder' if folder else 'file'}", field=option, value=str(path))
    if is_device(path):
        raise InputError("is a device or a pipe; expected the name of a file", field=option, value=str(path))
    place = path if folder else path.parent
    # Raises for names that the file system has but UTF-8 cannot say, as libraries and pages need text.
    str(path).encode()
    if not folder and len(os.fsencode(path.name)) > 255:
        raise InputError("the name is too long", field=option, value=f"{path.name[:40]}…")
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise InputError(f"{place} is a file, not a folder", field=option, value=str(path))
    # Asking for the rights is not enough: full, read-only and vanished file systems say so only when written to.
    with tempfile.NamedTemporaryFile(dir=place, prefix=".ideal-robot-") as tried:
        tried.write(bytes(_TRIED))
        tried.flush()


@contextmanager
def folders_held() -> Iterator[None]:
    """Within the block, folders of ``whole_folder`` wait; all are put in place at its end, none if it fails.

    So a file that is written after a folder, in the block, is whole before the folder is there.

    Raises OutputError where a folder cannot take its place.
    """
    held: _Held = []
    token = _HELD.set(held)
    try:
        yield
        for new, place, _ in held:
            try:
                _take_place(new, place)
                synchronise(place.parent)
            except OSError as error:
                raise OutputError.of(place, error) from error
    finally:
        _HELD.reset(token)
        for _, _, stack in held:
            stack.close()


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yields a new folder to write into; at the end of the block its files go into ``folder`` together.

    Other files of ``folder`` stay. Where the system cannot exchange folders atomically (not Linux, or ``folder`` is the
    working folder, a mount point or holds folders), the files are moved one by one, each whole. Missing parents are
    made. Raises OutputError where it cannot be written; ``folder`` is as it was.
    """
    new: Path | None = None
    held = _HELD.get()
    try:
        with ExitStack() as stack:
            place = folder.absolute()
            new = stack.enter_context(beside(place / place.name if _fixed(place) else place))
            new.mkdir()
            yield new
            for file in new.iterdir():
                synchronise(file)
            if held is None:
                _take_place(new, place)
                synchronise(place.parent)
            else:
                held.append((new, place, stack.pop_all()))
    except OSError as error:
        raise OutputError.of(folder, error) from error
    except OutputError as error:
        raise (error if new is None else error.named(new, folder)) from error.__cause__


def _fixed(folder: Path) -> bool:
    """Whether the folder must stay the folder it is: in use, mounted, linked to, or in one that is not ours."""
    return folder.exists() and (Path.cwd().is_relative_to(folder.resolve()) or folder.is_mount() or folder.is_symlink()
                                or not os.access(folder.parent, os.W_OK))


def _take_place(new: Path, folder: Path) -> None:
    if not folder.exists():
        with suppress(OSError):  # another run may have made it meanwhile
            new.rename(folder)
            return
    written = set(new.iterdir())
    for _ in range(_TRIES):
        entries = [entry for entry in folder.iterdir() if new / entry.name not in written and entry != new.parent]
        if _fixed(folder) or any(entry.is_dir() for entry in entries):
            break
        try:
            for entry in entries:
                os.link(entry, new / entry.name, follow_symlinks=False)
            _exchange(new, folder)
            for entry in new.iterdir():  # files that came into the old folder between its listing and the exchange
                if not (folder / entry.name).exists():
                    entry.replace(folder / entry.name)
            return
        except FileNotFoundError:
            continue  # another run exchanged the folder meanwhile
        except OSError:
            break  # a system that cannot link or exchange
        finally:
            for entry in set(new.iterdir()) - written if new.exists() else ():
                entry.unlink()
    for file in sorted(new.iterdir()):
        file.replace(folder / file.name)


def _exchange(one: Path, other: Path) -> None:
    """Two folders swap names at one stroke; raises OSError where the system cannot."""
    if not sys.platform.startswith("linux"):
        raise OSError("no exchange of folders on this system")
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        raise OSError("no exchange of folders in this C library")
    dirfd = -100  # AT_FDCWD; the names are absolute
    if call(dirfd, os.fsencode(one), dirfd, os.fsencode(other), _EXCHANGE):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
