"""Fuzzed calls of the verbs that work with devices: ``follow``, ``simulate``, a live view. No device is there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from scenes.online.journal import META, ROWS
from tests.fuzz import binary_originals, mutate_text, originals, set_key
from tests.fuzz.case import Case, Maker
from tests.fuzz.further_cases import RSI_XML, calibration

SCENES = {kind: originals.SCENES[kind].replace(b'method = "none"', b'method = "ideal"') for kind in ("line", "force")}
NOBODY = ["--arm", "rsi://127.0.0.1:41999", "--wait", "0.1", "--out", "o", "--json", "j.json"]
SERVE = ["--serve", "--arm", "rsi://127.0.0.1:9", "--camera-port", "0", "--force-port", "0"]
ADDRESSES = ("", "rsi://", "rsi://:", "rsi://127.0.0.1:99999", "rsi://[::1", "rtde://127.0.0.1:1", "rtde://", "usb:x",
             "usb:99", "usb:-1", "file:", "file:f.avi", "file:/dev/zero", "file:absent.mp4", "stream://127.0.0.1:1",
             "stream://", "stream://x y:1", "genicam:", "genicam:x.cti#1", "netft://127.0.0.1:1?rate=0",
             "netft://127.0.0.1?rate=nan&counts_force=0", "netft://127.0.0.1:1?rate=7000&counts_force=1e999",
             "rtsp://127.0.0.1:1/x", "http://127.0.0.1:1/x.mjpg", "\u202e", "x" * 5000, "a\nb", "[/red]", "://",
             "rsi:1")


def _broken(rng: np.random.Generator) -> tuple[str, bytes]:
    kind = tuple(SCENES)[rng.integers(len(SCENES))]
    return kind, (mutate_text.mutated(SCENES[kind], rng) if rng.random() < 0.5 else
                  set_key.with_key(SCENES[kind], kind, rng))


def _follow(rng: np.random.Generator, folder: Path) -> Case:
    """A broken scene, calibration, RSI configuration or film."""
    kind, scene = _broken(rng)
    files = {"s.toml": scene, "c.json": calibration(), "rsi.xml": RSI_XML, "f.avi": binary_originals.film()}
    name = tuple(files)[rng.integers(len(files))]
    if name != "s.toml":
        files["s.toml"], files[name] = SCENES[kind], mutate_text.mutated(files[name], rng)
    # A film is opened by a process of its own, which takes its time to start.
    patience = ["--wait", "4"] if kind == "line" and name == "f.avi" else []
    sensor = ["--camera", "file:f.avi"] if kind == "line" else ["--force", "netft://127.0.0.1:1?rate=7000"]
    return Case(f"follow {kind}, {name}", ["follow", "s.toml", *NOBODY, *sensor, "--calibration", "c.json",
                                           "--rsi-config", "rsi.xml", *patience], files, must_fail=True)


def _addresses(rng: np.random.Generator, folder: Path) -> Case:
    arm, camera, force = (ADDRESSES[rng.integers(len(ADDRESSES))] for _ in range(3))
    kind = tuple(SCENES)[rng.integers(len(SCENES))]
    options = (["--arm", arm], ["--camera", camera], ["--force", force])
    chosen = [word for option in options if rng.random() < 0.5 for word in option]
    return Case("follow addresses", ["follow", "s.toml", *NOBODY, "--camera", "file:f.avi", "--force",
                                     "netft://127.0.0.1:1?rate=7000", *chosen],
                {"s.toml": SCENES[kind], "f.avi": binary_originals.film()}, must_fail=True)


def _simulate(rng: np.random.Generator, folder: Path) -> Case:
    """A broken scene behind devices to which nobody comes; then Ctrl-C."""
    kind, scene = _broken(rng)
    return Case(f"simulate {kind} scene", ["simulate", "s.toml", *SERVE, "--json", "j.json"], {"s.toml": scene},
                interrupted=2.0)


def _live(rng: np.random.Generator, folder: Path) -> Case:
    """A run that goes on whose journal is broken, seen for a second."""
    meta = json.dumps({"robot": "kr6", "cycle_time": 0.012, "scene": "s", "method": "ideal",
                       "gain": [1.0] * 6}).encode()
    rows = rng.normal(size=(50, 26)) * rng.choice([1e-3, 1.0, 1e300])
    rows[:, 1] = 0.012 * np.arange(50)
    raw = rows.tobytes()
    if rng.random() < 0.5:
        meta = mutate_text.mutated(meta, rng) if rng.random() < 0.5 else set_key.with_value(meta, rng)
    else:
        raw = mutate_text._bytes(raw, rng) if rng.random() < 0.5 else raw[: int(rng.integers(len(raw) + 1))]
    scene = SCENES["line"] if rng.random() < 0.7 else _broken(rng)[1]
    return Case("view live", ["view", "s.toml", "--live", "run"],
                {"s.toml": scene, f"run/{META}": meta, f"run/{ROWS}": raw}, interrupted=2.0)


DEVICES: dict[str, tuple[Maker, float]] = {
    "follow": (_follow, 1.5), "addresses": (_addresses, 0.5), "simulate": (_simulate, 0.5), "live": (_live, 0.5),
}
"""Kinds of cases: what makes one, and how often it is drawn in comparison."""


def sound() -> list[Case]:
    """Calls with sound files; those of ``follow`` fail as no arm comes."""
    return [Case("follow line", ["follow", "s.toml", *NOBODY, "--camera", "file:f.avi"],
                 {"s.toml": SCENES["line"], "f.avi": binary_originals.film()}, must_fail=True),
            Case("follow force", ["follow", "s.toml", *NOBODY, "--force", "netft://127.0.0.1:1?rate=7000"],
                 {"s.toml": SCENES["force"]}, must_fail=True)]
