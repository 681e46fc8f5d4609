"""Makes the numbers that README and pages publish anew, and says which differ: ``make docs-figures``.

``docs/numbers.toml`` says for each table or sentence which command makes it. A study prints the page's table; of a verb
the entry says where in its JSON the numbers stand. Every command runs once, however many numbers it makes.

    python docs/published_numbers.py --list            # what there is, how long it takes, nothing is run
    python docs/published_numbers.py --quick           # what takes less than a minute
    python docs/published_numbers.py --only iso9283_1  # commands or pages with this word
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
_NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?:[eE][−-]?\d+)?")


@dataclass(frozen=True)
class Published:
    """One published number.

    Attributes:
        page: where it stands.
        what: which one it is, for people.
        text: as printed there.
        command: words behind ``ideal-robot`` that make it, or ``python …``.
        value: where it stands in the command's JSON or in what it prints, see ``value_of``.
        factor: of the JSON's unit to the page's.
        tolerance: by which it may differ, relative, beside the rounding of what is printed.
        quick: whether the command takes less than a minute.
    """

    page: str
    what: str
    text: str
    command: str
    value: str
    factor: float
    tolerance: float
    quick: bool

    def holds(self, found: float) -> bool:
        """Whether a number made anew is the published one."""
        if not math.isfinite(found):
            return False
        decimals = len(self.text.partition(".")[2])
        return abs(found - self.number) <= self.tolerance * abs(self.number) + 0.5001 * 10.0**-decimals

    @property
    def number(self) -> float:
        """The printed number."""
        return float(self.text.replace("−", "-"))


def published(table: Path = ROOT / "docs" / "numbers.toml", root: Path = ROOT) -> list[Published]:
    """All numbers of the table, read from their pages; ValueError with the entry that a page does not have."""
    entries = tomllib.loads(table.read_text(encoding="utf-8"))
    return [number for entry in entries["entry"] for number in _numbers(entry, root)]


def _numbers(entry: dict[str, Any], root: Path) -> Iterator[Published]:
    page = (root / entry["page"]).read_text(encoding="utf-8")
    shared = {"page": entry["page"], "command": entry["command"], "tolerance": entry.get("tolerance", 0.02),
              "quick": entry.get("quick", False)}
    if "values" not in entry and "printed" not in entry:
        yield from _whole_table(entry, page, shared)
        return
    # A regular expression for what is printed begins with ~ from here on.
    values = entry["values"] if "values" in entry else [f"~{pattern}" for pattern in entry["printed"]]
    factors = entry.get("factors", [1.0] * len(values))
    for label, key, text in _places(entry, page):
        numbers = _NUMBER.findall(text)
        if len(numbers) < len(values):
            raise ValueError(f"{entry['page']}: {label!r} has {len(numbers)} numbers of {len(values)}")
        for i, (value, factor) in enumerate(zip(values, factors, strict=True)):
            yield Published(what=f"{label} ({i + 1})" if len(values) > 1 else label, text=numbers[i],
                            value=value.replace("{row}", key), factor=factor, **shared)


def _whole_table(entry: dict[str, Any], page: str, shared: dict[str, Any]) -> Iterator[Published]:
    """Every number of a table that its command prints as it stands there; ``columns`` and ``rows`` choose.

    With ``first`` only the first number of each cell: what stands behind it in brackets is from elsewhere.
    """
    most = 1 if entry.get("first", False) else None
    for title, cells in _table(page, entry["header"], entry["page"]):
        if not any(title.startswith(begin) for begin in entry.get("rows", [""])):
            continue
        for column in entry.get("columns", range(1, len(cells))):
            for i, text in enumerate(_NUMBER.findall(cells[column])[:most]):
                yield Published(what=f"{title[:30]} ({column})", text=text, factor=1.0,
                                value="|".join(["", entry["header"].strip("| "), title, str(column), str(i)]), **shared)


def _table(text: str, header: str, where: str) -> list[tuple[str, list[str]]]:
    """Rows of the table that begins so, each with its title; a title that comes again has its number behind it."""
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.strip("| ").startswith(header.strip("| "))
                  and line.startswith("|")), None)
    if first is None:
        raise ValueError(f"{where}: there is no table {header!r}")
    rows: list[tuple[str, list[str]]] = []
    for line in lines[first + 2:]:
        if not line.startswith("|"):
            break
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        again = sum(title.partition("#")[0] == cells[0] for title, _ in rows)
        rows.append((f"{cells[0]}#{again}" if again else cells[0], cells))
    return rows


def _places(entry: dict[str, Any], page: str) -> Iterator[tuple[str, str, str]]:
    """Label, key of the row and the text with the numbers: cells of a table, or a sentence's groups."""
    if "sentence" in entry:
        match = re.search(entry["sentence"], page)
        if match is None:
            raise ValueError(f"{entry['page']}: there is no {entry['sentence']!r}")
        yield entry["sentence"][:40], "", " ".join(match.groups())
        return
    rows = dict(_table(page, entry["header"], entry["page"]))
    for begin, key in entry["rows"].items():
        label = next((label for label in rows if label.startswith(begin)), None)
        if label is None:
            raise ValueError(f"{entry['page']}: the table {entry['header']!r} has no row {begin!r}")
        columns = entry.get("columns", [entry.get("column", 1)])
        yield f"{label[:30]}", key, " ".join(rows[label][i] for i in columns)


def value_of(content: Any, path: str) -> float:
    """A number out of a command's JSON.

    ``a.b.0.c`` goes down by keys and places in lists, ``runs[speed=0.7].x`` to all entries of a list with this value,
    ``*`` to all; ``max(…)``, ``min(…)`` and ``mean(…)`` make one number of several. ``~…`` is a regular expression
    whose group is the number in what was printed; ``|header|title|column|place`` a number of a printed table.
    """
    if path.startswith("|"):
        header, title, column, place = path[1:].rsplit("|", 3)
        cells = dict(_table(content["printed"], header, "what is printed")).get(title, [])
        texts = _NUMBER.findall(cells[int(column)]) if int(column) < len(cells) else []
        return float(texts[int(place)].replace("−", "-")) if int(place) < len(texts) else float("nan")
    if path.startswith("~"):
        match = re.search(path[1:], content["printed"])
        if match is None:
            raise ValueError(f"nothing printed is like {path[1:]}")
        return float(match[1])
    reduced = re.fullmatch(r"(max|min|mean)\((.*)\)", path)
    values = [content]
    for part in re.findall(r"[^.\[\]]+(?:\[[^\]]*\])?", reduced[2] if reduced else path):
        name, _, chosen = part.partition("[")
        values = [deeper for value in values for deeper in _deeper(value, name)]
        if chosen:
            key, _, wanted = chosen.rstrip("]").partition("=")
            values = [entry for value in values for entry in value if str(entry.get(key)) == wanted]
    numbers = [float("nan") if value is None else float(value) for value in values]
    if reduced and numbers:
        return {"max": max, "min": min, "mean": lambda x: sum(x) / len(x)}[reduced[1]](numbers)
    if len(numbers) != 1:
        raise ValueError(f"{path} is {len(numbers)} numbers")
    return numbers[0]


def _deeper(value: Any, name: str) -> list[Any]:
    if name == "*":
        return list(value.values()) if isinstance(value, dict) else list(value)
    return [value[int(name)] if isinstance(value, list) else value[name]]


def made(command: str, folder: Path) -> dict[str, Any] | None:
    """The JSON of a command, or what it prints; None where it needs measured data that are not here.

    Of several in a row, with && between them, that of the last one.
    """
    if "{data}" in command and not DATA.is_dir():
        return None
    content: dict[str, Any] = {}
    answer = folder / "answer.json"
    for step in command.split(" && "):
        answer.unlink(missing_ok=True)
        words = shlex.split(step.replace("{data}", str(DATA)))
        prints = words[0] == "python"
        words = words[1:] if prints else ["-m", "scenes.cli", *words, "--json", str(answer)]
        done = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True,
                              check=False, env={**os.environ, "PYTHONPATH": str(ROOT)})
        if done.returncode != 0 or not (prints or answer.is_file()):
            raise RuntimeError(f"{typed(step)}: {done.stderr.strip()[-500:]}")
        content = {"printed": done.stdout} if prints else json.loads(answer.read_text(encoding="utf-8"))
    return content


def typed(command: str) -> str:
    """A command as a person types it."""
    return " && ".join(step if step.startswith("python ") else f"ideal-robot {step}" for step in command.split(" && "))


def compare(numbers: Sequence[Published]) -> Iterator[tuple[Published, float | None, str]]:
    """Each number with the one made anew (None where it could not be made) and a word: same, differs, not made."""
    for command in dict.fromkeys(number.command for number in numbers):
        print(f"{typed(command)} …", file=sys.stderr, flush=True)
        mine = [number for number in numbers if number.command == command]
        with tempfile.TemporaryDirectory() as folder:
            try:
                content = made(command, Path(folder))
            except RuntimeError as error:
                print(error, file=sys.stderr)
                yield from ((number, None, "failed") for number in mine)
                continue
        for number in mine:
            if content is None:
                yield number, None, "not made: measured data are missing"
                continue
            value = number.factor * value_of(content, number.value)
            yield number, value, "same" if number.holds(value) else "DIFFERS"


def main(words: Sequence[str] | None = None) -> int:
    """Prints every number beside the published one; 1 if any differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="say which numbers there are, run nothing")
    parser.add_argument("--quick", action="store_true", help="only commands that take less than a minute")
    parser.add_argument("--only", default="", help="only commands and pages with this word")
    arguments = parser.parse_args(words)
    numbers = [number for number in published() if (number.quick or not arguments.quick)
               and (arguments.only in number.command or arguments.only in number.page)]
    if arguments.list:
        for number in numbers:
            print(f"{number.page}: {number.what}: {number.text}  ({typed(number.command)})")
        return 0
    wrong = 0
    for number, value, word in compare(numbers):
        print(f"{word:8} {number.page}: {number.what}: published {number.text}, now "
              + ("–" if value is None else f"{value:.4g}") + f"  ({typed(number.command)})", flush=True)
        wrong += word in ("DIFFERS", "failed")
    print(f"{len(numbers)} numbers, {wrong} differ")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
