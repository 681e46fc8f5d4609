"""Compiled code that is damaged, or cannot be kept, costs a compilation and nothing else."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.caching import IndexDataCacheFile

SOURCE = """
from ideal_robot.jit import jit

@jit()
def doubled(x):
    return 2 * x
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    # Python's own bytecode tells versions of a source of equal size by the second.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    path = tmp_path / "compiled_here.py"
    path.write_text(SOURCE, encoding="utf-8")
    return path


def loaded(source: Path) -> ModuleType:
    """The module as a process of its own would see it."""
    spec = importlib.util.spec_from_file_location("compiled_here", source)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def hits(module: ModuleType) -> int:
    return sum(module.doubled.stats.cache_hits.values())


def kept(source: Path) -> list[Path]:
    return sorted((source.parent / "__pycache__").glob("*.nbc"))


def refuse(*_: Any, **__: Any) -> Any:
    raise PermissionError(13, "Permission denied")


def test_compiled_code_is_kept_and_each_signature_has_a_file(source: Path) -> None:
    first = loaded(source)
    assert (first.doubled(3), first.doubled(1.5)) == (6, 3.0)
    assert len(kept(source)) == 2
    again = loaded(source)
    assert (again.doubled(4), hits(again)) == (8, 1)


@pytest.mark.parametrize("damaged", [
    lambda raw: b"", lambda raw: raw[:20], lambda raw: raw[: len(raw) // 2], lambda raw: raw[:-1],
    lambda raw: raw[:-40] + bytes([raw[-40] ^ 1]) + raw[-39:], lambda raw: bytes(len(raw))])
def test_damaged_code_is_compiled_again_and_mended(source: Path, damaged: Callable[[bytes], bytes]) -> None:
    loaded(source).doubled(3)
    path, = kept(source)
    sound = path.read_bytes()
    path.write_bytes(damaged(sound))
    module = loaded(source)
    assert (module.doubled(5), hits(module)) == (10, 0)
    again = loaded(source)
    assert (again.doubled(6), hits(again)) == (12, 1)


def test_code_of_another_version_of_the_source_does_not_count(source: Path) -> None:
    loaded(source).doubled(3)
    source.write_text(SOURCE.replace("2 * x", "3 * x"), encoding="utf-8")
    assert loaded(source).doubled(3) == 9
    assert len(kept(source)) == 1


@pytest.mark.parametrize("altered", [
    lambda text: text.replace("SCALE = 2", "SCALE = 3"), lambda text: text.replace("[1.0, 2.0]", "[1.0, 3.0]"),
    lambda text: text.replace("x + 1", "x + 2"), lambda text: text.replace("kind=3", "kind=4")])
def test_code_made_with_what_another_file_names_ends_with_it(source: Path, altered: Callable[[str], str]) -> None:
    """A number, a table, a function and a default of another file are in the machine code of the one that uses them."""
    other = source.with_name("numbers_of_theirs.py")
    text = ("import numpy as np\nfrom ideal_robot.jit import jit\nSCALE = 2\nTABLE = np.array([1.0, 2.0])\n"
            "@jit()\ndef further(x):\n    return x + 1\n@jit()\ndef by_kind(x, kind=3):\n    return x * kind\n")
    source.write_text("from ideal_robot.jit import jit\nfrom numbers_of_theirs import SCALE, TABLE, by_kind, further\n"
                      "@jit()\ndef doubled(x):\n    return by_kind(further(SCALE * x)) + TABLE[1]\n", encoding="utf-8")

    def anew(words: str) -> ModuleType:
        other.write_text(words, encoding="utf-8")
        sys.modules.pop("numbers_of_theirs", None)
        return loaded(source)

    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(source.parent))
        assert anew(text).doubled(3.0) == 23.0
        same, other_numbers = anew("# A line before it.\n" + text), anew(altered(text))
        assert (same.doubled(3.0), hits(same)) == (23.0, 1)
        expected = other_numbers.doubled.py_func(3.0)
        assert expected != 23.0
        assert (other_numbers.doubled(3.0), hits(other_numbers)) == (expected, 0)


def test_code_is_found_by_every_process_whatever_order_sets_of_words_have_there(source: Path) -> None:
    """Options of the compiler and numbers that a function looks in are sets; text of one has its words in any order."""
    source.write_text("from ideal_robot.jit import jit\nKINDS = frozenset({'up', 'down', 'left', 'right'})\n"
                      "@jit(fastmath={'reassoc', 'contract', 'nnan', 'ninf'})\ndef doubled(x):\n    return 2.0 * x\n"
                      "def named():\n    return KINDS, {}.get('a') in {'north', 'south', 'east', 'west'}\n",
                      encoding="utf-8")
    code = ("import compiled_here as c; from ideal_robot.jit import meaning; "
            "print(c.doubled(3.0), sum(c.doubled.stats.cache_hits.values()), meaning(c.named))")
    path = os.pathsep.join([str(source.parent), *sys.path])
    first, *others = (subprocess.run([sys.executable, "-c", code], env=os.environ | {
        "PYTHONHASHSEED": str(seed), "PYTHONPATH": path}, capture_output=True, text=True, check=True).stdout.split()
        for seed in range(1, 5))
    assert first[1] == "0"
    assert others == [[first[0], "1", first[2]]] * 3


def test_where_nothing_can_be_written_code_that_is_there_is_used(source: Path, monkeypatch) -> None:
    loaded(source).doubled(3)
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    monkeypatch.setattr(IndexDataCacheFile, "_open_for_write", refuse)
    module = loaded(source)
    assert (module.doubled(4), hits(module)) == (8, 1)
    assert (module.doubled(1.5), hits(module)) == (3.0, 1)


def test_a_disk_that_is_full_keeps_no_code_and_the_run_goes_on(source: Path, monkeypatch) -> None:
    monkeypatch.setattr(IndexDataCacheFile, "_open_for_write", refuse)
    assert loaded(source).doubled(3) == 6
    assert kept(source) == []
