"""Answers of a sweep as they come, one JSON line each, so that a sweep that was ended can go on."""

from __future__ import annotations

import json
import os
from collections.abc import Hashable
from contextlib import suppress
from pathlib import Path
from typing import Any

from ideal_robot.errors import InputError
from ideal_robot.whole_file import OutputError
from scenes.report.page import plain

FIGURES = {"speed_m_s": "m/s", "control_error_mm.mean": "mean mm", "control_error_mm.p95": "95 % mm",
           "control_error_mm.max": "max mm", "path_error_mm.time_matched.E_car": "E_car mm",
           "force_error_N.rms": "force N"}
"""Figures of a run that the table shows where the kind of scene has them, and the columns' titles."""
_LARGEST = 1e15
"""Numbers beyond are no figures."""


class SweepFile:
    """A file of lines ``{"job": …, "answer": …}``.

    Args:
        path: of the file.
        resume: go on with a file that is there; without it such a file is refused.

    Raises:
        InputError: the file is there and not to be gone on with, or is none of a sweep.
    """

    def __init__(self, path: Path, *, resume: bool) -> None:
        self.path = path
        self.answers: dict[Hashable, dict[str, Any]] = {}
        """Answers read from the file, by ``key_of`` their job."""
        if path.exists():
            if not resume:
                raise InputError("is there already; --resume goes on with it, or give another name", field="--lines",
                                 value=str(path))
            self._read()

    def _read(self) -> None:
        if not self.path.is_file():
            raise InputError("not a plain file", field="--lines", value=str(self.path))
        raw = self.path.read_bytes()
        # A sweep that was killed may have left its last line unfinished.
        whole = raw[: raw.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                entry = json.loads(line)
                self.answers[key_of(entry["job"])] = _checked(entry["answer"])
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
                raise InputError(f"line {number} is none of a sweep; remove it, and its run is played again",
                                 file=self.path, field="--lines") from error
        if len(whole) < len(raw):
            os.truncate(self.path, len(whole))

    def add(self, job: dict[str, Any], answer: dict[str, Any]) -> None:
        """Appends an answer; it is on the disk when this returns.

        Raises:
            OutputError: it cannot be written; the file holds the answers before it.
        """
        line = json.dumps({"job": plain(job), "answer": plain(answer)}, allow_nan=False) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab", buffering=0) as file:
                whole = file.tell()
                try:
                    _append(file.fileno(), line.encode())
                except OSError:
                    with suppress(OSError):  # a disk that is read-only by now; --resume cuts the line off
                        file.truncate(whole)
                    raise
        except OSError as error:
            raise OutputError.of(self.path, error, "make room and go on with --resume; it holds the answers before "
                                                   "this one") from error


def _checked(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer that tables can be made of; raises an error of Python for any other."""
    for key, kinds in (("scene", str), ("method", str | None), ("seed", int | None), ("failure", str | None)):
        if not isinstance(answer[key], kinds):
            raise TypeError(key)
    for path in FIGURES:
        *tables, key = path.split(".")
        value: Any = answer
        for table in tables:
            value = value.get(table, {})
        value = value.get(key)
        if value is not None and not (isinstance(value, int | float) and abs(value) < _LARGEST):
            raise ValueError(path)
    return dict(answer)


def _append(descriptor: int, line: bytes) -> None:
    """Writes a line to the disk; a full disk may take a part of it before it says so."""
    while line:
        line = line[os.write(descriptor, line) :]
    os.fsync(descriptor)


def key_of(job: dict[str, Any]) -> Hashable:
    """What tells jobs apart."""
    return json.dumps(plain(job), sort_keys=True)
