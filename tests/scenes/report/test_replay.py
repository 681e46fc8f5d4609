"""The replay in a page: what it holds, and that it moves in a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes.report.replay import FRAMES, Replay, link_poses, polygons

ROBOT = Robot.load("kr6")


def _replay(n: int = 1000, script: str = "") -> Replay:
    t = np.linspace(0.0, 4.0, n)
    q = ROBOT.home + 0.2 * np.sin(t)[:, None]
    pose = ROBOT.fk()
    tool = np.array([pose(row).translation for row in q])
    error = np.where(t > 1.0, 0.1 + 0.05 * np.sin(9.0 * t), np.nan)
    return Replay(ROBOT, t, q, tool, tool + np.array([0.0, 1e-4, 0.0]), error, error_name=f"distance{script}",
                  curves={"line": tool})


def _data(html: str) -> dict[str, object]:
    found = re.search(r"const DATA = (.*);\n", html)
    assert found is not None
    data: dict[str, object] = json.loads(found[1].replace("<\\/", "</"))
    return data


def test_a_long_run_is_thinned_out_and_stays_small() -> None:
    html = _replay(20000).html()
    data = _data(html)
    assert len(data["t"]) <= FRAMES  # type: ignore[arg-type]
    assert len(html) < 2_000_000


def test_links_stand_where_pinocchio_has_them() -> None:
    shapes, links = polygons(ROBOT)
    poses = link_poses(ROBOT, ROBOT.home[None, :], links)
    tool = ROBOT.fk()(ROBOT.home).translation
    last = max(shape["link"] for shape in shapes)
    corners = np.array([corner for shape in shapes if shape["link"] == last for face in shape["faces"]
                        for corner in face])
    placed = corners @ poses[0, last, :9].reshape(3, 3).T + poses[0, last, 9:]
    assert np.min(np.linalg.norm(placed - tool, axis=1)) < 0.15


def test_an_arm_without_shapes_is_drawn_as_rods(tmp_path: Path) -> None:
    text = re.sub(r"<visual>.*?</visual>", "", ROBOT.urdf.read_text(encoding="utf-8"), flags=re.S)
    (tmp_path / "bare.urdf").write_text(text, encoding="utf-8")
    shapes, _ = polygons(Robot.load(tmp_path / "bare.urdf"))
    assert len(shapes) >= 4


def test_names_cannot_end_the_script() -> None:
    html = _replay(50, "</script><script>alert(1)</script>").html()
    assert html.count("</script>") == 1


def test_arrays_of_other_lengths_are_refused() -> None:
    good = _replay(50)
    with pytest.raises(InputError, match="error"):
        Replay(ROBOT, good.t, good.q, good.tool, good.wanted, good.error[:-1])


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a headless Chromium")
def test_it_moves_in_a_browser(tmp_path: Path) -> None:
    """The slider moves the arm: the canvas changes, and the frame shown follows."""
    page = tmp_path / "page.html"
    page.write_text(f"""<!DOCTYPE html><meta charset="utf-8">{_replay(100).html()}<pre id="said"></pre><script>
const canvas = document.querySelector("canvas"), slider = document.querySelector("input[type=range]");
const before = canvas.toDataURL(); slider.value = 10; slider.dispatchEvent(new Event("input"));
document.getElementById("said").textContent = JSON.stringify({{moved: canvas.toDataURL() !== before,
  frame: document.querySelector(".replay").dataset.frame, blank: before.length < 5000}});</script>""", encoding="utf-8")
    done = subprocess.run(["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
                           "--no-first-run", "--disable-background-networking", "--disable-component-update",
                           "--disable-sync", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()],
                          capture_output=True, text=True, timeout=120, check=False)
    found = re.search(r'<pre id="said">(.*?)</pre>', done.stdout)
    assert found is not None, done.stderr
    assert json.loads(found[1]) == {"moved": True, "frame": "10", "blank": False}
