"""Five commands make arms ideal that others simulate: as a user types them, to what was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.five_commands import ARMS, chain


@pytest.mark.slow
@pytest.mark.parametrize(("name", "package", "most"), [("crx", "airo_fanuc", 0.8), ("rsi", "ideal_robot", 0.3)])
def test_five_commands_leave_what_was_asked_for(name: str, package: str, most: float, tmp_path: Path) -> None:
    pytest.importorskip(package)
    done = chain(ARMS[name], tmp_path, "path", seed=2, period=20.0)
    assert done["before"]["joints"] > 5.0
    assert done["after"]["joints"] < most
    # What precorrect expects is what is left, within a factor of two.
    assert 0.5 < done["after"]["joints"] / done["expected"] < 2.0
