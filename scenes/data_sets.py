"""Public recordings by others: downloaded, compared with a checksum, and written in this project's format."""

from __future__ import annotations

import faulthandler
import hashlib
import io
import tomllib
import urllib.error
import urllib.request
import zipfile
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pandas as pd
from scipy.io import loadmat

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import whole_files
from scenes.workers import LostError, work_off

_LARGEST = 200_000_000
"""No data set has more bytes."""
_PATIENCE = 30.0
"""How long a server may be silent [s]."""


@dataclass(frozen=True)
class DataSet:
    """One public recording.

    Attributes:
        name: name by which it is fetched.
        title: description.
        page: address of its web page.
        cite: its authors' publication.
        licence: terms of use.
        columns: names of the file's columns, in its order.
        checked: columns that ``values_sha256`` is of.
        format: ``csv`` without titles, or ``mat``.
        url: address of the file; empty where it has to be downloaded by hand.
        member: name of the file in the zip that ``url`` is of; empty where it is the file itself.
        doi: of the publication or the data.
        signals: names in a ``mat`` file, in the order of ``columns``.
        torque_of: columns that torques are in proportion to, with the factor [N m or N per unit].
        digits: decimals with which values enter ``values_sha256``.
        sha256: of the file's bytes; empty where it is checked by its values.
        values_sha256: of the values of ``checked``.
    """

    name: str
    title: str
    page: str
    cite: str
    licence: str
    columns: tuple[str, ...]
    checked: tuple[str, ...]
    format: str = "csv"
    url: str = ""
    member: str = ""
    doi: str = ""
    signals: tuple[str, ...] = ()
    torque_of: dict[str, float] = field(default_factory=dict)
    digits: int = 6
    sha256: str = ""
    values_sha256: str = ""


def data_sets(registry: Path | None = None) -> dict[str, DataSet]:
    """All data sets by name, of a TOML of the form of ``scenes/data_sets.toml``, which is taken if None."""
    text = (resources.files("scenes").joinpath("data_sets.toml") if registry is None else registry).read_text("utf-8")
    sets = {}
    for name, table in tomllib.loads(text).items():
        values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value
                                  for key, value in table.items()}
        sets[name] = DataSet(name, **values)
    return sets


def fetch(name: str, out: Path, *, file: Path | None = None, registry: Path | None = None) -> Path:
    """Downloads a data set and writes it as ``NAME.parquet``, with its origin and licence in ``NAME.txt``.

    Raises InputError for no such set, one that needs ``file``, or a file that cannot be read; IdealRobotError for no
    connection, or not the file that it should be.

    Args:
        name: of the set.
        out: folder; made if missing.
        file: the original file where it was downloaded by hand.
        registry: see ``data_sets``.
    """
    known = data_sets(registry)
    if name not in known:
        raise InputError(f"expected one of {', '.join(known)}", field="name", value=name)
    entry = known[name]
    if file is not None:
        if not file.is_file():
            raise InputError("no such file", file=file)
        content = file.read_bytes()
    elif entry.url:
        content = _downloaded(entry)
    else:
        raise InputError(f"no program can download it; get it from {entry.page} and give it with --file",
                         field="name", value=name)
    if entry.sha256 and hashlib.sha256(content).hexdigest() != entry.sha256:
        raise IdealRobotError(f"{file or entry.url} is not the file that {name} was published as (SHA-256 differs); "
                              "nothing was written")
    columns = _columns(entry, _unpacked(entry, content, str(file or entry.url)), str(file or entry.url))
    if entry.values_sha256 and values_hash(columns, entry) != entry.values_sha256:
        raise IdealRobotError(f"{file or entry.url} does not hold the values of {name} (checksum of "
                              f"{', '.join(entry.checked)} differs); nothing was written")
    meta = {"source": entry.page, "licence": entry.licence, "cite": entry.cite, "doi": entry.doi, "data_set": name}
    path = out / f"{name}.parquet"
    with whole_files(path, out / f"{name}.txt") as (table, words):
        Recording(columns, meta, entry.page).write(table)
        words.write_text("\n".join(f"{key}: {value}" for key, value in {"title": entry.title, **meta}.items()) + "\n",
                         encoding="utf-8")
    return path


def values_hash(columns: dict[str, Array], one: DataSet) -> str:
    """SHA-256 of the checked columns: each name, then its values line by line with ``digits`` decimals."""
    digest = hashlib.sha256()
    for name in one.checked:
        digest.update(name.encode())
        digest.update(b"".join(b"%.*f\n" % (one.digits, value) for value in columns[name] + 0.0))
    return digest.hexdigest()


def _downloaded(entry: DataSet) -> bytes:
    """The file's bytes, or an error that says what to do instead."""
    if urlsplit(entry.url).scheme not in ("http", "https"):
        raise InputError("expected an address that begins with http:// or https://", field="url", value=entry.url)
    try:
        with urllib.request.urlopen(entry.url, timeout=_PATIENCE) as answer:
            content: bytes = answer.read(_LARGEST + 1)
    except (urllib.error.URLError, TimeoutError, OSError) as error:
        reason = error if isinstance(error, urllib.error.HTTPError) else getattr(error, "reason", error)
        raise IdealRobotError(f"{urlsplit(entry.url).netloc} cannot be reached or does not have it ({reason}); where "
                              f"there is internet, download {entry.url} and give it with --file, in Python as fetch(…, "
                              "file=…)") from error
    if len(content) > _LARGEST:
        raise IdealRobotError(f"{entry.url} is larger than {_LARGEST // 1_000_000} MB, no data set is")
    return content


def _unpacked(entry: DataSet, content: bytes, source: str) -> bytes:
    """The member of a zip, in whichever of its folders it lies; what is no zip as it is."""
    if not entry.member or not zipfile.is_zipfile(io.BytesIO(content)):
        return content
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            member = next((info for info in packed.infolist() if Path(info.filename).name == entry.member), None)
            if member is None or member.file_size > _LARGEST:
                raise InputError(f"a zip without {entry.member}; get it from {entry.page}", file=source)
            return packed.read(member)
    except (zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"a broken zip ({error}); get it from {entry.page}", file=source) from error


def _arrays(content: bytes) -> dict[str, Any]:
    """What a ``mat`` file holds; ValueError for a broken one. Of some SciPy's compiled reader ends with its process."""
    [(_, answer)] = work_off([content], _in_mat, 1)
    if isinstance(answer, LostError):
        raise ValueError("SciPy's reader crashes on this file")
    if isinstance(answer, ValueError):
        raise answer
    return dict(answer)


def _in_mat(content: bytes) -> dict[str, Any] | ValueError:
    """What a ``mat`` file holds, or whatever SciPy says of a broken one, which has no type in common."""
    # The parent process reports a crash of this one, in one line.
    faulthandler.disable()
    try:
        return {name: value for name, value in loadmat(io.BytesIO(content)).items() if isinstance(value, np.ndarray)}
    except Exception as error:
        return ValueError(f"{type(error).__name__}: {error}")


def _columns(one: DataSet, content: bytes, source: str) -> dict[str, Array]:
    """The file's columns with our names, time from 0, and the torques."""
    try:
        if one.format == "mat":
            values = _arrays(content)
            columns = {ours: np.asarray(values[theirs], dtype=float).ravel()
                       for ours, theirs in zip(one.columns, one.signals, strict=True)}
        else:
            table = pd.read_csv(io.BytesIO(content), header=None, usecols=range(len(one.columns)))
            columns = {ours: table.iloc[:, i].to_numpy(float) for i, ours in enumerate(one.columns)}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"not readable as {one.format} with {len(one.columns)} columns ({type(error).__name__}: "
                         f"{error}); download the file from {one.page} and give it with --file", file=source) from error
    columns["t"] = columns["t"] - columns["t"][0]
    for name, factor in one.torque_of.items():
        columns[f"tau_{name.rpartition('_')[2]}"] = factor * columns[name]
    return columns
