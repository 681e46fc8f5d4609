"""The project's folders."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
"""Public data sets, where they lie beside the checkout."""
MODELS = ROOT / "scenes" / "models"
"""Shipped models."""
