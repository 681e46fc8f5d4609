"""The page of a run on devices while it goes on."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from scenes.follow.journal import Journal, remove
from tests.browser import chromium, needs_chromium

pytest.importorskip("viser")
KR6 = Robot.load("kr6")


def ran(journal: Journal, cycles: range) -> None:
    for k in cycles:
        q = KR6.home + 0.004 * k * np.array([1.0, 0, 0, 0, 0, 0])
        journal.add(0.012 * k, RobotState(0.012 * (k + (k > 50)), q, np.zeros(6)), q + 0.001, q)


def test_the_page_follows_the_journal_and_says_how_it_ended(tmp_path: Path) -> None:
    from scenes.view.live import watch

    page = watch(KR6, tmp_path, 8090, {})
    try:
        page.update()
        assert "waiting" in page.state
        journal = Journal(tmp_path, KR6, {"scene": "seam", "method": "ideal"})
        ran(journal, range(100))
        page.update()
        assert "seam" in page.state
        assert "100 cycles of 12 ms, 1 lost" in page.state
        assert "1.00 mrad" in page.state
        page._grown -= 5.0
        page.update()
        assert "no new cycle for 5 s" in page.state
        ran(journal, range(100, 140))
        page.update()
        assert "140 cycles" in page.state
        journal.close()
        remove(tmp_path)
        (tmp_path / "report.json").write_text(json.dumps(
            {"scene": "seam", "method": "ideal", "failure": "stopped by the user", "cycles": 140, "report": "r.html"}))
        page.update()
        assert "stopped by the user" in page.state
    finally:
        page.viewer.server.stop()


@pytest.mark.parametrize("change", [{"cycle_time": {"a": 1}}, {"cycle_time": 1e-320}, {"cycle_time": 0},
                                    {"cycle_time": 10**400}, {"gain": [1.0] * 3}])
def test_a_journal_that_is_none_of_the_arm_is_waited_out(change: dict[str, Any], tmp_path: Path) -> None:
    from scenes.view.live import watch

    journal = Journal(tmp_path, KR6, {"scene": "seam", "method": "ideal"})
    ran(journal, range(100))
    meta = json.loads((tmp_path / "journal.json").read_text())
    (tmp_path / "journal.json").write_text(json.dumps({**meta, **change}))
    page = watch(KR6, tmp_path, 8092, {})
    try:
        page.update()
        assert "waiting" in page.state
    finally:
        page.viewer.server.stop()


@needs_chromium
def test_the_arm_its_way_and_the_words_are_seen(tmp_path: Path) -> None:
    from scenes.view.live import watch

    page = watch(KR6, tmp_path, 8091, {"reference": np.array([[0.5, -0.5, 0.3], [0.9, 0.5, 0.3]])})
    journal = Journal(tmp_path, KR6, {"scene": "seam", "method": "ideal"})
    ran(journal, range(200))
    try:
        page.update()
        with chromium(tmp_path) as browser:
            browser.open(f"http://127.0.0.1:{page.viewer.port}/", 1000, 900)
            until = time.monotonic() + 90.0
            while True:
                picture = browser.picture().astype(int)
                arm = (picture[..., 0] - picture[..., 2] > 30).sum()
                way = (np.abs(picture - np.array([0, 110, 190])).max(axis=2) < 40).sum()
                if (arm > 1000 and way > 50) or time.monotonic() > until:
                    break
                time.sleep(0.5)
            said = browser.value("document.body.innerText")
    finally:
        page.viewer.server.stop()
        journal.close()
    assert arm > 1000
    assert way > 50
    assert "running" in said
    assert "200 cycles of 12 ms" in said
