"""Fuzzed calls of the verbs beside the main ones: pictures, films, bags, answers of a sweep, XML, SVG."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.results import plain
from scenes.online.camera_process import CalibratedCamera
from scenes.scene_file import load_scene
from scenes.sweep import _described, jobs
from sensing.camera.camera_model import CameraModel
from tests.fuzz import binary_originals, mutate_table, mutate_text, originals, set_key
from tests.fuzz.case import Case, Maker

SVG = b'<svg xmlns="http://www.w3.org/2000/svg"><g><path d="M 0 0 C 50 10 80 -20 100 0 L 200 10"/></g></svg>'
RSI_XML = b"""<ROOT>
<CONFIG><IP_NUMBER>192.168.1.10</IP_NUMBER><PORT>49152</PORT><SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
<SEND><ELEMENTS><ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/><ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE"
INDX="INTERNAL"/></ELEMENTS></SEND>
<RECEIVE><ELEMENTS><ELEMENT TAG="AK.A1" TYPE="DOUBLE" INDX="1" HOLDON="1"/><ELEMENT TAG="AK.A2" TYPE="DOUBLE" INDX="2"
HOLDON="1"/><ELEMENT TAG="AK.A3" TYPE="DOUBLE" INDX="3" HOLDON="1"/><ELEMENT TAG="AK.A4" TYPE="DOUBLE" INDX="4"
HOLDON="1"/><ELEMENT TAG="AK.A5" TYPE="DOUBLE" INDX="5" HOLDON="1"/><ELEMENT TAG="AK.A6" TYPE="DOUBLE" INDX="6"
HOLDON="1"/></ELEMENTS></RECEIVE>
</ROOT>
"""
LINE_OF_FILE = originals.LINE.replace(b'formula = "0.4 + 0.02*sin(2*pi*x/0.5)"\nlength = 0.2',
                                      b'svg = "a.svg"\nsvg_length = 0.2')


def _picture(rng: np.random.Generator, folder: Path) -> Case:
    """A picture with bytes of it changed, or one of an odd size."""
    ending = binary_originals.PICTURES[rng.integers(len(binary_originals.PICTURES))]
    raw = mutate_text.mutated(binary_originals.picture(ending), rng)
    if rng.random() < 0.2:
        sides = (1, 2, 7, 300, 4000, 30_000)
        ending, raw = ".png", binary_originals.blank(*(sides[k] for k in rng.integers(len(sides), size=2)))
    return Case("detect picture", ["detect", f"p{ending}", "--out", "o", "--json", "j.json", "--detector",
                                   ("edge_pairs", "opencv")[rng.integers(2)]], {f"p{ending}": raw})


def _film(rng: np.random.Generator, folder: Path) -> Case:
    return Case("detect film", ["detect", "f.avi", "--out", "o", "--json", "j.json"],
                {"f.avi": mutate_text.mutated(binary_originals.film(), rng)})


def _bag(rng: np.random.Generator, folder: Path) -> Case:
    mcap = bool(rng.integers(2))
    name = "r.mcap" if mcap else "r.db3"
    words = ["identify", name, "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o"]
    return Case(f"identify {name[2:]}", words,
                {"arm.urdf": originals.URDF, "arm.toml": originals.DATA,
                 name: mutate_text.mutated(binary_originals.bag(folder, mcap=mcap), rng)})


def _table(rng: np.random.Generator, folder: Path) -> tuple[str, bytes]:
    csv = bool(rng.random() < 0.5)
    raw, _ = mutate_table.mutated(originals.motion(folder), ("t", "q_1"), rng, csv=csv)
    return ("r.csv" if csv else "r.parquet"), raw


def _export(rng: np.random.Generator, folder: Path) -> Case:
    name, raw = _table(rng, folder)
    places = (["--mcap", "m.mcap"], ["--rosbag2", "bag"], ["--csv", "e.csv", "--parquet", "e.parquet"])
    return Case("export recording", ["export", name, *places[rng.integers(len(places))]], {name: raw})


def _shown(rng: np.random.Generator, folder: Path) -> Case:
    name, raw = _table(rng, folder)
    return Case("view recording", ["view", name, "--urdf", "arm.urdf", "--once"],
                {name: raw, "arm.urdf": originals.URDF, "arm.toml": originals.DATA})


def _replay(rng: np.random.Generator, folder: Path) -> Case:
    """A recording with the broken replay of its run beside it."""
    return Case("view replay", ["view", "r.csv", "--urdf", "arm.urdf", "--once"],
                {"r.csv": mutate_table._csv(originals.motion(folder)), "arm.urdf": originals.URDF,
                 "arm.toml": originals.DATA, "r.replay.npz": binary_originals.broken_replay(folder, rng)})


def _answers(rng: np.random.Generator, folder: Path) -> Case:
    """A sweep that goes on with a broken file of answers; nothing is left to be played where they are read."""
    lines = mutate_text.mutated(answers(), rng) if rng.random() < 0.5 else \
        b"".join(set_key.with_value(line, rng) + b"\n" for line in answers().splitlines())
    words = ["sweep", "s.toml", "--seeds", "1-2", "--processes", "1", "--lines", "l.jsonl", "--resume"]
    return Case("sweep answers", [*words, "--json", "j.json", "--csv", "t.csv"],
                {"s.toml": originals.PATH, "l.jsonl": lines})


@cache
def answers() -> bytes:
    """Lines of a sweep over two seeds of ``originals.PATH``, as the file ``s.toml``."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "s.toml").write_bytes(originals.PATH)
        scene = load_scene(Path(folder) / "s.toml")
    file: dict[str, Any] = {"path_error_mm": {"time_matched": {"E_car": 1.0}}, "speed_m_s": 0.3, "failure": None}
    return b"".join(json.dumps({"job": plain(_described(job, {"s.toml": scene})),
                                "answer": {"scene": "s", "method": "none", "seed": job.seed, **file}}).encode() + b"\n"
                    for job in jobs(["s.toml"], seeds=[1, 2]))


def _compared(rng: np.random.Generator, folder: Path) -> Case:
    scene = originals.PATH if rng.random() < 0.5 else originals.CLAMPED
    kind = "path" if scene is originals.PATH else "clamped"
    broken = set_key.with_key(scene, kind, rng) if rng.random() < 0.5 else mutate_text.mutated(scene, rng)
    return Case(f"compare {kind} scene", ["compare", "s.toml", "--out", "o", "--json", "j.json"], {"s.toml": broken})


def _xml(rng: np.random.Generator, folder: Path) -> Case:
    words = ["rsi", "p.csv", "--robot", "kr6", "--port", "0", "--wait", "0.1", "--method", "none"]
    return Case("rsi configuration", [*words, "--record", "c.csv", "--rsi-config", "rsi.xml"],
                {"p.csv": mutate_table._csv(originals.joint_path()), "rsi.xml": mutate_text.mutated(RSI_XML, rng)})


def _svg(rng: np.random.Generator, folder: Path) -> Case:
    return Case("run line of an SVG file", ["run", "s.toml", "--out", "o", "--json", "j.json"],
                {"s.toml": LINE_OF_FILE, "a.svg": mutate_text.mutated(SVG, rng)})


@cache
def calibration() -> bytes:
    """A camera's calibration as it is kept."""
    return json.dumps(CalibratedCamera(CameraModel.default(320, 240), time_offset=0.003).json(), indent=2).encode()


FURTHER: dict[str, tuple[Maker, float]] = {
    "picture": (_picture, 2.0), "film": (_film, 1.0), "bag": (_bag, 2.0), "export": (_export, 1.0),
    "view": (_shown, 1.0), "replay": (_replay, 1.0), "answers": (_answers, 0.5), "compare": (_compared, 0.5),
    "rsi_xml": (_xml, 1.0), "svg": (_svg, 0.5),
}
"""Kinds of cases: what makes one, and how often it is drawn in comparison."""
