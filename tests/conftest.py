"""Settings of all tests, and the part of the slow ones that a continuous integration has time for."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import pytest
from hypothesis import settings

# The first call of a compiled function takes seconds; and a run of the tests must mean the same for everyone.
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds ``--part``."""
    parser.addoption("--part", default="", help="k/n: every n-th test, from the k-th on, in an order of its own")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what is not in the part."""
    if share := config.getoption("--part"):
        part, parts = map(int, share.split("/"))
        left_out = [item for item in items if not in_part(item.nodeid, part, parts)]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """Puts aside what was loaded: a collection that looks at all of it takes half a second, and it stays anyway."""
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def in_part(name: str, part: int, parts: int) -> bool:
    """Whether a test is in a part: always in the same one, whatever other tests there are."""
    return crc32(name.encode()) % parts == part % parts


class Ended(NamedTuple):
    """How a call of the program ended: exit code, standard output and error."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """Lines of standard error that say something."""
        return [line for line in self.err.splitlines() if line.strip()]


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
            ) -> Callable[..., Ended]:
    """``ideal-robot`` in this process, called with words in the test's own folder."""
    from scenes import cli

    # The verb's answer to SIGTERM is not to become that of the tests.
    monkeypatch.setattr(cli.signal, "signal", lambda number, handler: None)
    monkeypatch.chdir(tmp_path)

    def called(*words: str) -> Ended:
        monkeypatch.setattr(sys, "argv", ["ideal-robot", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return Ended(int(ended.value.code or 0), *capfd.readouterr())

    return called
