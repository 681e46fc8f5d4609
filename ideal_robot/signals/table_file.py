"""Tables on disk (Parquet, CSV, npz) within bounds: a file's stated size is checked before it is unpacked."""

from __future__ import annotations

import csv
import re
import warnings
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import (
    TABLE_COLUMNS,
    TABLE_LINE,
    TABLE_UNFOLDING,
    TABLE_VALUES,
    TABLE_WORDS,
    check_unfolding,
    parsed_json,
)
from ideal_robot.errors import InputError
from ideal_robot.row_log import finished, let_go, new_columns

if TYPE_CHECKING:
    import pandas as pd

_LINE_END = re.compile(rb"\r\n|\r|\n")
AT_ONCE = 20_000_000
"""Values of a table that is held in memory; the columns of a larger one are in a file."""
PIECE = 2_000_000
"""Values that are unpacked at a time, or one row."""
_UNPACKED = 8
"""Bytes of a value in memory."""


def read_table(path: Path) -> tuple[dict[str, Array], dict[str, Any], list[str]]:
    """Columns ``(N,)`` by name, the metadata, and the names of omitted non-numeric columns.

    Of a Parquet file, or of a CSV or npz file by its ending. Dates are seconds since 1970, times of the day seconds
    since midnight; lists of one length in a Parquet file, and arrays ``(N, n)``, are columns ``name_0``, ``name_1``, ….
    Of large tables the columns lie in a file without a name, read-only, and are filled piece by piece. Raises
    InputError for a file that is not readable or larger than the bounds, a column twice with other values, metadata
    that is no table.
    """
    try:
        return {".csv": _csv, ".npz": _npz}.get(path.suffix.lower(), _parquet)(path)
    except InputError:
        raise
    except Exception as error:  # pandas and Arrow raise many types of exceptions for a damaged file
        shown = " ".join(str(error).split())[:300]
        raise InputError(f"not a readable recording ({type(error).__name__}: {shown}); expected Parquet, CSV, "
                         "npz, a ROS bag or MCAP", file=path) from error


def _parquet(path: Path) -> tuple[dict[str, Array], dict[str, Any], list[str]]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        _check_names(schema.names, path)
        widths = _widths(file)
        names = [field.name for field in schema if _numeric(field.type) or field.name in widths]
        unfolded = [title for name in names for title in _unfolded(name, widths.get(name))]
        _check_names(unfolded, path)
        TABLE_VALUES.check(rows * max(len(schema.names), len(unfolded)), path, "cut it into pieces")
        check_unfolding(TABLE_UNFOLDING, rows * len(unfolded) * _UNPACKED, path.stat().st_size, path)
        raw = (schema.metadata or {}).get(b"ideal_robot")
        pieces = file.iter_batches(_rows_of_a_piece(max(len(schema.names), len(unfolded))), columns=names)
        columns, words = _filled((_flat(piece, widths, path) for piece in pieces), unfolded, rows)
    words += [name for name in schema.names if name not in names]
    meta = {} if raw is None else _metadata(raw, path)
    # Notes of another file's reader in the metadata do not apply to this file.
    meta = {key: value for key, value in meta.items() if key != "reading"}
    if widths:
        said = ", ".join(f"{name} of {width} values" for name, width in widths.items())
        meta["reading"] = [f"lists: {said}, a column each, counted from 0"]
    return columns, meta, words


def _widths(file: Any) -> dict[str, int]:
    """How many numbers each value of a column of lists holds, by the first of them; of columns of lists alone."""
    import pyarrow as pa

    listed = [field.name for field in file.schema_arrow
              if (pa.types.is_list(field.type) or pa.types.is_large_list(field.type)
                  or pa.types.is_fixed_size_list(field.type)) and _numeric(field.type.value_type)]
    if not listed or not file.metadata.num_rows:
        return {}
    first = next(file.iter_batches(1, columns=listed)).to_pylist()[0]
    return {name: len(first[name]) for name in listed if first[name]}


def _unfolded(name: str, width: int | None) -> list[str]:
    return [name] if width is None else [f"{name}_{k}" for k in range(width)]


def _flat(piece: Any, widths: dict[str, int], path: Path) -> pd.DataFrame:
    """A piece of a Parquet file with a column for each place of its lists; InputError for lists of another length."""
    import pandas as pd
    import pyarrow as pa

    columns: dict[str, Any] = {}
    for name, column in zip(piece.schema.names, piece.columns, strict=True):
        if name not in widths:
            columns[name] = column.to_pandas()
            continue
        lengths = column.value_lengths() if hasattr(column, "value_lengths") else None
        values = column.flatten()
        if len(values) != widths[name] * len(column) or (
                lengths is not None and not pa.types.is_fixed_size_list(column.type)
                and (np.asarray(lengths) != widths[name]).any()):
            raise InputError(f"its lists are not all of {widths[name]} values; write a column for each joint",
                             file=path, field=_shown(name))
        table = np.asarray(values.to_numpy(zero_copy_only=False), dtype=float).reshape(-1, widths[name])
        columns.update({title: table[:, k] for k, title in enumerate(_unfolded(name, widths[name]))})
    return pd.DataFrame(columns)


def _numeric(type_: Any) -> bool:
    """Whether an Arrow type is one of numbers or stamps; text is not even unpacked."""
    import pyarrow as pa

    kind = type_.value_type if pa.types.is_dictionary(type_) else type_
    return any(of(kind) for of in (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean,
                                   pa.types.is_decimal, pa.types.is_null,
                                   pa.types.is_timestamp))


def _npz(path: Path) -> tuple[dict[str, Array], dict[str, Any], list[str]]:
    """Columns of the arrays ``(N,)`` and ``(N, n)`` of numbers that most arrays are as long as; others are left out."""
    arrays: dict[str, Array] = {}
    with zipfile.ZipFile(path) as packed:
        check_unfolding(TABLE_UNFOLDING, sum(entry.file_size for entry in packed.infolist()), path.stat().st_size, path)
    with np.load(path, allow_pickle=False) as file:
        for name in file.files:
            try:
                array = file[name]
            except ValueError:  # objects, which are not unpickled
                continue
            if array.ndim in (1, 2) and array.dtype.kind in "fiub":
                arrays[name] = array
        names = list(file.files)
    lengths = [len(array) for array in arrays.values()]
    rows = max(lengths, key=lambda length: (lengths.count(length), length), default=0)
    tables = {name: array for name, array in arrays.items() if len(array) == rows}
    columns: dict[str, Array] = {}
    for name, array in tables.items():
        titles = [name] if array.ndim == 1 else _unfolded(name, array.shape[1])
        columns.update(zip(titles, np.asarray(array, dtype=float).reshape(rows, -1).T, strict=True))
    _check_names(list(columns), path)
    TABLE_VALUES.check(rows * len(columns), path, "cut it into pieces")
    wide = {name: array.shape[1] for name, array in tables.items() if array.ndim == 2}
    said = ", ".join(f"{name} of {width} values" for name, width in wide.items())
    return ({title: np.ascontiguousarray(values) for title, values in columns.items()},
            {"reading": [f"lists: {said}, a column each, counted from 0"]} if wide else {},
            [name for name in names if name not in tables])


def _csv(path: Path) -> tuple[dict[str, Array], dict[str, Any], list[str]]:
    import pandas as pd

    rows = _lines(path)
    form = _layout(path)
    TABLE_COLUMNS.check(len(form.titles), path)
    titles = _apart(form.titles)
    # An empty value takes one byte, its comma.
    TABLE_VALUES.check(min(rows * len(form.titles), path.stat().st_size), path, "cut it into pieces")
    with warnings.catch_warnings():
        # Rows with more values than names, which pandas would truncate.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        with pd.read_csv(path.absolute(), index_col=False, low_memory=False, sep=form.separator, decimal=form.decimal,
                         names=titles, header=None, skiprows=form.skipped, encoding=form.encoding,
                         skipinitialspace=True, chunksize=_rows_of_a_piece(len(form.titles))) as pieces:
            columns, words = _filled(pieces, None, rows)
    unnamed = [name for name in form.unnamed if name in columns and np.isnan(columns[name]).all()]
    twice = dict(zip(titles, form.titles, strict=True))
    again = [name for name in titles if name != twice[name]]
    for name in again:
        own, other = columns.get(name), columns.get(twice[name])
        if (own is None or other is None) != (own is other) or (
                own is not None and other is not None and not np.array_equal(own, other, equal_nan=True)):
            raise InputError("the column stands in the file twice, with other values; rename one of them", file=path,
                             field=_shown(twice[name]))
    said = [form.said] * bool(form.said)
    said += [f"left-out: {', '.join(dict.fromkeys(twice[name] for name in again))}, which stand in the file twice with "
             "the same values, once"] * bool(again)
    return ({name: values for name, values in columns.items() if name not in (*unnamed, *again)},
            {"reading": said} if said else {}, [name for name in words if name not in again])


def _apart(titles: list[str]) -> list[str]:
    """Titles of which none stands twice: a second one has a number behind it."""
    apart: dict[str, None] = {}
    for title in titles:
        name, number = title, 1
        while name in apart or (name != title and name in titles):
            number += 1
            name = f"{title} ({number})"
        apart[name] = None
    return list(apart)


# Recognises the form of a text table: separator, comment marks and headers.

_LOOKED_AT = 64
"""Lines in which a table begins, if at all."""
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", r"\s+": "spaces"}
"""What may stand between values; a comma between them is the last to be thought of where it may be in them."""
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|nan|[+-]?inf(inity)?|", re.IGNORECASE)


@dataclass(frozen=True)
class _Layout:
    """Separator and decimal sign of a table, its titles, the lines before its values, and what to say of it.

    ``unnamed`` are titles that stand for none: a separator after the last value makes a column of nothing.
    """

    separator: str
    decimal: str
    titles: list[str]
    skipped: int
    encoding: str
    said: str = ""
    unnamed: tuple[str, ...] = ()


def _layout(path: Path) -> _Layout:
    """Finds separator, decimal sign and titles of a text file: a line of titles over lines of as many values.

    A line of units between titles and values joins the titles; without titles columns are ``column_1``, ….
    """
    with path.open("rb") as file:
        raw = file.readlines(TABLE_LINE.most)[:_LOOKED_AT]
    encoding = "utf-8-sig"
    try:
        lines = b"".join(raw).decode(encoding).splitlines()
    except UnicodeDecodeError:
        # The encoding in which Western European spreadsheets save degrees and umlauts.
        encoding = "cp1252"
        lines = b"".join(raw).decode(encoding, errors="replace").splitlines()
    for separator, name in _SEPARATORS.items():
        rows = [_cells(line, separator) for line in lines]
        begin = next((k for k, row in enumerate(rows) if _is_values(row) and (len(row) > 1)
                      and all(len(other) == len(row) for other in rows[k : k + 3] if other)), None)
        if begin is None:
            continue
        width = len(rows[begin])
        above = [row for row in rows[:begin] if len(row) == width]
        if begin and not above and separator == ",":
            # The number of titles differs from that of columns, which pandas reports.
            break
        titles, units = (above[-1], None) if above else ([""] * width, None)
        if len(above) > 1 and _are_units(above[-1]):
            titles, units = above[-2], above[-1]
        titles = [title.strip() for title in titles]
        if units is not None:
            titles = [f"{title} [{unit.strip(' []()')}]" if unit.strip(" []()") else title
                      for title, unit in zip(titles, units, strict=True)]
        if _ends_in(lines[begin], separator):
            titles.append("")
        unnamed = [i for i, title in enumerate(titles) if not title]
        titles = [title or f"column_{i + 1}" for i, title in enumerate(titles)]
        comma = separator != "," and any("," in cell for row in rows[begin:] for cell in row)
        before = begin - len(above[-1:]) - (units is not None)
        said = [f"{name} between values"] * (separator != ",") + ["decimal commas"] * comma
        said += [f"{before} lines before the titles left out"] * (before > 0)
        said += ["no titles: columns are called by their place"] * (not above)
        return _Layout(separator, "," if comma else ".", titles, begin, encoding,
                       f"table: {', '.join(said)}" if said else "", tuple(titles[i] for i in unnamed))
    titles = next(csv.reader(lines[:1]), [])
    return _Layout(",", ".", titles, 1, encoding)


def _cells(line: str, separator: str) -> list[str]:
    if separator == r"\s+":
        return line.split()
    cells = next(csv.reader([line], delimiter=separator), [])
    return cells[:-1] if _ends_in(line, separator) else cells


def _ends_in(line: str, separator: str) -> bool:
    """Whether a separator stands after the last value; a comma there is an empty value of a recording of ours."""
    return separator in ";\t" and line.rstrip(" ").endswith(separator)


def _is_values(row: list[str]) -> bool:
    """Whether all that a line's cells hold are numbers, or most of it."""
    held = [cell.strip() for cell in row if cell.strip()]
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in held)
    return bool(held) and (numbers == len(held) or 2 * numbers > len(row))


def _are_units(row: list[str]) -> bool:
    """Whether the cells of a line are units: short, and not one of them a name with a number."""
    return all(len(cell.strip(" []()")) <= 6 and not any(c.isdigit() for c in cell) for cell in row)


def _rows_of_a_piece(columns: int) -> int:
    return max(1, PIECE // max(columns, 1))


def _filled(frames: Iterable[pd.DataFrame], names: list[str] | None, most: int) -> tuple[dict[str, Array], list[str]]:
    """Columns of tables one below the other, at most so many rows together, and the names of those not of numbers."""
    count, columns, words = 0, dict[str, Array](), dict[str, None]()
    for frame in frames:
        names = names or [str(name) for name in frame.columns]
        columns = columns or new_columns(names, most, in_memory=most * len(names) <= AT_ONCE)
        for name in names:
            numbers = _numbers(frame[name])
            if numbers is None:
                words[name] = None
            else:
                columns[name][count : count + len(frame)] = numbers
        count += len(frame)
        let_go(*list(columns.values())[:1])  # the first array suffices, as all are in one file
    columns = columns or {name: np.empty(0) for name in names or ()}
    return {name: values[:count] for name, values in finished(columns).items() if name not in words}, list(words)


_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d")


def _numbers(column: pd.Series) -> Array | None:
    """The values of a column ``(N,)``, of dates and times of the day their seconds; None where they are text."""
    if column.dtype.kind == "M":
        return _seconds(column)
    if column.dtype.kind not in "fiubO":
        return None
    try:
        return np.array(column, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return _seconds(column)


def _seconds(column: pd.Series) -> Array | None:
    """Seconds since 1970 of dates, since midnight of times of the day ``(N,)``; None where a column is neither."""
    import pandas as pd

    first = str(column.iloc[0]) if len(column) else ""
    try:
        if column.dtype.kind == "M" or _DATE.match(first):
            since = pd.to_datetime(column, format="ISO8601", utc=True) - pd.Timestamp(0, tz="UTC")
        elif _TIME_OF_DAY.match(first):
            since = pd.to_timedelta(column)
        else:
            return None
        return np.array(since.dt.total_seconds(), dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None


def _lines(path: Path) -> int:
    """Lines of a CSV file, the last one included; none is long, and no quote goes on in the next one.

    Raises InputError for a line that a table cannot have; a parser would make a row of millions of values of it.
    """
    count, length, quotes = 1, 0, 0
    with path.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            *whole, last = _LINE_END.split(block)
            for line in whole:
                TABLE_LINE.check(length + len(line), path, "is this a table?")
                if (quotes + line.count(b'"')) % 2:
                    raise InputError(f"line {count} has a quote that does not end in it", file=path)
                count, length, quotes = count + 1, 0, 0
            length, quotes = length + len(last), quotes + last.count(b'"')
            TABLE_LINE.check(length, path, "is this a table?")
    return count


def _metadata(raw: bytes, path: Path) -> dict[str, Any]:
    TABLE_WORDS.check(len(raw), path)
    try:
        meta = parsed_json(raw.decode(), path, "metadata")
    except (InputError, UnicodeDecodeError) as error:
        raise InputError(f"not readable ({error}); write the recording again", file=path,
                         field="metadata ideal_robot") from error
    if not isinstance(meta, dict):
        raise InputError("expected a table (a JSON object)", file=path, field="metadata ideal_robot",
                         value=_shown(meta))
    return meta


def _check_names(names: list[str], path: Path) -> None:
    TABLE_COLUMNS.check(len(names), path)
    twice = {name for name in names if names.count(name) > 1} if len(set(names)) < len(names) else set()
    if twice:
        raise InputError("the column stands in the file twice", file=path, field=_shown(min(twice)))


def _shown(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "…"
