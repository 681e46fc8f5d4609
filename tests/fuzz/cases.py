"""One fuzzed call of the command line, drawn from a seed: a verb, its words, and the files it is given, one broken."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer

from scenes.online.journal import META, ROWS
from scenes.scene_file import library
from tests.fuzz import mutate, originals
from tests.fuzz.play import Case

ARM = ("arm.urdf", "arm.toml")
URDF = "--urdf arm.urdf"
FIGURES = "--out o --json j.json"
NOBODY = f"--arm rsi://127.0.0.1:41999 --wait 0.1 {FIGURES}"
SERVE = "--serve --arm rsi://127.0.0.1:9 --camera-port 0 --force-port 0"
RSI = "--robot kr6 --port 0 --wait 0.1 --method none --record c.csv"
NETFT = "--force netft://127.0.0.1:1?rate=7000"


@dataclass(frozen=True)
class Kind:
    """A kind of case.

    Attributes:
        weight: how often it is drawn in comparison.
        words: of the command line; ``{}`` stands for the recording that is broken.
        files: what is there, by the names of ``originals.SOUND``.
        broken: those of them of which one is broken; all of them if empty and no recording is.
        table: columns that the recording must have, led by its key in ``originals.TABLES``.
        fails: whether it cannot succeed: no device is there, or no file is left of what was fetched.
        interrupted: time by the clock after which Ctrl-C is pressed [s].
        warm: whether it is played once with sound files before all others.
    """

    weight: float
    words: str
    files: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    table: tuple[str, ...] = ()
    fails: bool = False
    interrupted: float | None = None
    warm: bool = False

    def sound(self, name: str, folder: Path) -> Case:
        """The call with sound files."""
        files = {file: originals.sound(file, folder) for file in self.files}
        if self.table:
            files["r.csv"] = mutate.csv_bytes(originals.TABLES[self.table[0]](folder))
        return Case(name, self.words.format("r.csv").split(), files, self.fails, self.interrupted)

    def drawn(self, name: str, rng: np.random.Generator, folder: Path) -> Case:
        """The call with one file broken."""
        case = self.sound(name, folder)
        if not self.table:
            choice = self.broken or self.files
            file = choice[rng.integers(len(choice))]
            return replace(case, name=f"{name} {file}",
                           files={**case.files, file: broken(file, case.files[file], rng)})
        as_csv = bool(rng.random() < 0.4)
        raw, lost = mutate.mutated_table(originals.TABLES[self.table[0]](folder), self.table[1:], rng, csv=as_csv)
        file = "r.csv" if as_csv else "r.parquet"
        return Case(f"{name} recording", self.words.format(file).split(),
                    {**{key: raw for key, raw in case.files.items() if key != "r.csv"}, file: raw},
                    lost or self.fails, self.interrupted)


def broken(file: str, raw: bytes, rng: np.random.Generator) -> bytes:
    """The file with its bytes or words changed; where it has keys, as often one of them set to something extreme."""
    kind = originals.KINDS.get(file)
    if kind is not None and rng.random() < 0.5:
        return mutate.with_key(raw, kind, rng)
    if file.endswith((".json", ".jsonl")) and rng.random() < 0.5:
        return b"\n".join(mutate.with_value(line, rng) for line in raw.splitlines()) if file.endswith("l") else \
            mutate.with_value(raw, rng)
    return mutate.mutated_text(raw, rng)


MOTION, PUSHES, PATH = ("motion", "t", "q_1", "q_2", "tau_1", "tau_2"), ("pushes", "t", "q_1", "q_2"), (
    "joint_path", "t", "q_d_1", "q_d_2", "q_d_6")
IDENTIFY = f"identify {{}} {URDF} --friction viscous_coulomb --out o"
PLAN = f"plan-identification {URDF} --period 2 --out o --z-min -5"
KINDS: dict[str, Kind] = {
    "identify": Kind(4.0, f"{IDENTIFY} --json j.json --export-urdf e.urdf", ARM, table=MOTION, warm=True),
    "robot": Kind(3.0, f"{IDENTIFY} --export-urdf e.urdf".format("motion.csv"), (*ARM, "motion.csv"), ARM),
    "stiffness": Kind(3.0, f"stiffness {{}} {URDF} {FIGURES}", ARM, table=PUSHES, warm=True),
    "precorrect": Kind(2.0, "precorrect {} --model shipped.json -o c.csv --out o", ("shipped.json",), table=PATH,
                       warm=True),
    "precorrect_model": Kind(4.0, "precorrect path.csv --model shipped.json -o c.csv --out o",
                             ("path.csv", "shipped.json"), ("shipped.json",)),
    "rsi": Kind(1.0, f"rsi {{}} {RSI}", table=PATH, fails=True, warm=True),
    "rsi_arm": Kind(1.0, f"rsi still.csv {RSI}".replace("kr6", "arm.urdf"), ("arm.urdf", "arm.toml", "still.csv"),
                    ("arm.toml",), fails=True),
    "rsi_xml": Kind(1.0, f"rsi path.csv {RSI} --rsi-config rsi.xml", ("path.csv", "rsi.xml"), ("rsi.xml",), fails=True),
    "plan": Kind(1.0, PLAN, ARM, warm=True),
    "questions": Kind(1.0, f"plan-diagnosis motion.csv {URDF} --result questions.json --out m.csv --length 6 "
                           "--z-min -5", (*ARM, "motion.csv", "questions.json"), ("questions.json",)),
    "diagnose": Kind(1.0, f"diagnose {{}} {URDF} --out o --model-out m.json", ARM, table=MOTION, warm=True),
    "diagnose_model": Kind(2.0, f"diagnose motion.csv {URDF} --model model.json --out o",
                           (*ARM, "motion.csv", "model.json"), ("model.json",), warm=True),
    **{f"run_{kind}": Kind(1.75, f"run {kind}.toml {FIGURES}", (f"{kind}.toml",), warm=True)
       for kind in originals.SCENES},
    "film": Kind(1.0, f"detect f.avi {FIGURES}", ("f.avi",)),
    **{f"bag_{end}": Kind(1.0, IDENTIFY.format(f"bag.{end}"), (*ARM, f"bag.{end}"), (f"bag.{end}",))
       for end in ("mcap", "db3")},
    # What one joint lacks is told as it is: nothing but the time is needed.
    **{f"export_{number}": Kind(0.3, f"export {{}} {places}", table=("motion", "t"))
       for number, places in enumerate(("--mcap m.mcap", "--rosbag2 bag", "--csv e.csv --parquet e.parquet"))},
    "view": Kind(1.0, f"view {{}} {URDF} --once", ARM, table=("motion", "t", "q_1")),
    "answers": Kind(0.5, "sweep path.toml --seeds 1-2 --processes 1 --lines answers.jsonl --resume --json j.json "
                         "--csv t.csv", ("path.toml", "answers.jsonl"), ("answers.jsonl",)),
    **{f"compare_{kind}": Kind(0.25, f"compare {kind}.toml {FIGURES}", (f"{kind}.toml",))
       for kind in ("path", "clamped")},
    "svg": Kind(0.5, f"run svg.toml {FIGURES}", ("svg.toml", "a.svg"), ("a.svg",)),
    # A surface takes a quarter of a minute where nothing is wrong with the scene: now and then.
    **{f"close_{kind}": Kind(0.06 if kind == "close_force" else 0.135, f"close-loop {kind}.toml {FIGURES}",
                             (f"{kind}.toml",), warm=kind == "close_force")
       for kind in ("close_force", "path", "line", "clamped", "close_clamped")},
    "prepare": Kind(0.4, "prepare own.toml --json j.json --out o.json", (*ARM, "own.toml"), warm=True),
    **{f"follow_{kind}": Kind(0.7, f"follow ideal_{kind}.toml {NOBODY} {sensor} --calibration calibration.json "
                                   "--rsi-config rsi.xml",
                              (f"ideal_{kind}.toml", "calibration.json", "rsi.xml", *film), fails=True, warm=True)
       for kind, sensor, film in (("line", "--camera file:f.avi", ("f.avi",)), ("force", NETFT, ()))},
    # A film is opened by a process of its own, which takes its time to start.
    "follow_film": Kind(0.4, f"follow ideal_line.toml {NOBODY} --camera file:f.avi".replace("--wait 0.1", "--wait 4"),
                        ("ideal_line.toml", "f.avi"), ("f.avi",), fails=True),
    **{f"simulate_{kind}": Kind(0.25, f"simulate ideal_{kind}.toml {SERVE} --json j.json", (f"ideal_{kind}.toml",),
                                interrupted=2.0) for kind in ("line", "force")},
    "fetch": Kind(0.5, f"fetch emps --file emps.mat {FIGURES}", ("emps.mat",), fails=True),
}
"""Calls in which a file is broken."""
VALUES = ("nan", "inf", "-1", "0", "1", "2", "1e300", "1e-300", "99999999999999999999", "", "x", "1-3", "1,2", "0.2mm",
          "/", ".", "..", "/dev/null", "/dev/full", "/dev/zero", "/proc/none/x", "arm.urdf", "arm.urdf/x", "x" * 300,
          "a\nb", "a\udcffb", "[/red]", "\u202e", "~", "-", "--", "o", "new/deep/x.json", "x.csv", "x.parquet", "x.mp4",
          "x.gif", "model.json", "motion.csv", "path.toml", "absent.toml", "workshop", "bench", "ideal", "none",
          "127.0.0.1:1", "tcp://127.0.0.1:1", "kr6", "force", "motor", "../../../../proc/x")
"""What options and arguments are given."""
SLOW = {"video", "processes", "dask", "individuals", "speeds", "seeds", "world", "tolerance"}
"""Options that make whole films, or many plays of a scene that is sound."""
CALLS = {
    "run": "path.toml", "compare": "clamped.toml", "sweep": "path.toml --seeds 1 --processes 1",
    "prepare": "absent.toml", "identify": f"motion.csv {URDF} --friction viscous_coulomb",
    "stiffness": f"pushes.csv {URDF}", "plan-identification": f"{URDF} --period 2 --z-min -5",
    "diagnose": f"motion.csv {URDF}", "plan-diagnosis": f"motion.csv {URDF} --result absent.json",
    "close-loop": "path.toml", "precorrect": "path.csv --model shipped.json -o c.csv",
    "rsi": f"path.csv {RSI}", "play": "path.csv --robot kr6 --arm rsi://127.0.0.1:41999 --wait 0.1 -o c.csv",
    "detect": "absent.png",
    "follow": f"ideal_line.toml {NOBODY}", "simulate": f"ideal_line.toml {SERVE} --sessions 1",
    "export": "motion.csv --csv e.csv", "fetch": "emps --file emps.mat", "list": "keys", "new": "mine",
    "view": f"motion.csv {URDF} --once",
}
"""Verb → words that are sound and quick."""
GIVEN = (*ARM, "shipped.json", "motion.csv", "pushes.csv", "path.csv", "ideal_line.toml", "path.toml", "clamped.toml",
         "emps.mat", "model.json")
ADDRESSES = ("", "rsi://", "rsi://:", "rsi://127.0.0.1:99999", "rsi://[::1", "rtde://127.0.0.1:1", "rtde://", "usb:x",
             "usb:99", "usb:-1", "file:", "file:f.avi", "file:/dev/zero", "file:absent.mp4", "stream://127.0.0.1:1",
             "stream://", "stream://x y:1", "genicam:", "genicam:x.cti#1", "netft://127.0.0.1:1?rate=0",
             "netft://127.0.0.1?rate=nan&counts_force=0", "netft://127.0.0.1:1?rate=7000&counts_force=1e999",
             "rtsp://127.0.0.1:1/x", "http://127.0.0.1:1/x.mjpg", "\u202e", "x" * 5000, "a\nb", "[/red]", "://",
             "rsi:1")


def _options(rng: np.random.Generator, folder: Path) -> Case:
    """A verb with one or two of its options, or its argument, given anything."""
    import scenes.cli

    verbs = typer.main.get_command(scenes.cli.app).commands  # type: ignore[attr-defined]
    name = tuple(CALLS)[rng.integers(len(CALLS))]
    words = CALLS[name].split()
    options = [param for param in verbs[name].params if param.param_type_name == "option" and param.name not in SLOW]
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.15:
            words[0] = VALUES[rng.integers(len(VALUES))]
            continue
        option = options[rng.integers(len(options))]
        words.append((*option.opts, *option.secondary_opts)[rng.integers(len(option.opts + option.secondary_opts))])
        if not option.is_flag:
            words.append(VALUES[rng.integers(len(VALUES))])
    return Case(f"options of {name}", [name, *words], {file: originals.sound(file, folder) for file in GIVEN},
                interrupted=2.0 if name == "simulate" else None)


def _addresses(rng: np.random.Generator, folder: Path) -> Case:
    """Devices at addresses that are none, or where nobody answers."""
    file = ("ideal_line.toml", "ideal_force.toml")[rng.integers(2)]
    chosen = [word for option in ("--arm", "--camera", "--force") if rng.random() < 0.5
              for word in (option, ADDRESSES[rng.integers(len(ADDRESSES))])]
    words = f"follow {file} {NOBODY} --camera file:f.avi {NETFT}".split()
    return Case("follow addresses", [*words, *chosen],
                {name: originals.sound(name, folder) for name in (file, "f.avi")}, must_fail=True)


def _picture(rng: np.random.Generator, folder: Path) -> Case:
    """A picture with bytes of it changed, or one of an odd size."""
    ending = originals.PICTURES[rng.integers(len(originals.PICTURES))]
    raw = mutate.mutated_text(originals.picture(ending), rng)
    if rng.random() < 0.2:
        sides = (1, 2, 7, 300, 4000, 30_000)
        ending, raw = ".png", originals.blank(*(sides[k] for k in rng.integers(len(sides), size=2)))
    return Case("detect picture", ["detect", f"p{ending}", *FIGURES.split(), "--kind",
                                   ("line", "tape", "edge", "laser", "seam")[rng.integers(5)]], {f"p{ending}": raw})


def _replay(rng: np.random.Generator, folder: Path) -> Case:
    """A recording with the broken replay of its run beside it."""
    return Case("view replay", ["view", "motion.csv", *URDF.split(), "--once"],
                {**{name: originals.sound(name, folder) for name in (*ARM, "motion.csv")},
                 "motion.replay.npz": originals.broken_replay(folder, rng)})


def _live(rng: np.random.Generator, folder: Path) -> Case:
    """A run that goes on whose journal is broken, seen for a second."""
    meta = json.dumps({"robot": "kr6", "cycle_time": 0.012, "scene": "s", "method": "ideal",
                       "gain": [1.0] * 6}).encode()
    rows = rng.normal(size=(50, 26)) * rng.choice([1e-3, 1.0, 1e300])
    rows[:, 1] = 0.012 * np.arange(50)
    raw, scene = rows.tobytes(), originals.sound("ideal_line.toml", folder)
    if rng.random() < 0.5:
        meta = broken("meta.json", meta, rng)
    else:
        raw = mutate.flipped(raw, rng) if rng.random() < 0.5 else raw[: int(rng.integers(len(raw) + 1))]
    if rng.random() < 0.3:
        scene = broken("ideal_line.toml", scene, rng)
    return Case("view live", ["view", "s.toml", "--live", "run"],
                {"s.toml": scene, f"run/{META}": meta, f"run/{ROWS}": raw}, interrupted=2.0)


def _library(rng: np.random.Generator, folder: Path) -> Case:
    """A shipped scene broken, beside one that is sought and not found."""
    files = sorted(library().glob("*.toml"))
    text = files[rng.integers(len(files))].read_bytes()
    return Case("list of scenes", ["run", "absent", "--method", "magic"],
                {"absent.toml": mutate.mutated_text(text, rng), "other.toml": mutate.mutated_text(text, rng)})


Maker = Callable[[np.random.Generator, Path], Case]
MAKERS: dict[str, tuple[Maker, float]] = {
    **{name: (lambda rng, folder, name=name, kind=kind: kind.drawn(name, rng, folder), kind.weight)
       for name, kind in KINDS.items()},
    "options": (_options, 5.0), "addresses": (_addresses, 0.5), "picture": (_picture, 2.0), "replay": (_replay, 1.0),
    "live": (_live, 0.5), "library": (_library, 1.0),
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
    """One call of each verb with sound files, which loads all that the verb needs; without devices some must fail.

    Args:
        folder: for the sound files; any that lasts.
    """
    return [kind.sound(name, folder) for name, kind in KINDS.items() if kind.warm]
