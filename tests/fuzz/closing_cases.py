"""Fuzzed calls of the verbs that play a scene to learn its model: ``close-loop`` and ``prepare``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz import mutate_text, originals, set_key
from tests.fuzz.case import Case, Maker

CLOSE_FORCE = originals.FORCE + b"[assumed]\nelasticity_ratio = 1.5\nelasticity_estimated = false\n"
CLOSE_CLAMPED = b"""kind = "close_clamped"
title = "clamped once"
robot = "kr15"
speed = 0.5
seed = 1
[path]
shape = "circle"
size_mm = 60.0
centre = [1.05, 0.0, 0.95]
tilt_deg = 45.0
[clamp]
most = 1
push = "joints"
[world]
stiffness = [4.5e5, 2.2e5, 2.6e5, 4.5e4, 4.5e4, 2.0e4]
"""
CLOSED = {"path": originals.PATH, "line": originals.LINE, "clamped": originals.CLAMPED, "close_clamped": CLOSE_CLAMPED}
"""Scenes in which there is nothing to be found, so that as they stand they are refused; the last plays in seconds."""
OWN = originals.PATH.replace(b'robot = "kr15"', b'robot = "arm.urdf"')
PREPARE = ["prepare", "s.toml", "--json", "j.json", "--out", "o.json"]


def _close(rng: np.random.Generator, folder: Path) -> Case:
    """A scene whose model lacks something, broken in its text, or with one key set to something extreme."""
    # A surface takes a quarter of a minute where nothing is wrong with the scene: now and then.
    kind = "force" if rng.random() < 0.1 else tuple(CLOSED)[rng.integers(len(CLOSED))]
    text = CLOSED.get(kind, CLOSE_FORCE)
    broken = mutate_text.mutated(text, rng) if rng.random() < 0.5 else set_key.with_key(text, kind, rng)
    return Case(f"close-loop {kind} scene", ["close-loop", "s.toml", "--out", "o", "--json", "j.json"],
                {"s.toml": broken})


def _prepare(rng: np.random.Generator, folder: Path) -> Case:
    """An arm of one's own whose scene, URDF or data are broken before it is prepared."""
    files = {"arm.urdf": originals.URDF, "arm.toml": originals.DATA, "s.toml": OWN}
    name = tuple(files)[rng.integers(len(files))]
    extreme = name == "s.toml" and rng.random() < 0.5
    files[name] = set_key.with_key(OWN, "path", rng) if extreme else mutate_text.mutated(files[name], rng)
    return Case(f"prepare {name[2:] if name == 's.toml' else name}", PREPARE, files)


CLOSING: dict[str, tuple[Maker, float]] = {"close": (_close, 0.6), "prepare": (_prepare, 0.4)}
"""Kinds of cases: what makes one, and how often it is drawn in comparison."""


def sound() -> list[Case]:
    """Calls with sound files."""
    return [Case("prepare", PREPARE, {"arm.urdf": originals.URDF, "arm.toml": originals.DATA, "s.toml": OWN}),
            Case("close-loop", ["close-loop", "s.toml", "--out", "o", "--json", "j.json"], {"s.toml": CLOSE_FORCE})]
