"""Who may import whom: the table of docs/architecture.md, checked on the code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_import_rules_hold() -> None:
    program = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


def test_importing_the_packages_is_cheap() -> None:
    """Importing a package must not pull in plotting, PyBullet or the command line."""
    program = (
        "import sys, ideal_robot, sensing, planning, sim, scenes;"
        "heavy = {'matplotlib', 'pybullet', 'typer', 'numba', 'cv2', 'pandas', 'cvxpy'} & set(sys.modules);"
        "raise SystemExit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
