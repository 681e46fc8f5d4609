"""Fuzzed options: every option of every verb, beside words that are sound without it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import typer
from scipy.io import savemat

from tests.fuzz import mutate_table, mutate_text, originals
from tests.fuzz.case import Case, Maker
from tests.fuzz.device_cases import NOBODY, SCENES, SERVE

VALUES = ("nan", "inf", "-1", "0", "1", "2", "1e300", "1e-300", "99999999999999999999", "", "x", "1-3", "1,2", "0.2mm",
          "/", ".", "..", "/dev/null", "/dev/full", "/dev/zero", "/proc/none/x", "arm.urdf", "arm.urdf/x", "x" * 300,
          "a\nb", "a\udcffb", "[/red]", "\u202e", "~", "-", "--", "o", "new/deep/x.json", "x.csv", "x.parquet", "x.mp4",
          "x.gif", "m.json", "r.csv", "s.toml", "absent.toml", "workshop", "bench", "ideal", "none", "127.0.0.1:1",
          "tcp://127.0.0.1:1", "kr6", "force", "motor")
"""What options and arguments are given."""
SLOW = {"video", "processes", "dask", "individuals", "speeds", "seeds", "world", "tolerance"}
"""Options that make whole films, or many plays of a scene that is sound."""


def _calls() -> dict[str, list[str]]:
    """Verb → words that are sound and quick."""
    arm = ["--urdf", "arm.urdf"]
    return {
        "run": ["p.toml"], "compare": ["clamped.toml"], "sweep": ["p.toml", "--seeds", "1", "--processes", "1"],
        "prepare": ["absent.toml"], "identify": ["r.csv", *arm, "--friction", "viscous_coulomb"],
        "plan-identification": [*arm, "--period", "2", "--z-min", "-5"], "stiffness": ["f.csv", *arm],
        "diagnose": ["r.csv", *arm], "plan-diagnosis": ["r.csv", *arm, "--result", "absent.json"],
        "close-loop": ["p.toml"], "precorrect": ["d.csv", "--model", "m.json", "-o", "c.csv"],
        "rsi": ["d.csv", "--robot", "kr6", "--port", "0", "--wait", "0.1", "--method", "none"],
        "follow": ["s.toml", *NOBODY], "simulate": ["s.toml", *SERVE, "--sessions", "1"], "detect": ["absent.png"],
        "export": ["r.csv", "--csv", "e.csv"], "fetch": ["emps", "--file", "emps.mat"], "list": ["keys"],
        "new": ["mine"], "view": ["r.csv", *arm, "--once"],
    }


def _options(rng: np.random.Generator, folder: Path) -> Case:
    """A verb with one or two of its options, or its argument, given anything."""
    import scenes.cli

    verbs = typer.main.get_command(scenes.cli.app).commands  # type: ignore[attr-defined]
    name = tuple(_calls())[rng.integers(len(_calls()))]
    words = list(_calls()[name])
    options = [one for one in verbs[name].params if one.param_type_name == "option" and one.name not in SLOW]
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.1:
            words[0] = VALUES[rng.integers(len(VALUES))]
            continue
        option = options[rng.integers(len(options))]
        words.append((*option.opts, *option.secondary_opts)[rng.integers(len(option.opts + option.secondary_opts))])
        if not option.is_flag:
            words.append(VALUES[rng.integers(len(VALUES))])
    table = mutate_table._csv
    files = {"arm.urdf": originals.URDF, "arm.toml": originals.DATA, "m.json": originals.shipped_model(),
             "r.csv": table(originals.motion(folder)), "f.csv": table(originals.pushes(folder)),
             "d.csv": table(originals.joint_path()), "s.toml": SCENES["line"], "p.toml": originals.PATH,
             "clamped.toml": originals.CLAMPED, "emps.mat": _mat()}
    return Case(f"options of {name}", [name, *words], files, interrupted=2.0 if name == "simulate" else None)


def _fetch(rng: np.random.Generator, folder: Path) -> Case:
    """A data set downloaded by hand whose file is not what it should be."""
    return Case("fetch file", ["fetch", ("emps", "emps_pulses", "ur10e_ptp")[rng.integers(3)], "--file", "emps.mat",
                               "--out", "o", "--json", "j.json"], {"emps.mat": mutate_text.mutated(_mat(), rng)},
                must_fail=True)


def _mat() -> bytes:
    made, t = io.BytesIO(), 1e-3 * np.arange(200.0)[:, None]
    savemat(made, {name: t for name in ("t", "qm", "qg", "vir")} | {"gtau": 35.15})
    return made.getvalue()


OPTIONS: dict[str, tuple[Maker, float]] = {"options": (_options, 3.0), "fetch": (_fetch, 0.5)}
"""Kinds of cases: what makes one, and how often it is drawn in comparison."""
