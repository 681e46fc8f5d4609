"""Examples in docstrings say what the program does."""

from __future__ import annotations

import doctest
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes", "trials")
MODULES = [".".join(path.relative_to(ROOT).with_suffix("").parts) for package in PACKAGES
           for path in sorted((ROOT / package).rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_hold(name: str) -> None:
    module = importlib.import_module(name)
    written = len(re.findall(r"^\s*>>> ", Path(str(module.__file__)).read_text(encoding="utf-8"), flags=re.MULTILINE))
    done = doctest.testmod(module)
    assert done.failed == 0
    # An example that is not found, behind a decorator say, would never be run.
    assert done.attempted == written


def test_each_package_that_users_import_has_examples() -> None:
    assert {name.partition(".")[0] for name in MODULES} >= {"ideal_robot", "sensing", "sim", "scenes"}
    assert len(MODULES) >= 10
