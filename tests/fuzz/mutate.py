"""Ways in which files come to be broken: texts (TOML, JSON, URDF, CSV, SVG), recordings, single values.

A value set to something extreme shows whether a reader asks for type, size and range.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]{2,}")
VALUES = (b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"1", b"99999", b"-0.5", b"1e9",
          b"true", b"null", b"None", b'"x"', b"[]", b"{}", b"[1]", b"[[]]", b"''", b"9" * 400, b"1e999",
          b"0x10", b"1_0", b"")
"""What a number is replaced by."""
JUNK = (b"\0", b"\xff\xfe", b"\r", b"[/red]", b"<!--", b"../", b"\x1b[31m", "\u202e".encode(), b"[" * 5000, b"{" * 5000,
        b'"', b"'", b"&a;", b"<![CDATA[", b"\n\n", b"," * 50, b"a." * 3000, b"%n%s", b"(" * 3000)
"""What is put anywhere."""


def _replaced(text: bytes, rng: np.random.Generator, new: Callable[[bytes], bytes]) -> bytes:
    """The text with one of its numbers made another thing."""
    numbers = list(NUMBER.finditer(text))
    if not numbers:
        return text
    number = numbers[rng.integers(len(numbers))]
    return text[: number.start()] + new(number.group()) + text[number.end():]


def _number(text: bytes, rng: np.random.Generator) -> bytes:
    return _replaced(text, rng, lambda _: VALUES[rng.integers(len(VALUES))])


def _scaled(text: bytes, rng: np.random.Generator) -> bytes:
    factors = [-1.0, 1e-9, 1e-3, 0.5, 2.0, 1e3, 1e6, 1e12]
    return _replaced(text, rng, lambda number: repr(float(number) * float(rng.choice(factors))).encode())


def _word(text: bytes, rng: np.random.Generator) -> bytes:
    words = list(WORD.finditer(text))
    if len(words) < 2:
        return text
    word, other = words[rng.integers(len(words))], words[rng.integers(len(words))]
    return text[: word.start()] + other.group() + text[word.end():]


def _line(text: bytes, rng: np.random.Generator) -> bytes:
    lines = text.split(b"\n")
    k = int(rng.integers(len(lines)))
    what = rng.integers(3)
    if what == 0:
        del lines[k]
    elif what == 1:
        lines.insert(int(rng.integers(len(lines) + 1)), lines[k])
    else:
        other = int(rng.integers(len(lines)))
        lines[k], lines[other] = lines[other], lines[k]
    return b"\n".join(lines)


def flipped(text: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(text)
    for _ in range(int(rng.integers(1, 8))):
        if changed:
            changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def _junk(text: bytes, rng: np.random.Generator) -> bytes:
    k = int(rng.integers(len(text) + 1))
    return text[:k] + JUNK[rng.integers(len(JUNK))] + text[k:]


def _cut(text: bytes, rng: np.random.Generator) -> bytes:
    k, m = sorted(int(k) for k in rng.integers(0, len(text) + 1, 2))
    return text[:k] if rng.random() < 0.5 else text[:k] + text[m:]


def _emptied(text: bytes, rng: np.random.Generator) -> bytes:
    return (b"", b"\n", b"{}", b"[]", b"null", b"\0" * 100)[rng.integers(6)]


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _number, _number, _number, _scaled, _scaled, _word, _line, _line, flipped, _junk, _cut, _emptied)


def mutated_text(text: bytes, rng: np.random.Generator) -> bytes:
    """The text with one to three things broken."""
    for _ in range(int(rng.integers(1, 4))):
        text = MUTATIONS[rng.integers(len(MUTATIONS))](text, rng)
    return text


META = (b"null", b"[]", b"3", b'"x"', b"{", b"[" * 50_000, b"\xff", b'{"joints": 3}', b'{"joints": [[1], {}]}',
        b'{"robot": ["a"]}', b'{"cycle_time": null}', b'{"camera": 3, "tool": [1]}', b'{"payload_lever": "x"}', b"{}")


def mutated_table(columns: dict[str, Any], required: tuple[str, ...], rng: np.random.Generator, *, csv: bool
            ) -> tuple[bytes, bool]:
    """A broken recording as the bytes of a file.

    Args:
        columns: of the sound one ``(N,)``.
        required: columns without which it cannot be used.
        rng: draws what breaks.
        csv: written as CSV, else as Parquet.

    Returns:
        The bytes, and whether a required column is certainly lost.
    """
    columns = {name: np.array(values) for name, values in columns.items()}
    meta = json.dumps({"robot": "arm"}).encode()
    lost = False
    for _ in range(int(rng.integers(1, 3))):
        kind = int(rng.integers(9))
        if kind == 0:
            columns, dropped = _dropped(columns, required, rng)
            lost = lost or dropped
        elif kind in (1, 2, 3, 4, 5, 7):
            # The second change may meet a column that the first has made no numbers of: that one is broken enough.
            with suppress(TypeError, ValueError):
                columns = (_types if kind == 7 else _values if kind < 4 else _times)(columns, rng)
        elif kind == 6:
            columns = _rows(columns, rng)
        else:
            meta = META[rng.integers(len(META))]
    raw = csv_bytes(columns) if csv else _parquet(columns, meta)
    if rng.random() < 0.15:
        raw, lost = (mutated_text(raw, rng) if csv else flipped(raw, rng)), False
    if rng.random() < 0.05:
        raw, lost = raw[: int(rng.integers(len(raw) + 1))], False
    return raw, lost


def _name(columns: dict[str, Any], rng: np.random.Generator) -> str:
    names = list(columns)
    return names[int(rng.integers(len(names)))] if names else "t"


def _dropped(columns: dict[str, Any], required: tuple[str, ...], rng: np.random.Generator
             ) -> tuple[dict[str, Any], bool]:
    if rng.random() < 0.6:
        name = required[int(rng.integers(len(required)))]
        columns.pop(name, None)
        return columns, True
    name, new = _name(columns, rng), ("q_0", "q_99", "Q_1", "", "t ", "tau_7", "fx", "payload")[rng.integers(8)]
    return {(new if key == name else key): values for key, values in columns.items()}, False


def _values(columns: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    name = _name(columns, rng)
    values = np.array(columns.get(name, [0.0]), dtype=float)
    if len(values) == 0:
        return columns
    k = rng.integers(0, len(values), max(1, int(len(values) * rng.choice([0.0, 0.01, 0.04, 0.3, 1.0]))))
    what = int(rng.integers(8))
    if what == 0:
        values[k] = rng.choice([np.nan, np.inf, -np.inf])
    elif what == 1:
        values[k] += rng.choice([0.5, -3.0, 1e3, 1e6, 1e300])
    elif what == 2:
        values[:] = rng.choice([0.0, 1.0, -1e-300, 1e12, np.nan])
    elif what == 3:
        values *= rng.choice([-1.0, 0.0, 1e-30, 1e-6, 57.29577951308232, 1e6, 1e200])
    elif what == 4:
        values = rng.permutation(values)
    elif what == 5:
        values = rng.normal(size=len(values)) * rng.choice([1e-6, 1.0, 1e3])
    elif what == 6:
        values = np.array(columns[_name(columns, rng)], dtype=float)
    else:
        values[len(values) // 2:] += rng.choice([0.05, 3.0, -100.0])
    columns[name] = values
    return columns


def _times(columns: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    if "t" not in columns or len(columns["t"]) < 4:
        return columns
    t = np.array(columns["t"], dtype=float)
    k = int(rng.integers(1, len(t)))
    t = (lambda: np.concatenate([t[:k], t[k:] - 2.0]), lambda: np.concatenate([t[:k], t[k:] + 3600.0]),
         lambda: np.concatenate([t[:k], t[k:] + 172_800.0]), lambda: t[::-1].copy(), lambda: 1e3 * t, lambda: 1e-3 * t,
         lambda: 0.0 * t, lambda: t + 1.7e9, lambda: np.round(t, 1), lambda: np.sort(t[-1] * rng.random(len(t))),
         lambda: np.concatenate([t[:k], t[k:] + 30.0]), lambda: t * rng.choice([0.01, 20.0, 1e9]))[rng.integers(12)]()
    return {**columns, "t": t}


def _rows(columns: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    count = len(next(iter(columns.values()))) if columns else 0
    keep = int(rng.choice([0, 1, 2, 5, 30, 99, 120, max(count - 1, 0)]))
    if rng.random() < 0.3 and count:
        order = rng.permutation(count)
        return {name: values[order] for name, values in columns.items()}
    return {name: values[:keep] for name, values in columns.items()}


def _types(columns: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    name = _name(columns, rng)
    values = columns.get(name, np.zeros(3))
    with np.errstate(all="ignore"):
        columns[name] = (
            lambda: values > 0, lambda: np.nan_to_num(values).astype(np.int8), lambda: values.astype(np.float16),
            lambda: np.array([str(v) for v in values], dtype=object),
            lambda: np.array(["x"] * len(values), dtype=object),
            lambda: pd.to_datetime(np.arange(len(values))), lambda: np.array([None] * len(values), dtype=object),
            lambda: np.array([b"\xff"] * len(values), dtype=object))[rng.integers(8)]()
    return columns


def csv_bytes(columns: dict[str, Any]) -> bytes:
    return pd.DataFrame(columns).to_csv(index=False).encode()


def _parquet(columns: dict[str, Any], meta: bytes) -> bytes:
    table = pa.Table.from_pandas(pd.DataFrame(columns), preserve_index=False)
    out = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({"ideal_robot": meta}), out)
    return out.getvalue()


EXTREMES = ('""', "0", "-1", "1e-12", "1e-320", "1e308", "-1e308", "inf", "nan", "1000000",
            "9223372036854775807", "360",
            f'"{"x" * 3000}"', "[]", "[1.0]", "[0.0, 0.0, 0.0]", "[1e308, 1e308, 1e308]", "[[0.0, 0.0]]",
            "[[0.0, 0.0], [0.0, 0.0]]", "{}", "{a = 1}", '"ü\\u202e"', "true", "false", "1979-05-27", '"/dev/zero"',
            '"../../etc/passwd"')
"""What keys of scenes are set to."""
JSON_EXTREMES = (None, True, "", "x" * 3000, [], {}, -1, 0, 1e-320, 1e308, -1e308, 10**400, [1], [[1, 2]], {"a": 1},
                 float("nan"), float("inf"))
"""What values of models are set to."""


def with_key(text: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """A scene's text with one key, of the world too, set to one of ``EXTREMES``.

    Args:
        text: of a scene whose tables have no tables of their own.
        kind: of the scene.
        rng: draws key and value.
    """
    from scenes.schema import scene_keys, world_keys

    keys = [key for key in (*scene_keys(kind), *world_keys()) if key.name != "kind"]
    key = keys[int(rng.integers(len(keys)))]
    line = f"{key.name} = {EXTREMES[int(rng.integers(len(EXTREMES)))]}\n"
    top, *tables = re.split(r"(?m)^(?=\[)", text.decode())
    places = [i for i, table in enumerate(tables) if table.startswith(f"[{key.table}]")]
    written = re.compile(rf"(?m)^{re.escape(key.name)} = .*\n")
    if not key.table:
        top = line + written.sub("", top)
    elif places:
        tables[places[0]] = written.sub("", tables[places[0]]) + line
    else:
        tables.append(f"[{key.table}]\n{line}")
    return "".join([top, *tables]).encode()


def with_value(text: bytes, rng: np.random.Generator) -> bytes:
    """A JSON file with one value, list or table of it set to one of ``JSON_EXTREMES``, or taken away.

    Args:
        text: of a JSON object.
        rng: draws the place, a level down at a time, and the value.
    """
    whole = json.loads(text)
    inside: Any = whole
    while True:
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        key = keys[int(rng.integers(len(keys)))]
        if not (isinstance(inside[key], (dict, list)) and inside[key] and rng.random() < 0.7):
            break
        inside = inside[key]
    which = int(rng.integers(len(JSON_EXTREMES) + 1))
    if which == len(JSON_EXTREMES):
        del inside[key]
    else:
        inside[key] = JSON_EXTREMES[which]
    return json.dumps(whole).encode()
