"""One fuzzed call of the command line, drawn from a seed: a verb, its words, and the files it is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz import closing_cases, device_cases, mutate_table, mutate_text, originals, set_key
from tests.fuzz.case import Case, Maker
from tests.fuzz.closing_cases import CLOSING
from tests.fuzz.device_cases import DEVICES
from tests.fuzz.further_cases import FURTHER
from tests.fuzz.option_cases import OPTIONS

ARM = ("arm.urdf", "arm.toml")
QUESTIONS = (b'{"effects": [{"effect": "degressive", "joint": 2, "channel": "tau_2", "indistinguishable_from": '
             b'["stribeck", "kinematic_error of joint 1"]}], "undecided": [{"joint": 1, "reason": "rests"}]}')


def _arm() -> dict[str, bytes]:
    return {"arm.urdf": originals.URDF, "arm.toml": originals.DATA}


def _table(folder: Path, which: str, rng: np.random.Generator) -> tuple[str, bytes, bool]:
    columns, required = {
        "motion": (lambda: originals.motion(folder), ("t", "q_1", "q_2", "tau_1", "tau_2")),
        "pushes": (lambda: originals.pushes(folder), ("t", "q_1", "q_2")),
        "path": (originals.joint_path, ("t", "q_d_1", "q_d_2", "q_d_6")),
    }[which]
    csv = bool(rng.random() < 0.4)
    raw, lost = mutate_table.mutated(columns(), required, rng, csv=csv)
    return ("r.csv" if csv else "r.parquet"), raw, lost


def _sound(folder: Path, which: str) -> bytes:
    columns = originals.motion(folder) if which == "motion" else originals.joint_path()
    return mutate_table._csv(columns)


def _identify(rng: np.random.Generator, folder: Path) -> Case:
    name, raw, lost = _table(folder, "motion", rng)
    return Case("identify recording", ["identify", name, "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out",
                                       "o", "--json", "j.json"], {**_arm(), name: raw}, lost)


def _diagnose(rng: np.random.Generator, folder: Path) -> Case:
    name, raw, lost = _table(folder, "motion", rng)
    return Case("diagnose recording", ["diagnose", name, "--urdf", "arm.urdf", "--out", "o", "--model-out", "m.json"],
                {**_arm(), name: raw}, lost)


def _diagnose_model(rng: np.random.Generator, folder: Path) -> Case:
    return Case("diagnose model", ["diagnose", "r.csv", "--urdf", "arm.urdf", "--model", "m.json", "--out", "o"],
                {**_arm(), "r.csv": _sound(folder, "motion"),
                 "m.json": mutate_text.mutated(originals.model(folder), rng)})


def _stiffness(rng: np.random.Generator, folder: Path) -> Case:
    name, raw, lost = _table(folder, "pushes", rng)
    return Case("stiffness recording", ["stiffness", name, "--urdf", "arm.urdf", "--out", "o", "--json", "j.json"],
                {**_arm(), name: raw}, lost)


def _precorrect(rng: np.random.Generator, folder: Path) -> Case:
    name, raw, lost = _table(folder, "path", rng)
    return Case("precorrect path", ["precorrect", name, "--model", "m.json", "-o", "c.csv", "--out", "o"],
                {name: raw, "m.json": originals.shipped_model()}, lost)


def _precorrect_model(rng: np.random.Generator, folder: Path) -> Case:
    return Case("precorrect model", ["precorrect", "p.csv", "--model", "m.json", "-o", "c.csv", "--out", "o"],
                {"p.csv": _sound(folder, "path"), "m.json": mutate_text.mutated(originals.shipped_model(), rng)})


def _rsi(rng: np.random.Generator, folder: Path) -> Case:
    name, raw, lost = _table(folder, "path", rng)
    return Case("rsi path", ["rsi", name, "--robot", "kr6", "--port", "0", "--wait", "0.1", "--record", "c.csv",
                             "--method", "none"], {name: raw}, lost)


def _rsi_arm(rng: np.random.Generator, folder: Path) -> Case:
    data = originals.DATA + b"[rsi]\naxis_sign = [1.0, -1.0]\naxis_zero = [0.0, 5.0]\n"
    path = {"t": originals.motion(folder)["t"][:50], **{f"q_d_{i}": 0.0 * originals.motion(folder)["t"][:50]
                                                        for i in (1, 2)}}
    return Case("rsi robot data", ["rsi", "p.csv", "--robot", "arm.urdf", "--port", "0", "--wait", "0.1", "--record",
                                   "c.csv", "--method", "none"],
                {"arm.urdf": originals.URDF, "arm.toml": mutate_text.mutated(data, rng),
                 "p.csv": mutate_table._csv(path)})


def _robot(rng: np.random.Generator, folder: Path) -> Case:
    files = _arm()
    broken = ARM[rng.integers(2)]
    files[broken] = mutate_text.mutated(files[broken], rng)
    return Case(f"identify {'URDF' if broken == ARM[0] else 'robot data'}",
                ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o",
                 "--export-urdf", "e.urdf"], {**files, "r.csv": _sound(folder, "motion")})


def _plan(rng: np.random.Generator, folder: Path) -> Case:
    files = _arm()
    broken = ARM[rng.integers(2)]
    files[broken] = mutate_text.mutated(files[broken], rng)
    return Case("plan robot", ["plan-identification", "--urdf", "arm.urdf", "--period", "2", "--out", "o",
                               "--z-min", "-5"], files)


def _questions(rng: np.random.Generator, folder: Path) -> Case:
    """What a diagnosis is said to have left open, broken."""
    return Case("plan diagnosis", ["plan-diagnosis", "r.csv", "--urdf", "arm.urdf", "--result", "d.json", "--out",
                                   "m.csv", "--length", "6", "--z-min", "-5"],
                {**_arm(), "r.csv": _sound(folder, "motion"), "d.json": mutate_text.mutated(QUESTIONS, rng)})


def _scene(rng: np.random.Generator, folder: Path) -> Case:
    kind = tuple(originals.SCENES)[rng.integers(len(originals.SCENES))]
    return Case(f"run {kind} scene", ["run", "s.toml", "--out", "o", "--json", "j.json"],
                {"s.toml": mutate_text.mutated(originals.SCENES[kind], rng)})


def _key(rng: np.random.Generator, folder: Path) -> Case:
    kind = tuple(originals.SCENES)[rng.integers(len(originals.SCENES))]
    return Case(f"run {kind} scene, a key", ["run", "s.toml", "--out", "o", "--json", "j.json"],
                {"s.toml": set_key.with_key(originals.SCENES[kind], kind, rng)})


def _model_value(rng: np.random.Generator, folder: Path) -> Case:
    """A model with one value, list or table of it set to something extreme or taken away."""
    which, raw = (("small", originals.model(folder)), ("shipped", originals.shipped_model()))[rng.integers(2)]
    model = set_key.with_value(raw, rng)
    if which == "small":
        return Case("diagnose model, a value", ["diagnose", "r.csv", "--urdf", "arm.urdf", "--model", "m.json", "--out",
                                                "o"], {**_arm(), "r.csv": _sound(folder, "motion"), "m.json": model})
    return Case("precorrect model, a value", ["precorrect", "p.csv", "--model", "m.json", "-o", "c.csv", "--out", "o"],
                {"p.csv": _sound(folder, "path"), "m.json": model})


def _view(rng: np.random.Generator, folder: Path) -> Case:
    from scenes.scene_file import library

    files = sorted(library().glob("*.toml"))
    text = files[rng.integers(len(files))].read_bytes()
    return Case("list of scenes", ["run", "absent", "--method", "magic"],
                {"absent.toml": mutate_text.mutated(text, rng), "other.toml": mutate_text.mutated(text, rng)})


def _words(rng: np.random.Generator, folder: Path) -> Case:
    numbers = ("nan", "inf", "-1", "0", "1e300", "x", "", "1e-300", "99999999999999999999")
    places = ("", "/", ".", "/dev/null", "/proc/none/x", "arm.urdf", "arm.urdf/x", "x" * 300, "a\nb", "[/red]", "~",
              "../../../../proc/x", "-", "--", "o")
    number, place, other = (tuple(words)[rng.integers(len(words))] for words in (numbers, places, places))
    calls = (
        ["identify", "r.csv", "--urdf", "arm.urdf", "--cutoff", number, "--friction", "viscous_coulomb"],
        ["identify", "r.csv", "--urdf", "arm.urdf", "--decimate-to", number, "--friction", "viscous_coulomb"],
        ["identify", place, "--urdf", other], ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", place],
        ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", place, "--json", other],
        ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--model", place, "--export-urdf",
         other],
        ["stiffness", "r.csv", "--urdf", place], ["stiffness", "r.csv", "--urdf", "arm.urdf", "--drive-gain-tolerance",
                                                  number],
        ["precorrect", "r.csv", "--model", place, "-o", other], ["diagnose", place, "--urdf", "arm.urdf"],
        ["run", place], ["run", "line", "--speed", number], ["run", "line", "--seed", number],
        ["run", "line", "--method", place], ["run", "line", "--out", "arm.urdf"],
        ["run", "line", "--json", place, "--speed", "99"],
        ["sweep", "line", "--seeds", number], ["sweep", "line", "--speeds", number], ["sweep", place],
        ["sweep", "straight", "--seeds", "1-" + number], ["compare", place], ["close-loop", place],
        ["rsi", "r.csv", "--robot", place, "--wait", "0.1"], ["rsi", "r.csv", "--robot", "kr6", "--cycle", number],
        ["plan-identification", "--urdf", "arm.urdf", "--period", number], ["view", place, "--once"],
        ["plan-identification", "--urdf", "arm.urdf", "--points", number, "--method", "two-step"], ["detect", place],
    )
    return Case("words", list(calls[rng.integers(len(calls))]), {**_arm(), "r.csv": _sound(folder, "motion")})


MAKERS: dict[str, tuple[Maker, float]] = {
    "identify": (_identify, 4.0), "robot": (_robot, 3.0), "stiffness": (_stiffness, 3.0),
    "precorrect": (_precorrect, 2.0), "precorrect_model": (_precorrect_model, 3.0),
    "rsi": (_rsi, 1.0), "rsi_arm": (_rsi_arm, 1.0), "plan": (_plan, 1.0), "questions": (_questions, 1.0),
    "scene": (_scene, 4.0), "scenes": (_view, 1.0), "words": (_words, 2.0), "diagnose": (_diagnose, 1.0),
    "diagnose_model": (_diagnose_model, 1.0), "key": (_key, 3.0),
    "model_value": (_model_value, 2.0), **FURTHER, **CLOSING, **DEVICES, **OPTIONS,
}
"""Kinds of cases: what makes one, and how often it is drawn in comparison."""


def drawn(seed: int, folder: Path, kinds: tuple[str, ...] = tuple(MAKERS)) -> Case:
    """The case of a seed.

    Args:
        seed: the whole of it.
        folder: for the sound files; any that lasts.
        kinds: keys of ``MAKERS`` to draw from.
    """
    rng = np.random.default_rng(seed)
    weights = np.array([MAKERS[kind][1] for kind in kinds])
    return MAKERS[kinds[rng.choice(len(kinds), p=weights / weights.sum())]][0](rng, folder)


def sound(folder: Path) -> list[Case]:
    """One call of each verb with sound files, which loads all that the verb needs; RSI fails as nobody sends.

    Args:
        folder: for the sound files; any that lasts.
    """
    motion, path = _sound(folder, "motion"), _sound(folder, "path")
    arm = {**_arm(), "r.csv": motion}
    model = originals.model(folder)
    return [
        Case("identify", ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o",
                          "--json", "j.json", "--export-urdf", "e.urdf"], arm),
        Case("diagnose", ["diagnose", "r.csv", "--urdf", "arm.urdf", "--out", "o", "--model-out", "m.json"], arm),
        Case("diagnose with a model", ["diagnose", "r.csv", "--urdf", "arm.urdf", "--model", "m.json", "--out", "o"],
             {**arm, "m.json": model}),
        Case("stiffness", ["stiffness", "p.parquet", "--urdf", "arm.urdf", "--out", "o", "--json", "j.json"],
             {**_arm(), "p.parquet": mutate_table._parquet(originals.pushes(folder), b"{}")}),
        Case("precorrect", ["precorrect", "p.csv", "--model", "m.json", "-o", "c.csv", "--out", "o"],
             {"p.csv": path, "m.json": originals.shipped_model()}),
        Case("rsi", ["rsi", "p.csv", "--robot", "kr6", "--port", "0", "--wait", "0.1", "--record", "c.csv", "--method",
                     "none"], {"p.csv": path}, must_fail=True),
        Case("plan", ["plan-identification", "--urdf", "arm.urdf", "--period", "2", "--out", "o", "--z-min", "-5"],
             arm),
        *(Case(f"run {kind}", ["run", "s.toml", "--out", "o", "--json", "j.json"], {"s.toml": text})
          for kind, text in originals.SCENES.items()),
        *closing_cases.sound(), *device_cases.sound(),
    ]
