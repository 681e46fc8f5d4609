"""The documentation site is built without a warning, and holds tutorial, scene keys and API."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    words = ["-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(tmp_path / "site")]
    done = subprocess.run([sys.executable, *words],
                          cwd=ROOT, capture_output=True, text=True, check=False,
                          env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    pages = {str(path.relative_to(tmp_path / "site")) for path in (tmp_path / "site").rglob("index.html")}
    assert {"index.html", "tutorial/index.html", "scene_keys/index.html"} <= pages
    api = (tmp_path / "site" / "api" / "ideal_robot.friction" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'id="ideal_robot\.friction\.laws\.Arctan"', api)
    # Nothing is fetched from elsewhere when a page is read.
    first = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="https?://', first)
